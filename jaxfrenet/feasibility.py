"""The kinematic check: which trajectories a single-track vehicle can drive, and why the others cannot."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool
from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.trajectories import STANDSTILL, Bundle

YAW_RATE_ROUNDING = 5e-6
"""Yaw rates [rad/s] are compared as if rounded to five decimals."""


@pytree_dataclass
class Feasibility:
    """The verdict per trajectory, and which check it fails; a trajectory may fail several."""

    feasible: Bool[Array, "*batch trajectories"]
    """`[trajectories]`, valid and without any violation."""
    acceleration: Bool[Array, "*batch trajectories"]
    """`[trajectories]`, violates the acceleration limits."""
    curvature: Bool[Array, "*batch trajectories"]
    curvature_rate: Bool[Array, "*batch trajectories"]
    yaw_rate: Bool[Array, "*batch trajectories"]
    backwards: Bool[Array, "*batch trajectories"]
    """`[trajectories]`, drives backwards along the reference path."""


def check(config: PlannerConfig, bundle: Bundle) -> Feasibility:
    """Check every trajectory against the limits of the kinematic single-track model, up to its own end time.

    The limits are those of CommonRoad's vehicle models (Althoff et al. 2017): engine power above the switching speed,
    full steering angle, the yaw rate at full steering angle, and `config.curvature_rate_limit`, or in its place the
    model's own steering rate and friction circle.
    Trajectories that are not valid have no violations.
    """
    motion, vehicle = bundle.motion, config.vehicle
    point = np.arange(config.points)
    inside = point <= bundle.end_step[:, None]
    speed, curvature = motion.speed, motion.curvature
    violations = dict(
        acceleration=_exceeds_acceleration(config, motion.acceleration, speed, curvature) & inside,
        curvature=(jnp.abs(curvature) > vehicle.max_curvature) & (point >= 2) & (point < bundle.end_step[:, None] - 1),
        curvature_rate=_after_first(_exceeds_curvature_rate(config, curvature)) & inside,
        yaw_rate=_after_first(_exceeds_yaw_rate(config, bundle.cos, bundle.sin, speed)) & inside,
        backwards=motion.arc_length_rate < -STANDSTILL,
    )
    failed = {name: jnp.any(where, axis=-1) & bundle.valid for name, where in violations.items()}
    feasible = bundle.valid & ~jnp.any(jnp.stack(list(failed.values())), axis=0)
    return Feasibility(feasible=feasible, **failed)


def _after_first(violated: Array) -> Array:
    """Verdicts on pairs of successive points, as verdicts on points: the first point has no predecessor."""
    return jnp.pad(violated, ((0, 0), (1, 0)))


def _exceeds_acceleration(config: PlannerConfig, acceleration: Array, speed: Array, curvature: Array) -> Array:
    """Per point. The vehicle's own limits include the friction circle a² + (v²κ)² ≤ a_max²."""
    vehicle = config.vehicle
    highest = vehicle.max_acceleration * jnp.minimum(1.0, vehicle.switching_speed / jnp.maximum(speed, 1e-3))
    exceeds = (acceleration < -vehicle.max_acceleration) | (acceleration > highest)
    if config.curvature_rate_limit == "vehicle":
        exceeds |= acceleration**2 + (speed**2 * curvature) ** 2 > vehicle.max_acceleration**2
    return exceeds


def _exceeds_curvature_rate(config: PlannerConfig, curvature: Array) -> Array:
    """Per pair of successive points. The vehicle's own limit bounds the change of δ = atan(wheelbase · κ)."""
    before, after = curvature[:, :-1], curvature[:, 1:]
    change = jnp.abs(after - before)
    if config.curvature_rate_limit != "vehicle":
        return change / DT > config.curvature_rate_limit
    vehicle = config.vehicle
    largest = math.tan(vehicle.max_steering_rate * DT)
    return vehicle.wheelbase * change > largest * jnp.abs(1.0 + vehicle.wheelbase**2 * before * after)


def _exceeds_yaw_rate(config: PlannerConfig, cos: Array, sin: Array, speed: Array) -> Array:
    """Per pair of successive points: |Δθ| > κ_max v dt, by the sine of both, which no heading wraps."""
    turn_cos = cos[:, :-1] * cos[:, 1:] + sin[:, :-1] * sin[:, 1:]
    turn_sin = jnp.abs(cos[:, :-1] * sin[:, 1:] - sin[:, :-1] * cos[:, 1:])
    largest = (config.vehicle.max_curvature * speed[:, 1:] + YAW_RATE_ROUNDING) * DT
    quarter = jnp.pi / 2
    turned_more = jnp.where(turn_cos > 0, turn_sin > jnp.sin(jnp.minimum(largest, quarter)), True)
    return turned_more & (largest < quarter)
