"""The collision check: the cheapest feasible trajectory that hits nothing."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxfrenet._compilation import merging_batches
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.collision import Box, boxes_overlap, swept_box
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.road import sweeps_edge
from jaxfrenet.scenario import Road
from jaxfrenet.trajectories import Motion, Rows, pick
from jaxfrenet.vehicle import Vehicle

AT_ONCE = 16
"""Trajectories checked together once the cheapest has turned out to collide."""
SCENARIOS, SHARE = 8, 16
"""Scenarios of a batch that are looked at again together: this many, or this part of the batch if that is more."""


@pytree_dataclass
class FirstFree:
    """The first trajectory in order of cost that is free of collisions."""

    found: Bool[Array, ""]
    index: Int[Array, ""]
    """Its place in the bundle; of no meaning if none was found."""
    checked: Int[Array, ""]
    """How many feasible trajectories were looked at, in order of cost, up to the free one."""


def collides(config: PlannerConfig, motion: Motion, prediction: Prediction, road: Road) -> Bool[Array, "trajectories"]:
    """Whether trajectories hit a predicted obstacle or leave the road.

    Between successive points i and i + 1 the ego's box sweeps an oriented hull; it must not meet any obstacle's box
    predicted for point i + 1, nor the road's edge.

    Args:
      config: the vehicle.
      motion: `[trajectories, points]`.
      prediction: obstacles, their shapes enlarged already; entry 0 is the next step.
      road: the road's edge.
    """
    pose, ego = motion.pose, motion.ego
    swept = swept_boxes(config.vehicle, *pose.center(config.vehicle), pose.cos, pose.sin)
    predicted = prediction.first(config.horizon_steps)
    obstacles = Box.from_heading(
        predicted.mean[..., 0],
        predicted.mean[..., 1],
        predicted.heading,
        predicted.length[:, None],
        predicted.width[:, None],
    )
    hits = boxes_overlap(swept.expand_dims(1), obstacles) & predicted.valid
    leaves = sweeps_edge(road, swept, ego.arc_length[:, :-1], ego.offset[:, :-1])
    return jnp.any(hits, axis=(1, 2)) | jnp.any(leaves, axis=1)


def swept_boxes(vehicle: Vehicle, x: Array, y: Array, cos: Array, sin: Array) -> Box:
    """The oriented hulls `[..., points - 1]` that the ego's box sweeps between successive points.

    Args:
      vehicle: its size.
      x: `[..., points]` of its centre [m]; also `y`, and `cos`, `sin` of its heading.
      y: see `x`.
      cos: see `x`.
      sin: see `x`.
    """
    half = jnp.full_like(x, 0.5 * vehicle.length), jnp.full_like(x, 0.5 * vehicle.width)
    before = Box(*(value[..., :-1] for value in (x, y, cos, sin, *half)))
    after = Box(*(value[..., 1:] for value in (x, y, cos, sin, *half)))
    return swept_box(before, after)


def first_free(
    config: PlannerConfig,
    rows: Rows,
    feasible: Bool[Array, "trajectories"],
    cost: Float[Array, "trajectories"],
    prediction: Prediction,
    road: Road,
) -> FirstFree:
    """The feasible trajectory of least cost that does not collide, looking only as deep as needed."""
    cost = jnp.where(feasible, cost, jnp.inf)
    cheapest = jnp.argmin(cost).astype(jnp.int32)
    free = feasible[cheapest] & ~collides(config, pick(rows, cheapest[None]), prediction, road)[0]
    cost = cost.at[cheapest].set(jnp.inf)
    state = _Search(cost, FirstFree(found=free, index=cheapest, checked=jnp.any(feasible).astype(jnp.int32)))
    return _searcher(config)(state, rows, prediction, road)


@pytree_dataclass
class _Search:
    """How far the search for a free trajectory has come; leading axis `scenarios` in a batch."""

    cost: Float[Array, "*batch trajectories"]
    """Infinite for trajectories that are infeasible or have been looked at."""
    result: FirstFree


@functools.cache
def _searcher(config: PlannerConfig) -> Callable[[_Search, Rows, Prediction, Road], FirstFree]:
    """`_search` for one scenario; in a batch, only those are looked at again that have not found one yet."""
    return merging_batches(functools.partial(_search, config))


def _search(config: PlannerConfig, state: _Search, rows: Rows, prediction: Prediction, road: Road) -> FirstFree:
    """Go on with the search in a batch of scenarios until each has found a free trajectory or has none left."""
    batch = len(state.cost)
    together = min(max(SCENARIOS, batch // SHARE), batch)

    def unfinished(state: _Search) -> Array:
        return ~state.result.found & jnp.any(jnp.isfinite(state.cost), axis=-1)

    def advance(state: _Search) -> _Search:
        waiting, which = jax.lax.top_k(unfinished(state).astype(jnp.int32), together)
        some = jax.tree.map(lambda leaf: leaf[which], (state, rows, prediction, road))
        moved = jax.vmap(functools.partial(_look_deeper, config))(*some)

        def put(old: Array, new: Array, some: Array) -> Array:
            is_waiting = (waiting == 1).reshape(-1, *(1,) * (new.ndim - 1))
            return old.at[which].set(jnp.where(is_waiting, new, some))

        return jax.tree.map(put, state, moved, some[0])

    return jax.lax.while_loop(lambda state: jnp.any(unfinished(state)), advance, state).result


def _look_deeper(config: PlannerConfig, state: _Search, rows: Rows, prediction: Prediction, road: Road) -> _Search:
    """Look at the next trajectories of one scenario."""
    at_once = min(AT_ONCE, state.cost.size)
    cheapness, index = jax.lax.top_k(-state.cost, at_once)
    exists = jnp.isfinite(cheapness)
    free = exists & ~collides(config, pick(rows, index), prediction, road)
    found, first = jnp.any(free), jnp.argmax(free)
    looked_at = jnp.where(found, first + 1, jnp.sum(exists)).astype(jnp.int32)
    result = FirstFree(found, index[first], state.result.checked + looked_at)
    return _Search(state.cost.at[index].set(jnp.inf), result)
