"""Recorded traffic as a table of tasks for predictors, and how well a prediction agrees with what came."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
import scenarios
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float
from scenarios.batching import FILL

LEVELS = (0.5, 0.9, 0.99)
"""Probabilities of the ellipses in which true positions are counted."""
BINS = 50
"""Bins of the probability of the ellipse through the true position, which is uniform for calibrated predictions."""


@pytree_dataclass
class Traffic:
    """What predictors see of scenarios, as one batch."""

    obstacles: jf.Obstacles
    lane_map: jf.LaneMap

    def at(self, index: Array) -> Traffic:
        """Those scenarios `[some]`, or the one `[]`."""
        return jax.tree.map(lambda leaf: leaf[index], self)


@pytree_dataclass
class Scores:
    """How well predictions agree with what was recorded; entries that are not valid are 0."""

    error: Float[Array, "*batch"]
    """`[obstacles, steps]`, m, distance from the predicted mean."""
    nll: Float[Array, "*batch"]
    """`[obstacles, steps]`, negative log-likelihood (of a density per m²)."""
    mahalanobis: Float[Array, "*batch"]
    """`[obstacles, steps]`, squared Mahalanobis distance."""
    valid: Bool[Array, "*batch"]
    """`[obstacles, steps]`, whether the obstacle was predicted, moves at all, and was recorded at the step."""


def traffic_of(found: Sequence[jf.Scenario]) -> Traffic:
    """The traffic of scenarios as one batch of NumPy arrays; nothing else of them is kept."""
    stack = scenarios.stack(found)
    return jax.device_get(Traffic(stack.obstacles, stack.lane_map))


def joined(parts: Sequence[Traffic]) -> Traffic:
    """All scenarios of all parts as one batch, in their order, padded to common sizes."""

    def column(name: str, leaves: Sequence[np.ndarray]) -> Array:
        shape = np.max([leaf.shape[1:] for leaf in leaves], axis=0).astype(int)
        widths = [
            [(0, 0), *((0, size - own) for size, own in zip(shape, leaf.shape[1:], strict=True))] for leaf in leaves
        ]
        fill = FILL.get(name, 0)
        return jnp.asarray(
            np.concatenate([np.pad(leaf, width, constant_values=np.asarray(fill).astype(leaf.dtype))
                            for leaf, width in zip(leaves, widths, strict=True)])
        )  # fmt: skip

    def name_of(where: Any) -> str:
        return jax.tree_util.keystr(where, simple=True, separator=".")

    return jax.tree_util.tree_map_with_path(lambda where, *leaves: column(name_of(where), leaves), *parts)


def score(prediction: jf.Prediction, obstacles: jf.Obstacles, step: Array) -> Scores:
    """Compare a prediction made at `step` with the record."""
    horizon = prediction.valid.shape[1]
    last = obstacles.valid.shape[1] - 1
    coming = step + 1 + jnp.arange(horizon)
    index = jnp.minimum(coming, last)
    recorded = obstacles.valid[:, index] & (coming <= last) & ~obstacles.static[:, None]
    valid = prediction.valid & recorded
    away = jnp.where(valid[..., None], obstacles.position[:, index] - prediction.mean, 0.0)
    xx, xy, yy = (prediction.covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    determinant = jnp.where(valid, xx * yy - xy**2, 1.0)
    x, y = away[..., 0], away[..., 1]
    mahalanobis = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / determinant
    nll = 0.5 * mahalanobis + 0.5 * jnp.log(determinant) + np.float32(np.log(2.0 * np.pi))
    square = jnp.sum(away**2, axis=-1)
    return Scores(
        error=jnp.where(valid, jnp.sqrt(jnp.where(valid, square, 1.0) + 1e-12), 0.0),
        nll=jnp.where(valid, nll, 0.0),
        mahalanobis=jnp.where(valid, mahalanobis, 0.0),
        valid=valid,
    )


@pytree_dataclass
class Tally:
    """Sums over predictions, for each coming step."""

    count: Float[Array, "*batch steps"]
    error: Float[Array, "*batch steps"]
    """m."""
    nll: Float[Array, "*batch steps"]
    inside: Float[Array, "*batch steps levels"]
    """`[steps, levels]`, true positions inside the ellipses of `LEVELS`."""
    histogram: Float[Array, "*batch bins"]
    """`[BINS]`, of all steps together."""

    def summed(self) -> Tally:
        """Over the first axis."""
        return jax.tree.map(lambda leaf: jnp.sum(leaf, axis=0), self)


def tally(scores: Scores) -> Tally:
    """The sums over the obstacles of one scene."""
    share = 1.0 - jnp.exp(-0.5 * scores.mahalanobis)
    inside = share[..., None] <= jnp.asarray(LEVELS)
    bins = jnp.minimum((BINS * share).astype(jnp.int32), BINS - 1)
    counted = scores.valid.astype(jnp.float32)
    return Tally(
        count=jnp.sum(counted, axis=0),
        error=jnp.sum(scores.error, axis=0),
        nll=jnp.sum(scores.nll, axis=0),
        inside=jnp.sum(jnp.where(inside, counted[..., None], 0.0), axis=0),
        histogram=jnp.zeros(BINS).at[bins.reshape(-1)].add(counted.reshape(-1)),
    )
