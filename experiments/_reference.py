"""The published C++ planner, the wheel `frenetix`, given the same trajectories and predictions as ours.

It generates the bundle, checks its kinematics, evaluates and sorts; it looks at neither collisions nor the road's edge.
Everything that it lets a caller prepare (path, cost functions, predictions) is prepared before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

import jaxfrenet as jf
from jaxfrenet._typing import Array
from jaxfrenet.goal import desired_speed
from jaxfrenet.sampling import EndStates, sample_end_states
from scenarios.command_line import UserError

MOTION_TERMS = {
    "lateral_jerk": "CalculateLateralJerkCost",
    "longitudinal_jerk": "CalculateLongitudinalJerkCost",
    "distance_to_reference_path": "CalculateDistanceToReferencePathCost",
}
"""Cost terms that take no settings, and the reference's names for them."""
OFF_CENTER_WEIGHT = 0.5
"""Weight of an obstacle's corners in the collision probability; its centre has 1."""
NORM_ORDER = 2


@dataclass(frozen=True)
class Traffic:
    """Predictions as the reference takes them; float64."""

    position: NDArray[np.float64]
    """`[obstacles, steps, 2]`, m, centres; entry 0 is the next step."""
    heading: NDArray[np.float64]
    """`[obstacles, steps]`, rad."""
    covariance: NDArray[np.float64]
    """`[obstacles, steps, 2, 2]`, m²."""
    entries: NDArray[np.int64]
    """`[obstacles]`, steps that are predicted. The reference leaves the last of them out."""
    size: NDArray[np.float64]
    """`[obstacles, 2]`, m, length and width."""


@dataclass(frozen=True)
class ReferenceCase:
    """One planning cycle's inputs; float64."""

    path: NDArray[np.float64]
    """`[nodes, 2]`, m, the reference path."""
    samples: NDArray[np.float64]
    """`[trajectories, 13]`: start and end time [s], arc length and its first two derivatives at the start, the latter
    two at the end, offset and its first two derivatives at the start, then at the end [m, m/s, m/s²]. Below the low
    speed threshold the offset's derivatives are by arc length."""
    heading: float
    """rad, of the ego."""
    desired_speed: float
    """m/s."""
    low_velocity: bool
    """Whether the lateral polynomial runs over arc length."""
    traffic: Traffic


class Evaluated(NamedTuple):
    """What the reference found for each trajectory; NaN or -1 where it is not valid."""

    valid: NDArray[np.bool_]
    """`[trajectories]`, whether it stays on the reference path."""
    feasible: NDArray[np.bool_]
    """`[trajectories]`."""
    cost: NDArray[np.float64]
    """`[trajectories]`, weighted sum."""
    rank: NDArray[np.int64]
    """`[trajectories]`, place in the reference's order."""


class ReferencePlanner:
    """The reference made ready for one planning cycle, which can then be run any number of times."""

    def __init__(self, config: jf.PlannerConfig, weights: jf.CostWeights, case: ReferenceCase) -> None:
        """Set up path, functions and predictions.

        Raises:
          UserError: the reference is not installed, or knows no such cost term.
        """
        frenetix = load_reference()
        self._case = case
        self._handler = frenetix.TrajectoryHandler(jf.DT)
        functions = frenetix.trajectory_functions
        self._path = frenetix.CoordinateSystemWrapper(np.ascontiguousarray(case.path))
        horizon = jf.DT * config.horizon_steps
        fill = functions.FillCoordinates(case.low_velocity, case.heading, self._path, horizon)
        self._handler.add_function(fill)
        for check in _checks(functions.feasability_functions, config):
            self._handler.add_feasability_function(check)
        for term in _terms(frenetix, config, weights, case):
            self._handler.add_cost_function(term)

    def serial(self) -> None:
        """Run the cycle on one core."""
        self._run(self._handler.evaluate_all_current_functions)

    def concurrent(self) -> None:
        """Run the cycle on all cores."""
        self._run(self._handler.evaluate_all_current_functions_concurrent)

    def _run(self, evaluate: Callable[[bool], None]) -> None:
        self._handler.reset_Trajectories()
        self._handler.generate_trajectories(self._case.samples, self._case.low_velocity)
        evaluate(True)
        self._handler.sort()

    def evaluated(self) -> Evaluated:
        """What the last run found, by the rows of the samples."""
        count = len(self._case.samples)
        found = Evaluated(
            np.zeros(count, bool), np.zeros(count, bool), np.full(count, np.nan), np.full(count, -1, np.int64)
        )
        for place, one in enumerate(self._handler.get_sorted_trajectories()):
            row = one.uniqueId
            found.valid[row], found.feasible[row] = one.valid, one.feasible
            if one.valid:
                found.cost[row], found.rank[row] = one.cost, place
        return found


def reference_case(config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState) -> ReferenceCase:
    """The inputs of the planning cycle that `jf.plan` runs on one scenario and one state, without batch axes."""
    prepared = jax.device_get(_prepared(config, scenario, state))
    ego, path = jax.device_get(state.ego), jax.device_get(scenario.path)
    low = bool(ego.speed < config.low_velocity_threshold)
    nodes = path.arc_length <= path.length
    return ReferenceCase(
        path=np.stack([path.x, path.y], axis=-1)[nodes].astype(np.float64),
        samples=_samples(config, ego, prepared.end_states, low),
        heading=float(ego.heading),
        desired_speed=float(prepared.desired_speed),
        low_velocity=low,
        traffic=_traffic(prepared.prediction),
    )


class _Prepared(NamedTuple):
    """What ours works out before it samples."""

    end_states: EndStates
    desired_speed: Array
    prediction: jf.Prediction


@partial(jax.jit, static_argnums=0)
def _prepared(config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState) -> _Prepared:
    ego = state.ego
    center, arc_length = state.center(config.vehicle), ego.arc_length + config.vehicle.rear_axle_to_center
    return _Prepared(
        sample_end_states(config, ego.speed, ego.arc_length_rate, ego.offset),
        desired_speed(scenario.goal, state.step, center, arc_length, ego.speed),
        jf.predict(config, scenario, state.step, ego.x, ego.y),
    )


def _samples(config: jf.PlannerConfig, ego: jf.EgoState, end: EndStates, low: bool) -> NDArray[np.float64]:
    """`[trajectories, 13]`, see `ReferenceCase.samples`: all combinations, end offset innermost."""
    along = ego.arc_length, ego.arc_length_rate, ego.arc_length_acceleration
    rate = ego.offset_slope * ego.arc_length_rate
    second = ego.offset_bend * ego.arc_length_rate**2 + ego.offset_slope * ego.arc_length_acceleration
    across = (ego.offset, ego.offset_slope, ego.offset_bend) if low else (ego.offset, rate, second)
    time, speed, offset = np.meshgrid(jf.DT * config.end_steps, end.speed, end.offset, indexing="ij")
    samples = np.zeros((time.size, 13))
    samples[:, 1], samples[:, 5], samples[:, 10] = time.ravel(), speed.ravel(), offset.ravel()
    samples[:, 2:5], samples[:, 7:10] = along, across
    return samples


def _traffic(prediction: jf.Prediction) -> Traffic:
    """The prediction with its last step repeated, as the reference leaves the last one out; sizes enlarged as ours."""
    entries = np.sum(prediction.valid, axis=1)

    def repeated(values: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(values, np.float64)
        return np.concatenate([values, values[:, -1:]], axis=1)

    return Traffic(
        position=repeated(prediction.mean),
        heading=repeated(prediction.heading),
        covariance=repeated(prediction.covariance),
        entries=np.where(entries > 0, entries + 1, 0),
        size=np.stack([prediction.length, prediction.width], axis=-1).astype(np.float64),
    )


def load_reference() -> ModuleType:
    """The module `frenetix`.

    Raises:
      UserError: it is not installed.
    """
    try:
        import frenetix  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise UserError(
            "--reference needs frenetix, which is not installed; install jaxfrenet[reference] on Python 3.11 or 3.12"
        ) from None
    return frenetix


def _checks(functions: Any, config: jf.PlannerConfig) -> list[Any]:
    """The kinematic checks that ours has, too."""
    vehicle = config.vehicle
    limit = config.curvature_rate_limit
    if limit == "vehicle":
        raise UserError('the reference knows no curvature rate limit "vehicle"; give a number')
    angle, wheelbase = vehicle.max_steering_angle, vehicle.wheelbase
    return [
        functions.CheckYawRateConstraint(angle, wheelbase, False),
        functions.CheckAccelerationConstraint(vehicle.switching_speed, vehicle.max_acceleration, False),
        functions.CheckCurvatureConstraint(angle, wheelbase, False),
        functions.CheckCurvatureRateConstraint(wheelbase, limit, False),
    ]


def _terms(module: Any, config: jf.PlannerConfig, weights: jf.CostWeights, case: ReferenceCase) -> list[Any]:
    """The cost terms that have a weight."""
    functions, vehicle = module.trajectory_functions.cost_functions, config.vehicle
    terms = []
    for name in weights.names():
        weight = float(getattr(weights, name))
        if name in MOTION_TERMS:
            terms.append(getattr(functions, MOTION_TERMS[name])(name, weight))
        elif name == "velocity_offset":
            earliest = jf.DT * config.shortest_end_step
            speed = case.desired_speed
            terms.append(functions.CalculateVelocityOffsetCost(name, weight, speed, jf.DT, earliest, False, NORM_ORDER))
        elif name == "prediction":
            size = vehicle.length, vehicle.width, vehicle.rear_axle_to_center
            predicted = _predicted_objects(module, case.traffic)
            terms.append(functions.CalculateCollisionProbabilityFast(name, weight, predicted, *size, OFF_CENTER_WEIGHT))
        else:
            raise UserError(f"the reference is not asked for the cost term {name!r}; leave it without a weight")
    return terms


def _predicted_objects(module: Any, traffic: Traffic) -> dict[int, Any]:
    """The reference's own containers, by number; obstacles without any prediction are left out."""
    found = {}
    for number, entries in enumerate(traffic.entries):
        poses = []
        for step in range(entries):
            covariance = np.zeros((6, 6), order="F")
            covariance[:2, :2] = traffic.covariance[number, step]
            half = 0.5 * traffic.heading[number, step]
            quaternion = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
            position = np.append(traffic.position[number, step], 0.0)
            poses.append(module.PoseWithCovariance(position, quaternion, covariance))
        if poses:
            found[number] = module.PredictedObject(number, poses, *map(float, traffic.size[number]))
    return found
