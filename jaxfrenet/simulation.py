"""The closed loop: plan, move one step along the chosen trajectory, judge against what was recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.collision import Box, boxes_overlap
from jaxfrenet.config import PlannerConfig
from jaxfrenet.costs import CostWeights
from jaxfrenet.goal import judge, last_step
from jaxfrenet.planner import PlanMode, PlanningCycle, plan
from jaxfrenet.prediction import with_predictions
from jaxfrenet.reference_path import look_up, project
from jaxfrenet.road import is_off_road
from jaxfrenet.sampling import SamplingRange
from jaxfrenet.scenario import Obstacles, Scenario
from jaxfrenet.state import Outcome, SimulationState
from jaxfrenet.trajectories import EgoState, initial_ego_state

Memory = TypeVar("Memory")
TIME_LIMIT = 13, 10
"""An episode ends after this ratio times the goal's last step, compared in integers."""


@pytree_dataclass
class StepReport:
    """What one step of the closed loop tells about itself."""

    mode: Int[Array, "*batch"]
    """`[]`, a `PlanMode`."""
    desired_speed: Float[Array, "*batch"]
    """`[]`, m/s."""
    costs: Float[Array, "*batch terms"]
    """`[terms]`, unweighted costs of the chosen trajectory, in the order of `weights.names()`."""
    weights: Float[Array, "*batch terms"]
    """`[terms]`, the weights of these costs."""
    cost: Float[Array, "*batch"]
    """`[]`, their weighted sum."""
    valid_share: Float[Array, "*batch"]
    """`[]`, share of the sampled trajectories that stay on the reference path."""
    feasible_share: Float[Array, "*batch"]
    """`[]`, share of the sampled trajectories that are feasible."""
    collision_checked: Int[Array, "*batch"]
    """`[]`, trajectories that the collision check looked at."""
    ego_risk: Float[Array, "*batch"]
    """`[]`, risk of the driven trajectory to the ego's passengers, from collisions with obstacles."""
    third_party_risk: Float[Array, "*batch"]
    """`[]`, risk of the driven trajectory to others."""


@pytree_dataclass
class Episode:
    """A whole episode."""

    ego: EgoState
    """`[max_steps + 1]`, from the initial state on; after the end it repeats the last state."""
    reports: StepReport
    """`[max_steps]`; after the end it repeats zeros."""
    outcome: Int[Array, "*batch"]
    """`[]`, an `Outcome`."""
    steps: Int[Array, "*batch"]
    """`[]`, steps driven."""


def reset(config: PlannerConfig, scenario: Scenario) -> SimulationState:
    """The state at step 0: the scenario's initial state, moved from the vehicle's centre to its rear axle."""
    vehicle, initial = config.vehicle, scenario.initial_state
    behind = vehicle.rear_axle_to_center
    x = initial.position[0] - behind * jnp.cos(initial.heading)
    y = initial.position[1] - behind * jnp.sin(initial.heading)
    arc_length, offset = project(scenario.path, x, y)
    turn = initial.heading - look_up(scenario.path, arc_length).heading
    heading = initial.heading - 2 * jnp.pi * jnp.round(turn / (2 * jnp.pi))
    moving = initial.speed > 0.1
    curvature = jnp.where(moving, initial.yaw_rate / jnp.where(moving, initial.speed, 1.0), 0.0)
    ego = initial_ego_state(
        scenario.path,
        arc_length=arc_length,
        offset=offset,
        x=x,
        y=y,
        heading=heading,
        speed=initial.speed,
        acceleration=initial.acceleration,
        curvature=jnp.clip(curvature, -vehicle.max_curvature, vehicle.max_curvature),
    )
    return SimulationState(
        ego=ego,
        step=jnp.int32(0),
        outcome=jnp.int32(Outcome.RUNNING),
        met_goal_region=jnp.asarray(False),
    )


def step(
    config: PlannerConfig,
    scenario: Scenario,
    state: SimulationState,
    weights: CostWeights,
    reach: SamplingRange | None = None,
) -> tuple[SimulationState, StepReport]:
    """Plan, move the ego to the chosen trajectory's next point, and judge how the episode stands.

    An episode that has ended is not to be stepped further: callers that keep a batch running freeze it, as `roll_out`
    does.
    """
    return advance(config, scenario, state, plan(config, scenario, state, weights, reach), weights)


def advance(
    config: PlannerConfig, scenario: Scenario, state: SimulationState, cycle: PlanningCycle, weights: CostWeights
) -> tuple[SimulationState, StepReport]:
    """`step` for callers that have planned already: `cycle` is what `plan` made of the other arguments.

    Without a feasible trajectory the episode ends as infeasible and the ego stays.
    """
    moved = dataclasses.replace(
        state, ego=jax.tree.map(lambda points: points[1], cycle.trajectory), step=state.step + 1
    )
    judged = judge_state(config, scenario, moved)
    stuck = (judged.outcome == Outcome.RUNNING) & (cycle.mode == PlanMode.INFEASIBLE)
    outcome = jnp.where(stuck, jnp.int32(Outcome.INFEASIBLE), judged.outcome)
    return dataclasses.replace(judged, outcome=outcome), _report(cycle, weights)


def _report(cycle: PlanningCycle, weights: CostWeights) -> StepReport:
    """The step's report; without a feasible trajectory there is none whose costs could be told: zeros."""
    driven = (cycle.mode == PlanMode.NORMAL) | (cycle.mode == PlanMode.EMERGENCY)
    costs, factors = jnp.where(driven, cycle.costs[cycle.chosen], 0.0), weights.values()
    return StepReport(
        mode=cycle.mode,
        desired_speed=cycle.desired_speed,
        costs=costs,
        weights=factors,
        cost=costs @ factors,
        valid_share=jnp.mean(cycle.feasibility.valid),
        feasible_share=jnp.mean(cycle.feasibility.feasible),
        collision_checked=cycle.collision_checked,
        ego_risk=cycle.risk.ego,
        third_party_risk=cycle.risk.third_party,
    )


def judge_state(config: PlannerConfig, scenario: Scenario, state: SimulationState) -> SimulationState:
    """Set the state's outcome; the checks come in this order and the first that applies decides.

    Collision with a recorded obstacle or the road's exact edge · time limit · past the goal without having met it ·
    goal reached in time · late · faster (its region met earlier, its end passed). Infeasibility is `step`'s to tell.
    """
    goal, vehicle = scenario.goal, config.vehicle
    center = state.center(vehicle)
    status = judge(goal, center, state.ego.heading, state.ego.speed)
    met = state.met_goal_region | jnp.any(status.in_region)
    in_time = (state.step >= goal.steps[:, 0]) & (state.step <= goal.steps[:, 1])
    end = jnp.max(jnp.where(goal.valid & goal.has_position, goal.arc_length[:, 1], -jnp.inf))
    end = jnp.where(jnp.any(goal.valid & goal.has_position), end, jnp.inf)
    past = (state.ego.arc_length + vehicle.rear_axle_to_center > end) & ~jnp.any(status.in_region)
    box = ego_box(config, state)
    size = jnp.float32(vehicle.length), jnp.float32(vehicle.width)
    road = scenario.road
    off_road = is_off_road(road.segments, road.valid, center, state.ego.heading, *size)
    verdicts = (
        (jnp.any(hits_recorded(scenario.obstacles, state.step, box)), Outcome.COLLISION_OBSTACLE),
        (off_road, Outcome.COLLISION_ROAD),
        (TIME_LIMIT[1] * state.step > TIME_LIMIT[0] * last_step(goal), Outcome.TIMEOUT),
        (past & ~met, Outcome.PAST_GOAL),
        (jnp.any(status.matches & in_time), Outcome.GOAL_REACHED_IN_TIME),
        (jnp.any(status.matches) & (state.step > last_step(goal)), Outcome.GOAL_REACHED_LATE),
        (past & met, Outcome.GOAL_REACHED_FASTER),
    )
    outcome = jnp.select([where for where, _ in verdicts], [jnp.int32(kind) for _, kind in verdicts], state.outcome)
    return dataclasses.replace(state, outcome=outcome, met_goal_region=met)


def ego_box(config: PlannerConfig, state: SimulationState) -> Box:
    """The box that the ego fills."""
    center, vehicle = state.center(config.vehicle), config.vehicle
    return Box.from_heading(
        center[0], center[1], state.ego.heading, jnp.float32(vehicle.length), jnp.float32(vehicle.width)
    )


def hits_recorded(obstacles: Obstacles, step: Array, box: Box) -> Bool[Array, "obstacles"]:
    """`[obstacles]`, which obstacles' recorded boxes a box meets at `step`."""
    now = jnp.minimum(step, obstacles.valid.shape[1] - 1)
    position = obstacles.position[:, now]
    others = Box.from_heading(
        position[:, 0], position[:, 1], obstacles.heading[:, now], obstacles.length, obstacles.width
    )
    return boxes_overlap(box, others) & obstacles.present(step)


def max_steps(scenario: Scenario) -> int:
    """Steps after which every episode of a scenario, or of a batch, has ended at the latest."""
    goal = scenario.goal
    last = jnp.max(jnp.where(goal.valid, goal.steps[..., 1], 0))
    return TIME_LIMIT[0] * int(last) // TIME_LIMIT[1] + 1


@partial(jax.jit, static_argnums=(0, 3))
def roll_out(
    config: PlannerConfig,
    scenario: Scenario,
    weights: CostWeights,
    max_steps: int,
    reach: SamplingRange | None = None,
) -> Episode:
    """Drive one scenario to its end; `jax.vmap` over scenarios (and weights, if they differ) drives a batch.

    Args:
      config: static settings.
      scenario: one scenario.
      weights: weights of the cost terms, constant over the episode.
      max_steps: static; an episode that runs longer is left with the outcome `RUNNING`. `max_steps(scenario)` is
        always enough.
      reach: how far the sampled end states reach, constant too; as the config has it if not given.
    """
    if scenario.predictions is None:
        scenario = with_predictions(config, scenario)

    def drive(_: None, state: SimulationState) -> tuple[None, SimulationState, StepReport]:
        return None, *step(config, scenario, state, weights, reach)

    return record(drive, None, reset(config, scenario), max_steps)


def record(
    drive: Callable[[Memory, SimulationState], tuple[Memory, SimulationState, StepReport]],
    memory: Memory,
    start: SimulationState,
    max_steps: int,
) -> Episode:
    """Drive one step after the other until the episode ends, and keep what happened.

    Args:
      drive: one step, of memory and state; what it returns is handed to the next.
      memory: a pytree of what else it needs to know at the first step.
      start: the state at the first step.
      max_steps: static; most steps that are driven.
    """
    *_, report_shape = jax.eval_shape(drive, memory, start)
    reports = jax.tree.map(lambda leaf: jnp.zeros((max_steps, *leaf.shape), leaf.dtype), report_shape)
    track = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (max_steps + 1,)), start.ego)

    def running(carry: tuple[Memory, SimulationState, EgoState, StepReport]) -> Array:
        state = carry[1]
        return (state.outcome == Outcome.RUNNING) & (state.step < max_steps)

    def drive_on(
        carry: tuple[Memory, SimulationState, EgoState, StepReport],
    ) -> tuple[Memory, SimulationState, EgoState, StepReport]:
        memory, state, track, reports = carry
        memory, moved, report = drive(memory, state)
        track = jax.tree.map(lambda row, value: _set_from(row, moved.step, value), track, moved.ego)
        reports = jax.tree.map(lambda row, value: row.at[state.step].set(value), reports, report)
        return memory, moved, track, reports

    _, state, track, reports = jax.lax.while_loop(running, drive_on, (memory, start, track, reports))
    return Episode(ego=track, reports=reports, outcome=state.outcome, steps=state.step)


def _set_from(row: Array, step: Array, value: Array) -> Array:
    """`row` with `value` at `step` and everywhere after it."""
    return jnp.where(jnp.arange(row.shape[0]) >= step, value, row)
