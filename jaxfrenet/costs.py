"""The cost terms that rank feasible trajectories, and their weights.

A term is one function of `CostInputs`, named as in the reference planner; `COST_TERMS` lists them. It takes values
`[points, ...]` of the bundle to one cost per trajectory `[...]`. Which terms a program computes is decided by which
weights are given: a weight of `None` leaves its term out of the program. `CostWeights.extra` brings terms of one's own.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass, static_field
from jaxfrenet._typing import Array, Float
from jaxfrenet.collision_probability import collision_probability_cost
from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.reference_path import ReferencePath, look_up_columns
from jaxfrenet.scenario import Lanes
from jaxfrenet.trajectories import Bundle, Rows

LARGEST_COST = 1e12
"""Costs end here, so that their squares and sums stay finite."""
Weight = Array | float | None
"""A number, an array of shape `[]` (or `[batch]` under `vmap`), or nothing."""


@pytree_dataclass
class CostInputs:
    """What a cost term may look at."""

    rows: Rows
    bundle: Bundle
    prediction: Prediction
    desired_speed: Float[Array, ""]
    """`[]`, m/s."""
    path: ReferencePath
    lanes: Lanes


CostTerm = Callable[[PlannerConfig, CostInputs], Array]
"""Takes values `[points, ...]` of the bundle to one cost per trajectory `[...]`."""


@pytree_dataclass
class ExtraTerm:
    """A cost term that is not one of `COST_TERMS`, and its weight."""

    cost: CostTerm = static_field()
    """A named function; another function, even one that does the same, compiles anew."""
    weight: Array | float = 1.0
    """A number, or an array of shape `[]`."""


@pytree_dataclass
class CostWeights:
    """Weights of the cost terms; the defaults are the paper's default planner. `None` switches a term off."""

    lateral_jerk: Weight = 1.0
    longitudinal_jerk: Weight = 1.0
    distance_to_reference_path: Weight = 1.0
    velocity_offset: Weight = 1.0
    prediction: Weight = 200.0
    acceleration: Weight = None
    jerk: Weight = None
    orientation_offset: Weight = None
    lane_center_offset: Weight = None
    distance_to_obstacles: Weight = None
    velocity: Weight = None
    path_length: Weight = None
    lateral_velocity: Weight = None
    steering_angle: Weight = None
    steering_rate: Weight = None
    yaw_rate: Weight = None
    extra: tuple[ExtraTerm, ...] = ()
    """Terms of one's own."""

    def names(self) -> tuple[str, ...]:
        """The terms that are switched on, in the order of the fields, then the extra ones by their functions' names."""
        return tuple(term.__name__ for term, _ in self._terms())

    def values(self) -> Float[Array, "terms"]:
        """`[terms]`, the weights of `names()`."""
        return jnp.stack([jnp.asarray(weight, jnp.float32) for _, weight in self._terms()])

    def functions(self) -> tuple[CostTerm, ...]:
        """What computes the terms of `names()`."""
        return tuple(term for term, _ in self._terms())

    def _terms(self) -> list[tuple[CostTerm, Array | float]]:
        own = [(term, getattr(self, name)) for name, term in COST_TERMS.items()]
        return [term for term in own if term[1] is not None] + [(one.cost, one.weight) for one in self.extra]


def evaluate(config: PlannerConfig, weights: CostWeights, inputs: CostInputs) -> Float[Array, "trajectories terms"]:
    """Unweighted costs `[trajectories, terms]` of the terms that are switched on, in the order of `weights.names()`.

    At most `LARGEST_COST`, also where an infeasible trajectory's speed or curvature leaves float32's range.
    """
    every = jnp.stack([term(config, inputs).reshape(-1) for term in weights.functions()], axis=-1)
    return jnp.where(every < LARGEST_COST, every, LARGEST_COST)


def _norm(value: Array) -> Array:
    return jnp.sqrt(jnp.sum(value**2, axis=0))


def _last_half(value: Array) -> Array:
    """The last ⌊n/2⌋ of n points."""
    return value[-(value.shape[0] // 2) :]


def _integral(value: Array) -> Array:
    """Simpson's rule over the points; with an even number of them the last interval counts a third of its trapezoid.

    That share is the reference planner's, kept so that the terms compare.
    """
    points = value.shape[0]
    weights = np.zeros(points)
    even = points if points % 2 == 1 else points - 1
    weights[:even] = np.where(np.arange(even) % 2 == 1, 4.0, 2.0)
    weights[[0, even - 1]] = 1.0
    weights *= DT / 3
    if points % 2 == 0:
        weights[-2:] += DT / 6
    return jnp.tensordot(jnp.asarray(weights, jnp.float32), value, axes=1)


def _difference(value: Array) -> Array:
    """Rate of change between successive points."""
    return (value[1:] - value[:-1]) / DT


def lateral_jerk(config: PlannerConfig, inputs: CostInputs) -> Array:
    """√∫ d⃛² dt over the quintic, in closed form [m/s^2.5; m^-1.5 in low-velocity mode]."""
    return inputs.bundle.lateral_jerk


def longitudinal_jerk(config: PlannerConfig, inputs: CostInputs) -> Array:
    """√∫ s⃛² dt over the quartic, in closed form [m/s^2.5]."""
    return inputs.bundle.longitudinal_jerk


def distance_to_reference_path(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Norm of the offset over the last half of the points [m]."""
    return _norm(_last_half(inputs.bundle.motion.offset))


def velocity_offset(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Norm of the difference to the desired speed over all points [m/s]."""
    return _norm(inputs.bundle.motion.speed - inputs.desired_speed)


def prediction(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Collision probability with the predicted obstacles, see `collision_probability_cost`."""
    return collision_probability_cost(config, inputs.rows, inputs.prediction)


def acceleration(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ a² dt [m²/s³]."""
    return _integral(inputs.bundle.motion.acceleration**2)


def jerk(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ ȧ² dt, from differences [m²/s⁵]."""
    return _integral(_difference(inputs.bundle.motion.acceleration) ** 2)


def orientation_offset(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Norm of the heading relative to the path over the last half of the points, plus its last value squared [rad]."""
    relative = jnp.arctan(_last_half(inputs.bundle.pose.relative_tangent))
    return _norm(relative) + relative[-1] ** 2


def lane_center_offset(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Norm over all points of the distance to the centre line of the nearest lane [m]."""
    motion = inputs.bundle.motion
    columns = jnp.concatenate([inputs.lanes.center, (inputs.lanes.direction != 0).astype(jnp.float32)], axis=-1)
    table = look_up_columns(inputs.path, columns, inputs.rows.points.arc_length)
    lanes = [jnp.where(table[..., 3 + lane] > 0.5, table[..., lane], jnp.inf) for lane in range(3)]
    away = [jnp.abs(motion.offset - center[:, None]) for center in lanes]
    nearest = functools.reduce(jnp.minimum, away)
    return _norm(jnp.where(jnp.isfinite(nearest), nearest, jnp.abs(motion.offset)))


def distance_to_obstacles(config: PlannerConfig, inputs: CostInputs) -> Array:
    """Σ over obstacles and points of 1 / distance² to the obstacle's centre predicted for that time [1/m²]."""
    motion, steps = inputs.bundle.motion, config.horizon_steps
    predicted = inputs.prediction.first(steps)
    dx = motion.x[1:] - predicted.mean[..., 0, None, None]
    dy = motion.y[1:] - predicted.mean[..., 1, None, None]
    inverse = 1.0 / jnp.maximum(dx**2 + dy**2, 1e-2)
    return jnp.sum(jnp.where(predicted.valid[..., None, None], inverse, 0.0), axis=(0, 1))


def velocity(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ v² dt [m²/s]: slower is cheaper."""
    return _integral(inputs.bundle.motion.speed**2)


def path_length(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ v dt [m]."""
    return _integral(inputs.bundle.motion.speed)


def lateral_velocity(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ ḋ² dt [m²/s]."""
    motion = inputs.bundle.motion
    return _integral((motion.offset_slope * motion.arc_length_rate) ** 2)


def _steering_angle(config: PlannerConfig, inputs: CostInputs) -> Array:
    return jnp.arctan(config.vehicle.wheelbase * inputs.bundle.motion.curvature)


def steering_angle(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ δ² dt, δ = atan(wheelbase · κ) [rad² s]."""
    return _integral(_steering_angle(config, inputs) ** 2)


def steering_rate(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ δ̇² dt, from differences [rad²/s]."""
    return _integral(_difference(_steering_angle(config, inputs)) ** 2)


def yaw_rate(config: PlannerConfig, inputs: CostInputs) -> Array:
    """∫ θ̇² dt, θ̇ = κ v [rad²/s]."""
    motion = inputs.bundle.motion
    return _integral((motion.curvature * motion.speed) ** 2)


COST_TERMS: dict[str, CostTerm] = {
    term.__name__: term
    for term in (
        lateral_jerk,
        longitudinal_jerk,
        distance_to_reference_path,
        velocity_offset,
        prediction,
        acceleration,
        jerk,
        orientation_offset,
        lane_center_offset,
        distance_to_obstacles,
        velocity,
        path_length,
        lateral_velocity,
        steering_angle,
        steering_rate,
        yaw_rate,
    )
}
"""The planner's own terms by name, in the order of the fields of `CostWeights`."""
