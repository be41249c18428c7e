"""What an agent sees (paper, table "Observation space"): a table of fields, and their values after a step.

No field is a position on the map. What depends on a planning cycle tells of the last one, and is zero at the start of
an episode, where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._angles import wrapped
from jaxfrenet._typing import Array, Bool, Float
from jaxfrenet.config import DT, PlannerConfig
from jaxfrenet.costs import COST_TERMS
from jaxfrenet.environment.action import normalized
from jaxfrenet.environment.config import EnvironmentConfig
from jaxfrenet.goal import in_region, last_step
from jaxfrenet.planner import PlanMode, PlanningCycle
from jaxfrenet.reference_path import ReferencePath, look_up
from jaxfrenet.scenario import Scenario
from jaxfrenet.simulation import StepReport
from jaxfrenet.state import SimulationState

NEAREST = 5
"""Obstacles that are told of, nearest first."""
LARGEST = 5.0
"""Linear fields are clipped to this times their scale, to either side."""
FARTHEST_ALONG = 5.0
"""An obstacle that lies farther [m] beyond the reference path's ends is in no lane of its."""
OWN, LEFT, RIGHT = range(3)


@dataclass(frozen=True)
class Field:
    """One number of the observation: `value / scale`, or `log(1 + value / scale) / 10`."""

    name: str
    unit: str
    scale: float
    kind: Literal["linear", "log"] = "linear"


EGO = (
    Field("speed", "m/s", 10.0),
    Field("acceleration", "m/s²", 5.0),
    Field("longitudinal_jerk", "m/s³", 20.0),
    Field("lateral_jerk", "m/s³", 20.0),
    Field("steering_angle", "rad", 0.5),
    Field("yaw_rate", "rad/s", 0.5),
    Field("heading_to_path", "rad", 0.5),
    Field("offset", "m", 3.5),
)
GOAL = (
    Field("goal_distance", "m", 50.0),
    Field("goal_share_of_way", "1", 1.0),
    Field("goal_remaining_time", "s", 15.0),
    Field("goal_region_reached", "bool", 1.0),
    Field("goal_speed_met", "bool", 1.0),
    Field("goal_time_over", "bool", 1.0),
    Field("goal_speed_difference", "m/s", 5.0),
)
LANES = tuple(
    Field(f"lane_{side}_{what}", "bool", 1.0) for side in ("left", "right") for what in ("exists", "same_direction")
)
OBSTACLE = (
    Field("ahead", "m", 30.0),
    Field("left", "m", 30.0),
    Field("heading", "rad", float(np.pi)),
    Field("speed", "m/s", 10.0),
    Field("distance", "m", 30.0),
    Field("same_lane", "bool", 1.0),
    Field("valid", "bool", 1.0),
)
TRAJECTORY = (
    Field("feasible_share", "1", 1.0),
    Field("ego_risk", "1", 1e-12, "log"),
    Field("third_party_risk", "1", 1e-12, "log"),
    Field("colliding", "bool", 1.0),
    Field("infeasible", "bool", 1.0),
)
OUTERMOST = tuple(
    Field(f"prediction_{speed}_{side}", "1", 1e-3, "log")
    for side in ("right", "middle", "left")
    for speed in ("slow", "medium", "fast")
)
COST_STATISTICS = "chosen", "mean", "variance"


def observation_fields(config: EnvironmentConfig) -> tuple[Field, ...]:
    """Every field of the observation, in order."""
    nearest = [Field(f"obstacle_{i + 1}_{f.name}", f.unit, f.scale, f.kind) for i in range(NEAREST) for f in OBSTACLE]
    terms = _terms(config)
    costs = [Field(f"cost_{term}_{what}", "1", _cost_scale(term), "log") for term in terms for what in COST_STATISTICS]
    weights = [Field(f"weight_{one.term}", "low … high", 1.0) for one in config.adjustments]
    return (*EGO, *GOAL, *LANES, *nearest, *TRAJECTORY, *costs, *OUTERMOST, *weights)


def _terms(config: EnvironmentConfig) -> list[str]:
    """The cost terms that are switched on, in the order of the planner's costs."""
    adjusted = {one.term for one in config.adjustments}
    extra = [one.term for one in config.adjustments if one.cost is not None]
    return [term for term in COST_TERMS if term in adjusted] + extra


def _cost_scale(term: str) -> float:
    return 1e-3 if term == "prediction" else 1.0


def first_observation(
    config: EnvironmentConfig, scenario: Scenario, state: SimulationState, weights: Float[Array, "actions"]
) -> Float[Array, "fields"]:
    """`[fields]`, what is seen at the start of an episode."""
    planner, ego = config.planner, state.ego
    unknown = len(TRAJECTORY) + len(COST_STATISTICS) * len(_terms(config)) + len(OUTERMOST)
    parts = [
        _ego(planner, scenario.path, state, state),
        _goal(planner, scenario, state, ego.arc_length, ego.speed),
        _surroundings(planner, scenario, state),
        jnp.zeros(unknown),
        normalized(config.adjustments, weights),
    ]
    return _normalized(config, parts)


def observe(
    config: EnvironmentConfig,
    scenario: Scenario,
    before: SimulationState,
    after: SimulationState,
    start: Float[Array, ""],
    cycle: PlanningCycle,
    report: StepReport,
    weights: Float[Array, "actions"],
) -> Float[Array, "fields"]:
    """`[fields]`, what is seen after a step, see `observation_fields`.

    Args:
      config: says which fields there are.
      scenario: one scenario.
      before: the state before the step.
      after: the state after it.
      start: `[]`, m, arc length at which the episode began.
      cycle: the step's planning cycle.
      report: what the step told.
      weights: `[actions]`, the step's cost weights.
    """
    planner = config.planner
    parts = [
        _ego(planner, scenario.path, before, after),
        _goal(planner, scenario, after, start, report.desired_speed),
        _surroundings(planner, scenario, after),
        _trajectory(cycle, report),
        _costs(cycle, report),
        _outermost(config, cycle),
        normalized(config.adjustments, weights),
    ]
    return _normalized(config, parts)


def _normalized(config: EnvironmentConfig, parts: list[Array]) -> Float[Array, "fields"]:
    fields = observation_fields(config)
    values = jnp.concatenate(parts)
    scale = np.asarray([field.scale for field in fields], np.float32)
    is_log = np.asarray([field.kind == "log" for field in fields])
    scaled = values / scale
    linear = jnp.clip(scaled, -LARGEST, LARGEST)
    return jnp.where(is_log, jnp.log1p(jnp.maximum(jnp.where(is_log, scaled, 0.0), 0.0)) / 10.0, linear)


def _ego(config: PlannerConfig, path: ReferencePath, before: SimulationState, after: SimulationState) -> Array:
    ego, last = after.ego, before.ego
    turn = ego.heading - look_up(path, ego.arc_length).heading
    return jnp.stack(
        [
            ego.speed,
            ego.acceleration,
            (ego.acceleration - last.acceleration) / DT,
            (ego.curvature * ego.speed**2 - last.curvature * last.speed**2) / DT,
            jnp.arctan(config.vehicle.wheelbase * ego.curvature),
            ego.curvature * ego.speed,
            wrapped(turn),
            ego.offset,
        ]
    )


def _goal(
    config: PlannerConfig, scenario: Scenario, state: SimulationState, start: Array, desired_speed: Array
) -> Array:
    goal, vehicle = scenario.goal, config.vehicle
    speed, place = state.ego.speed, state.ego.arc_length + vehicle.rear_axle_to_center
    target = 0.5 * jnp.sum(goal.arc_length[0])
    way = jnp.maximum(target - start - vehicle.rear_axle_to_center, 1.0)
    remaining = DT * (last_step(goal) - state.step).astype(jnp.float32)
    in_speed = goal.valid & (speed >= goal.speed[:, 0]) & (speed <= goal.speed[:, 1])
    return jnp.stack(
        [
            target - place,
            jnp.clip(1.0 - (target - place) / way, 0.0, 1.0),
            remaining,
            _number(jnp.any(in_region(goal, state.center(vehicle)))),
            _number(jnp.any(in_speed)),
            _number(remaining < 0.0),
            speed - desired_speed,
        ]
    )


def _surroundings(config: PlannerConfig, scenario: Scenario, state: SimulationState) -> Array:
    """Neighbouring lanes, then the nearest obstacles, as they are now."""
    ego, center, obstacles = state.ego, state.center(config.vehicle), scenario.obstacles
    node = jnp.argmin(jnp.abs(scenario.path.arc_length - ego.arc_length))
    direction = scenario.lanes.direction[node]
    lanes = [_number(direction[side] == which) for side in (LEFT, RIGHT) for which in (1, -1)]
    lanes = [lanes[0] + lanes[1], lanes[0], lanes[2] + lanes[3], lanes[2]]
    now = jnp.minimum(state.step, obstacles.valid.shape[1] - 1)
    away = obstacles.position[:, now] - center
    squared = jnp.sum(away**2, axis=-1)
    seen = obstacles.present(state.step) & (squared <= config.sensor_radius**2)
    missing = max(0, NEAREST - seen.shape[0])
    keyed = jnp.pad(jnp.where(seen, squared, jnp.inf), (0, missing), constant_values=jnp.inf)
    _, nearest = jax.lax.top_k(-keyed, NEAREST)
    nearest = jnp.minimum(nearest, seen.shape[0] - 1)
    told = seen[nearest] & (jnp.arange(NEAREST) < jnp.sum(seen))
    position, heading = obstacles.position[nearest, now], obstacles.heading[nearest, now]
    cos, sin = jnp.cos(ego.heading), jnp.sin(ego.heading)
    dx, dy = position[:, 0] - center[0], position[:, 1] - center[1]
    columns = [
        dx * cos + dy * sin,
        dy * cos - dx * sin,
        wrapped(heading - ego.heading),
        obstacles.speed[nearest, now],
        jnp.sqrt(squared[nearest]),
        _number(_in_own_lane(scenario, position)),
        jnp.ones(NEAREST),
    ]
    rows = jnp.where(told[:, None], jnp.stack(columns, axis=-1), 0.0)
    return jnp.concatenate([jnp.stack(lanes), rows.reshape(-1)])


def _in_own_lane(scenario: Scenario, position: Float[Array, "some 2"]) -> Bool[Array, "some"]:
    """Whether positions lie in the lane that the reference path runs along, told from the path's nearest node."""
    path, lanes = scenario.path, scenario.lanes
    dx, dy = position[:, :1] - path.x, position[:, 1:] - path.y
    node = jnp.argmin(dx**2 + dy**2, axis=-1)
    dx, dy = position[:, 0] - path.x[node], position[:, 1] - path.y[node]
    cos, sin = jnp.cos(path.heading[node]), jnp.sin(path.heading[node])
    along, offset = dx * cos + dy * sin, dy * cos - dx * sin
    beside = jnp.abs(offset - lanes.center[node, OWN]) <= 0.5 * lanes.width[node, OWN]
    return beside & (jnp.abs(along) <= FARTHEST_ALONG)


def _trajectory(cycle: PlanningCycle, report: StepReport) -> Array:
    colliding = (cycle.mode == PlanMode.EMERGENCY) | (cycle.mode == PlanMode.STANDSTILL)
    return jnp.stack(
        [
            report.feasible_share,
            report.ego_risk,
            report.third_party_risk,
            _number(colliding),
            _number(cycle.mode == PlanMode.INFEASIBLE),
        ]
    )


def _costs(cycle: PlanningCycle, report: StepReport) -> Array:
    """Of each term the chosen trajectory's cost, and mean and variance over the valid trajectories."""
    valid = cycle.feasibility.valid[:, None]
    count = jnp.maximum(jnp.sum(_number(valid)), 1.0)
    mean = jnp.sum(jnp.where(valid, cycle.costs, 0.0), axis=0) / count
    variance = jnp.sum(jnp.where(valid, (cycle.costs - mean) ** 2, 0.0), axis=0) / count
    return jnp.stack([report.costs, mean, variance], axis=-1).reshape(-1)


def _outermost(config: EnvironmentConfig, cycle: PlanningCycle) -> Array:
    """Collision-probability cost of the outermost trajectories at the longest end time.

    Zero for those that leave the reference path, and without that cost term.
    """
    planner, terms = config.planner, _terms(config)
    if "prediction" not in terms:
        return jnp.zeros(len(OUTERMOST))
    count, times = planner.samples_per_axis, len(planner.end_steps)
    ends = np.asarray([0, count // 2, count - 1])
    offset, speed = np.repeat(ends, 3), np.tile(ends, 3)
    places = (offset * (count + 1) + speed) * times + times - 1
    cost = cycle.costs[places, terms.index("prediction")]
    return jnp.where(cycle.feasibility.valid[places], cost, 0.0)


def _number(value: Array) -> Array:
    return value.astype(jnp.float32)
