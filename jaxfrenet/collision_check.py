"""The collision check: the cheapest feasible trajectory that hits nothing."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.collision import Box, boxes_overlap, swept_box
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.road import sweeps_edge
from jaxfrenet.scenario import Road
from jaxfrenet.trajectories import Bundle
from jaxfrenet.vehicle import Vehicle

AT_ONCE = 16
"""Trajectories checked together once the cheapest has turned out to collide."""


@pytree_dataclass
class FirstFree:
    """The first trajectory in order of cost that is free of collisions."""

    found: Bool[Array, ""]
    index: Int[Array, ""]
    """Its place in the bundle; of no meaning if none was found."""
    checked: Int[Array, ""]
    """How many feasible trajectories were looked at, in order of cost, up to the free one."""


def collides(
    config: PlannerConfig, bundle: Bundle, index: Int[Array, "some"], prediction: Prediction, road: Road
) -> Bool[Array, "some"]:
    """Whether trajectories hit a predicted obstacle or leave the road.

    Between successive points i and i + 1 the ego's box sweeps an oriented hull; it must not meet any obstacle's box
    predicted for point i + 1, nor the road's edge.

    Args:
      config: the vehicle.
      bundle: the trajectories.
      index: `[some]`, which of them to check.
      prediction: obstacles, their shapes enlarged already; entry 0 is the next step.
      road: the road's edge.
    """
    vehicle, motion = config.vehicle, bundle.motion
    cos, sin = bundle.cos[index], bundle.sin[index]
    x = motion.x[index] + vehicle.rear_axle_to_center * cos
    y = motion.y[index] + vehicle.rear_axle_to_center * sin
    swept = swept_boxes(vehicle, x, y, cos, sin)

    predicted = prediction.first(config.horizon_steps)
    obstacles = Box.from_heading(
        predicted.mean[..., 0],
        predicted.mean[..., 1],
        predicted.heading,
        predicted.length[:, None],
        predicted.width[:, None],
    )
    hits = boxes_overlap(swept.expand_dims(1), obstacles) & predicted.valid
    leaves = sweeps_edge(road, swept, motion.arc_length[index, :-1], motion.offset[index, :-1])
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
    bundle: Bundle,
    feasible: Bool[Array, "trajectories"],
    cost: Float[Array, "trajectories"],
    prediction: Prediction,
    road: Road,
) -> FirstFree:
    """The feasible trajectory of least cost that does not collide, looking only as deep as needed."""
    ranked = jnp.argsort(jnp.where(feasible, cost, jnp.inf)).astype(jnp.int32)
    count = jnp.sum(feasible)
    order = jnp.pad(ranked, (0, AT_ONCE), mode="edge")

    def check(start: Array, number: int) -> tuple[Array, Array]:
        """Whether any of the next `number` in the order is free, and the place of the first that is."""
        index = jax.lax.dynamic_slice(order, (start,), (number,))
        exists = start + jnp.arange(number) < count
        free = exists & ~collides(config, bundle, index, prediction, road)
        return jnp.any(free), start + jnp.argmax(free)

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        found, _, start = carry
        return ~found & (start < count)

    def advance(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        found, place = check(carry[2], AT_ONCE)
        return found, place, carry[2] + AT_ONCE

    found, place = check(jnp.int32(0), 1)
    found, place, _ = jax.lax.while_loop(unfinished, advance, (found, place, jnp.int32(1)))
    return FirstFree(found=found, index=order[place], checked=jnp.where(found, place + 1, count).astype(jnp.int32))
