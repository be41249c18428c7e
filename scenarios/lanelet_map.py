"""The lanelets of a generated map, as arrays that come with a scenario, and how they hang together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._angles import wrapped
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float
from jaxfrenet.scenario import LANE_NODES


@pytree_dataclass
class LaneletMap:
    """Borders of a map's lanelets in the scenario's frame; the lanelets of one family are always the same ones."""

    left: tuple[Float[Array, "*batch corners 2"], ...]
    """One `[corners, 2]`, m, per lanelet."""
    right: tuple[Float[Array, "*batch corners 2"], ...]
    """One `[corners, 2]`, m, per lanelet."""
    is_goal: Bool[Array, "*batch lanelets"]
    """`[lanelets]`, which of them are the goal's region."""


class LaneletLinks(NamedTuple):
    """What one lanelet is connected to, by index."""

    successors: tuple[int, ...]
    left: int | None = None
    """The lanelet to its left."""
    left_same_direction: bool = False
    right: int | None = None
    """The lanelet to its right, always of the same direction."""


def lane_map_of(
    borders: Sequence[tuple[Array, Array]], links: Sequence[LaneletLinks], pieces: Sequence[int]
) -> jf.LaneMap:
    """The lanelets' centre lines as the planner's side reads them; see `jaxfrenet.LaneMap`.

    Args:
      borders: left and right border of each lanelet, all `[corners, 2]`, m.
      links: how the lanelets hang together.
      pieces: into how many pieces each is cut.
    """
    middle = 0.5 * (jnp.stack([left for left, _ in borders]) + jnp.stack([right for _, right in borders]))
    center, length = zip(*(_cut(middle[index], count) for index, count in enumerate(pieces)), strict=True)
    end = middle[:, -1] - middle[:, -2]
    angle = jnp.arctan2(end[:, 1], end[:, 0])
    first = np.concatenate([[0], np.cumsum(pieces)])
    successors = jnp.repeat(jnp.arange(1, first[-1] + 1, dtype=jnp.int32)[:, None], 3, axis=1)
    for index, link in enumerate(links):
        successors = successors.at[first[index + 1] - 1].set(_ways(angle, index, link.successors, first))
    return jf.LaneMap(
        center=jnp.concatenate(center),
        length=jnp.concatenate(length),
        successors=successors,
        valid=jnp.ones(int(first[-1]), bool),
    )


def _cut(line: Array, count: int) -> tuple[Array, Array]:
    """Evenly spaced nodes of a line `[corners, 2]` in `count` pieces, `[pieces, LANE_NODES, 2]`, and their lengths."""
    steps = jnp.linalg.norm(jnp.diff(line, axis=0), axis=1)
    along = jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)])
    at = along[-1] * jnp.linspace(0.0, 1.0, count * (LANE_NODES - 1) + 1)
    nodes = jax.vmap(jnp.interp, in_axes=(None, None, 1), out_axes=1)(at, along, line)
    place = np.arange(count)[:, None] * (LANE_NODES - 1) + np.arange(LANE_NODES)
    return nodes[place], jnp.full(count, along[-1] / count)


def _ways(angle: Array, lanelet: int, following: tuple[int, ...], first: np.ndarray) -> Array:
    """First pieces of the lanelets behind one that turn most to the left, least, and most to the right, `[3]`."""
    if not following:
        return jnp.full(3, -1, jnp.int32)
    turn = wrapped(angle[np.array(following)] - angle[lanelet])
    ways = jnp.stack([jnp.argmax(turn), jnp.argmin(jnp.abs(turn)), jnp.argmin(turn)])
    return jnp.asarray(first[np.array(following)], jnp.int32)[ways]
