"""The kinematic check: which trajectories a single-track vehicle can drive, and why the others cannot."""

from __future__ import annotations

import functools
import math

import jax
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
    valid: Bool[Array, "*batch trajectories"]
    """`[trajectories]`, along the reference path from start to end, as in `Bundle`."""
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
    point = np.arange(config.points).reshape(-1, *(1,) * bundle.valid.ndim)
    inside = point <= bundle.end_step
    speed, curvature = motion.speed, motion.curvature
    at_points = dict(
        acceleration=_exceeds_acceleration(config, motion.acceleration, speed, curvature) & inside,
        curvature=(jnp.abs(curvature) > vehicle.max_curvature) & (point >= 2) & (point < bundle.end_step - 1),
        backwards=motion.arc_length_rate < -STANDSTILL,
    )
    between_points = dict(
        curvature_rate=_exceeds_curvature_rate(config, curvature) & inside[1:],
        yaw_rate=_exceeds_yaw_rate(config, bundle.pose.cos, bundle.pose.sin, speed) & inside[1:],
    )
    failed = {**_found(at_points), **_found(between_points)}
    feasible = bundle.valid & ~functools.reduce(jnp.logical_or, failed.values())
    verdict = Feasibility(feasible, bundle.valid, **{name: found & bundle.valid for name, found in failed.items()})
    return jax.tree.map(lambda leaf: leaf.reshape(-1), verdict)


def _found(violations: dict[str, Array]) -> dict[str, Array]:
    """Whether each violation occurs at any point.

    They are counted in one sum, each with a digit of its own, which is exact in float32 and vectorised on CPUs.
    """
    base = 1 + max(len(where) for where in violations.values())
    assert base ** len(violations) <= 2**24
    digits = sum(jnp.where(where, float(base**place), 0.0) for place, where in enumerate(violations.values()))
    counts = jnp.sum(digits, axis=0).astype(jnp.int32)
    return {name: counts // base**place % base > 0 for place, name in enumerate(violations)}


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
    before, after = curvature[:-1], curvature[1:]
    change = jnp.abs(after - before)
    if config.curvature_rate_limit != "vehicle":
        return change / DT > config.curvature_rate_limit
    vehicle = config.vehicle
    largest = math.tan(vehicle.max_steering_rate * DT)
    return vehicle.wheelbase * change > largest * jnp.abs(1.0 + vehicle.wheelbase**2 * before * after)


def _exceeds_yaw_rate(config: PlannerConfig, cos: Array, sin: Array, speed: Array) -> Array:
    """Per pair of successive points: |Δθ| > κ_max v dt, by the sine of both, which no heading wraps."""
    turn_cos = cos[:-1] * cos[1:] + sin[:-1] * sin[1:]
    turn_sin = jnp.abs(cos[:-1] * sin[1:] - sin[:-1] * cos[1:])
    largest = (config.vehicle.max_curvature * speed[1:] + YAW_RATE_ROUNDING) * DT
    quarter = jnp.pi / 2
    turned_more = (turn_cos <= 0) | (turn_sin > _sine(jnp.minimum(largest, quarter)))
    return turned_more & (largest < quarter)


def _sine(angle: Array) -> Array:
    """Sine of angles within a quarter turn, to 6e-8: its power series, which unlike `jnp.sin` is vectorised on CPUs."""
    square = angle**2
    series = jnp.ones_like(angle)
    for power in (11, 9, 7, 5, 3):
        series = 1.0 - square / (power * (power - 1)) * series
    return angle * series
