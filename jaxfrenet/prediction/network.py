"""The neural predictor's network: past, neighbours and lanes of each obstacle become parameters of its motion.

Of the family of WALE-Net (Geisslinger et al. 2021): an encoder of the past, social pooling, a view of the lanes, and
bivariate Gaussians trained by their likelihood. Instead of a picture of the road it sees the lane paths ahead.
"""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.prediction.features import Features

MOTION = 3
"""Coefficients of the motion along a mode's path, and as many of the motion across."""
SPREAD = 4
"""Coefficients of each of two standard deviations and of a correlation."""


@pytree_dataclass
class Modes:
    """What an obstacle may do: follow one of the lane paths, or (the last mode) go on as it is heading."""

    logit: Float[Array, "*batch modes"]
    """`[obstacles, modes]`."""
    along: Float[Array, "*batch modes motion"]
    """`[obstacles, modes, MOTION]`, see `jaxfrenet.prediction.neural`."""
    across: Float[Array, "*batch modes motion"]
    spread: Float[Array, "*batch modes 3 spread"]
    """`[obstacles, modes, (along, across, correlation), SPREAD]`."""


class MotionNetwork(nn.Module):
    """`Features` of the obstacles of one scene to their `Modes`."""

    width: int = 96
    """Units of the hidden layers."""

    @nn.compact
    def __call__(self, features: Features) -> Modes:
        """Evaluate for obstacles `[obstacles]`; under `vmap` for several scenes."""
        past = self._layers(features.history, "past", 128, 64)
        own = self._layers(jnp.concatenate([past, features.own], axis=-1), "own", self.width, self.width)
        context = jnp.concatenate([own, self._pooled(features, past, own)], axis=-1)
        context = self._layers(context, "context", self.width, self.width)
        straight = jnp.zeros_like(features.lane[:, :1])
        lanes = jnp.concatenate([features.lane, straight], axis=1)
        hidden = (
            nn.Dense(self.width, name="lane")(lanes) + nn.Dense(self.width, name="context_of_lane")(context)[:, None]
        )
        is_straight = jnp.zeros(lanes.shape[1]).at[-1].set(1.0)[:, None]
        hidden = hidden + nn.Dense(self.width, use_bias=False, name="straight")(is_straight)
        hidden = self._layers(nn.relu(hidden), "mode", self.width)
        outputs = 1 + 2 * MOTION + 3 * SPREAD
        out = nn.Dense(outputs, kernel_init=nn.initializers.normal(1e-3), name="out")(hidden)
        return Modes(
            logit=out[..., 0],
            along=out[..., 1 : 1 + MOTION],
            across=out[..., 1 + MOTION : 1 + 2 * MOTION],
            spread=out[..., 1 + 2 * MOTION :].reshape(*out.shape[:-1], 3, SPREAD),
        )

    def _pooled(self, features: Features, past: Array, own: Array) -> Array:
        """Attention of each obstacle to its neighbours' motion; none is paid to who does not exist."""
        theirs = jnp.concatenate([features.relation, past[features.neighbor]], axis=-1)
        theirs = self._layers(theirs, "neighbor", 64, 64)
        query = nn.Dense(64, name="query")(own)
        score = jnp.sum(query[:, None] * theirs, axis=-1) / 8.0
        score = jnp.where(features.neighbor_valid, score, -1e9)
        nobody = jnp.zeros_like(score[:, :1])
        weight = jax.nn.softmax(jnp.concatenate([score, nobody], axis=-1), axis=-1)[:, :-1]
        return jnp.sum(weight[..., None] * theirs, axis=1)

    def _layers(self, value: Array, name: str, *widths: int) -> Array:
        for index, width in enumerate(widths):
            value = nn.relu(nn.Dense(width, name=f"{name}_{index}")(value))
        return value
