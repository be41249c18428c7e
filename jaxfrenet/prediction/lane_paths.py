"""Where the lanes would lead an obstacle: candidate paths through the lane map, and places along them."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.scenario import LANE_NODES, LaneMap

STARTS = 3
"""Lanes that an obstacle may be in, nearest first: lanes overlap where they cross, fork and merge."""
WAYS = 3
"""Ways on from each: keeping to the left, straight on, keeping to the right."""
PATHS = STARTS * WAYS
DEPTH = 8
"""Pieces of lane in a path; behind the last one it goes on straight."""
FARTHEST = 5.0
"""An obstacle farther than this [m] from a lane's centre line does not follow it."""
LEAST_COSINE = 0.3
"""Nor does one whose heading differs from the lane's by more than the angle with this cosine."""
TURN_PENALTY = 10.0
"""Squared distance [m²] that weighs as much as a right angle when the nearest lanes are chosen."""
BEYOND_PENALTY = 4.0
"""Squared distance [m²] added for a piece that ends before the obstacle, or begins behind it: another one covers it."""


@pytree_dataclass
class LanePaths:
    """Paths from the point nearest to an obstacle on; arc lengths count from there."""

    piece: Int[Array, "*batch paths depth"]
    """`[paths, DEPTH]`, the pieces of lane."""
    start: Float[Array, "*batch paths depth"]
    """`[paths, DEPTH]`, m, arc length at which each begins; infinite behind the path's end."""
    end: Float[Array, "*batch paths"]
    """`[paths]`, m, arc length at which the last piece ends."""
    fork: Float[Array, "*batch paths"]
    """`[paths]`, m, arc length of the first fork, or `end`."""
    offset: Float[Array, "*batch paths"]
    """`[paths]`, m, of the obstacle to the left of its lane's centre line."""
    cos: Float[Array, "*batch paths"]
    """`[paths]`, of the obstacle's heading relative to the lane's; also `sin`."""
    sin: Float[Array, "*batch paths"]
    valid: Bool[Array, "*batch paths"]
    """`[paths]`, whether there is such a lane near the obstacle."""


def find(lane_map: LaneMap, position: Float[Array, "2"], cos: Float[Array, ""], sin: Float[Array, ""]) -> LanePaths:
    """The paths of one obstacle at `position` [m] with a heading given as a unit vector.

    Path `WAYS * i + j` leaves the i-th nearest lane and takes way j at every fork.
    """
    start, step = lane_map.center[:, :-1], jnp.diff(lane_map.center, axis=1)
    segment = lane_map.length[:, None] / (LANE_NODES - 1)
    relative = position - start
    square = jnp.maximum(_dot(step, step), 1e-9)
    share = _dot(relative, step) / square
    away = relative - jnp.clip(share, 0.0, 1.0)[..., None] * step
    distance = _dot(away, away)
    nearest = jnp.argmin(distance, axis=1)

    def at_nearest(table: Array) -> Array:
        return jnp.take_along_axis(table, nearest.reshape(-1, *[1] * (table.ndim - 1)), axis=1)[:, 0]

    along, distance = at_nearest(share), at_nearest(distance)
    tangent = at_nearest(step) / jnp.sqrt(at_nearest(square))[:, None]
    turn_cos = cos * tangent[:, 0] + sin * tangent[:, 1]
    turn_sin = sin * tangent[:, 0] - cos * tangent[:, 1]
    beside = at_nearest(relative)
    offset = beside[:, 1] * tangent[:, 0] - beside[:, 0] * tangent[:, 1]
    beyond = (along < 0.0) | (along > 1.0)
    valid = lane_map.valid & (distance < FARTHEST**2) & (turn_cos > LEAST_COSINE)
    score = distance + TURN_PENALTY * (1.0 - turn_cos) + jnp.where(beyond, BEYOND_PENALTY, 0.0)
    score = jnp.where(valid, score, jnp.inf)
    chosen, found = [], []
    for _ in range(STARTS):
        best = jnp.argmin(score).astype(jnp.int32)
        chosen.append(best)
        found.append(jnp.isfinite(score[best]))
        score = jnp.where(jnp.arange(score.size) == best, jnp.inf, score)
    first = jnp.repeat(jnp.stack(chosen), WAYS)
    passed = (nearest.astype(jnp.float32) + jnp.clip(along, 0.0, 1.0)) * segment[:, 0]
    paths = _walk(lane_map, first, -passed[first])
    return dataclasses.replace(
        paths,
        offset=offset[first],
        cos=turn_cos[first],
        sin=turn_sin[first],
        valid=jnp.repeat(jnp.stack(found), WAYS),
    )


def _dot(a: Float[Array, "*shape 2"], b: Float[Array, "*shape 2"]) -> Float[Array, "*shape"]:
    """Inner products, written out: XLA's reductions over two numbers are many times slower on CPUs."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _walk(lane_map: LaneMap, first: Array, start: Array) -> LanePaths:
    """From pieces `[paths]` that begin at arc lengths `start` [m] on; the obstacle's place is left open."""
    way = jnp.tile(jnp.arange(WAYS), STARTS)
    pieces, starts, fork = [first], [start], jnp.full_like(start, jnp.inf)
    end = start + lane_map.length[first]
    for _ in range(DEPTH - 1):
        following = lane_map.successors[pieces[-1]]
        exists = jnp.isfinite(starts[-1]) & (following[:, 0] >= 0)
        forks = exists & (following[:, 0] != following[:, 2])
        fork = jnp.where(forks, jnp.minimum(fork, end), fork)
        piece = jnp.where(exists, jnp.take_along_axis(following, way[:, None], axis=1)[:, 0], pieces[-1])
        starts.append(jnp.where(exists, end, jnp.inf))
        end = jnp.where(exists, end + lane_map.length[piece], end)
        pieces.append(piece)
    zero = jnp.zeros_like(start)
    return LanePaths(
        piece=jnp.stack(pieces, axis=1),
        start=jnp.stack(starts, axis=1),
        end=end,
        fork=jnp.minimum(fork, end),
        offset=zero,
        cos=zero,
        sin=zero,
        valid=zero > 0,
    )


def look_up(lane_map: LaneMap, paths: LanePaths, arc_length: Float[Array, "paths places"]) -> tuple[Array, Array]:
    """Positions [m] and unit tangents of the paths at arc lengths [m], both `[paths, places, 2]`."""
    place = jnp.sum(arc_length[..., None] >= paths.start[:, None, 1:], axis=-1)
    piece = jnp.take_along_axis(paths.piece, place, axis=1)
    begin = jnp.take_along_axis(paths.start, place, axis=1)
    at = (arc_length - begin) / lane_map.length[piece] * (LANE_NODES - 1)
    node = jnp.clip(at.astype(jnp.int32), 0, LANE_NODES - 2)
    before, after = lane_map.center[piece, node], lane_map.center[piece, node + 1]
    step = after - before
    tangent = step / jnp.sqrt(jnp.maximum(jnp.sum(step**2, axis=-1, keepdims=True), 1e-9))
    return before + (at - node.astype(at.dtype))[..., None] * step, tangent
