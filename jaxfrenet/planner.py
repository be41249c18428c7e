"""One planning cycle (paper, "Sampling-based Motion Planner"): sample, check, cost, collision check, choose, assess.

`plan` is a pure function of a scenario and a state; `jit` and `vmap` it freely. `config` is static.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from enum import IntEnum

import jax
import jax.numpy as jnp

from jaxfrenet import collision_check, costs, feasibility, risk
from jaxfrenet._compilation import in_parts
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from jaxfrenet.config import PlannerConfig
from jaxfrenet.costs import CostInputs, CostWeights
from jaxfrenet.feasibility import Feasibility
from jaxfrenet.goal import desired_speed
from jaxfrenet.prediction import Prediction, predict
from jaxfrenet.risk import Risk
from jaxfrenet.sampling import SamplingRange, sample_end_states
from jaxfrenet.scenario import Scenario
from jaxfrenet.state import Outcome, SimulationState
from jaxfrenet.trajectories import Bundle, EgoState, Rows, lay_out, multiply_out, pick

TOGETHER = 16
"""Scenarios of a batch that a CPU plans for at once."""


class PlanMode(IntEnum):
    """How the driven trajectory was found."""

    NORMAL = 0
    """The cheapest feasible trajectory without a collision."""
    EMERGENCY = 1
    """Every feasible trajectory collides: the one that `config.emergency` asks for."""
    STANDSTILL = 2
    """As above, at standstill: stay."""
    INFEASIBLE = 3
    """No trajectory is feasible."""


@pytree_dataclass
class PlanningCycle:
    """All that one planning cycle found."""

    trajectory: EgoState
    """`[points]`, the chosen trajectory; point 0 is the current state."""
    mode: Int[Array, ""]
    """`[]`, a `PlanMode`."""
    chosen: Int[Array, ""]
    """`[]`, the chosen trajectory's place in the bundle (of no meaning at standstill and without a feasible one)."""
    rows: Rows
    """All sampled trajectories, before they are multiplied out; see `bundle`."""
    feasibility: Feasibility
    """`[trajectories]`, which are feasible and why others are not."""
    costs: Float[Array, "trajectories terms"]
    """`[trajectories, terms]`, unweighted, in the order of `weights.names()`."""
    cost: Float[Array, "trajectories"]
    """`[trajectories]`, weighted sum."""
    collision_checked: Int[Array, ""]
    """`[]`, trajectories that the collision check looked at before it found a free one."""
    prediction: Prediction
    desired_speed: Float[Array, ""]
    """`[]`, m/s."""
    risk: Risk
    """`[]`, of the chosen trajectory."""

    @property
    def bundle(self) -> Bundle:
        """All sampled trajectories; of one cycle, not of a batch."""
        return multiply_out(jax.tree.map(jnp.asarray, self.rows)).flat()


def plan(
    config: PlannerConfig,
    scenario: Scenario,
    state: SimulationState,
    weights: CostWeights,
    reach: SamplingRange | None = None,
) -> PlanningCycle:
    """Run one planning cycle from `state`.

    Args:
      config: static settings.
      scenario: one scenario, without a batch axis (`jax.vmap` adds one).
      state: where the ego is and which step it is.
      weights: weights of the cost terms; which are `None` is static.
      reach: how far the sampled end states reach; as the config has it if not given.
    """
    ego = state.ego
    center, center_arc_length = state.center(config.vehicle), ego.arc_length + config.vehicle.rear_axle_to_center
    target = desired_speed(scenario.goal, state.step, center, center_arc_length, ego.speed)
    prediction = predict(config, scenario, state.step, ego.x, ego.y)
    weights, reach = jax.tree.map(jnp.asarray, (weights, reach))
    return _choose_in_parts(config)(_without_records(scenario), state, weights, reach, prediction, target)


@functools.cache
def _choose_in_parts(config: PlannerConfig) -> Callable[..., PlanningCycle]:
    return in_parts(functools.partial(_choose, config), TOGETHER)


def _without_records(scenario: Scenario) -> Scenario:
    """What of a scenario is needed once the traffic is predicted: all but its long tables."""
    obstacles = scenario.obstacles
    tracks = {name: getattr(obstacles, name)[:, :1] for name in ("position", "heading", "speed", "valid")}
    return dataclasses.replace(
        scenario,
        obstacles=dataclasses.replace(obstacles, **tracks),
        lane_map=jax.tree.map(lambda leaf: leaf[:1], scenario.lane_map),
        predictions=None,
    )


def _choose(
    config: PlannerConfig,
    scenario: Scenario,
    state: SimulationState,
    weights: CostWeights,
    reach: SamplingRange | None,
    prediction: Prediction,
    target: Array,
) -> PlanningCycle:
    """Sample, check, cost, collision check, choose, assess."""
    ego = state.ego
    end_states = sample_end_states(config, ego.speed, ego.arc_length_rate, ego.offset, reach)
    rows = lay_out(config, scenario.path, ego, end_states)
    bundle = multiply_out(rows)
    checked = feasibility.check(config, bundle)
    inputs = CostInputs(rows, bundle, prediction, target, scenario.path, scenario.lanes)
    unweighted = costs.evaluate(config, weights, inputs)
    cost = unweighted @ weights.values()
    free = collision_check.first_free(config, rows, checked.feasible, cost, prediction, scenario.road)
    mode = _mode(config, ego, checked, free)
    last_resort = _last_resort(config, scenario, prediction, rows, checked, state, mode)
    chosen = jnp.where(free.found, free.index, last_resort).astype(jnp.int32)
    trajectory = _driven(ego, rows, chosen, mode)
    return PlanningCycle(
        trajectory=trajectory,
        mode=mode,
        chosen=chosen,
        rows=rows,
        feasibility=checked,
        costs=unweighted,
        cost=cost,
        collision_checked=free.checked,
        prediction=prediction,
        desired_speed=target,
        risk=risk.assess(config, scenario, prediction, trajectory),
    )


def _mode(config: PlannerConfig, ego: EgoState, checked: Feasibility, free: collision_check.FirstFree) -> Array:
    """The cycle's `PlanMode`."""
    at_rest = ego.speed <= config.standstill_speed
    blocked = jnp.where(at_rest, PlanMode.STANDSTILL, PlanMode.EMERGENCY)
    colliding = jnp.where(jnp.any(checked.feasible), blocked, PlanMode.INFEASIBLE)
    return jnp.where(free.found, PlanMode.NORMAL, colliding).astype(jnp.int32)


def _last_resort(
    config: PlannerConfig,
    scenario: Scenario,
    prediction: Prediction,
    rows: Rows,
    checked: Feasibility,
    state: SimulationState,
    mode: Array,
) -> Array:
    """Place of the feasible trajectory for an emergency: lowest end speed, soonest, least sideways.

    With `min_risk`, the one of least risk; these three then decide between equals. An episode that has ended, which a
    batch may carry on, is not assessed any more.
    """
    bundle = multiply_out(rows).flat()
    keys = [bundle.end_speed, bundle.end_step.astype(jnp.float32), jnp.abs(bundle.end_offset - state.ego.offset)]
    if config.emergency == "min_risk":
        wanted = (mode == PlanMode.EMERGENCY) & (state.outcome == Outcome.RUNNING)
        keys = [_total_risk(config, scenario, prediction, rows, wanted), *keys]
    chosen = checked.feasible
    for key in keys:
        key = jnp.where(chosen, key, jnp.inf)
        chosen = chosen & (key <= jnp.min(key))
    return jnp.argmax(chosen)


def _total_risk(
    config: PlannerConfig, scenario: Scenario, prediction: Prediction, rows: Rows, wanted: Array
) -> Float[Array, "trajectories"]:
    """Risk of every trajectory to all together; zeros, without the work, where it is not wanted.

    In a batch, nothing is done as long as nobody wants it, then one scenario after the other is asked.
    """

    def evaluate(scenario: Scenario, prediction: Prediction, rows: Rows) -> Array:
        return risk.assess_bundle(config, scenario, prediction, multiply_out(rows).flat()).total

    @jax.custom_batching.sequential_vmap
    def one_by_one(wanted: Array, scenario: Scenario, prediction: Prediction, rows: Rows) -> Array:
        return _only_if(wanted, rows, lambda tied: evaluate(scenario, prediction, tied))

    return _only_if(wanted, rows, lambda tied: one_by_one(wanted, scenario, prediction, tied))


def _only_if(wanted: Array, rows: Rows, evaluate: Callable[[Rows], Array]) -> Array:
    """Values `[trajectories]`, or zeros without the work; a conditional would always do the work under `vmap`.

    The loop runs once or not at all. The barrier ties the rows to it, as XLA moves what does not change in a loop to
    before it.
    """

    def once(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        tied, _ = jax.lax.optimization_barrier((rows, carry))
        return jnp.asarray(False), evaluate(tied)

    unknown = jnp.zeros(rows.lateral_jerk.size)
    return jax.lax.while_loop(lambda carry: carry[0], once, (wanted, unknown))[1]


def _driven(ego: EgoState, rows: Rows, chosen: Array, mode: Array) -> EgoState:
    """The trajectory to drive `[points]`."""
    stay = (mode == PlanMode.STANDSTILL) | (mode == PlanMode.INFEASIBLE)
    sampled = pick(rows, chosen).ego
    return jax.tree.map(lambda still, points: jnp.where(stay, still, points), _standstill(ego), sampled)


def _standstill(ego: EgoState) -> EgoState:
    """The ego's state without motion."""
    zero = jnp.zeros_like(ego.speed)
    return dataclasses.replace(ego, speed=zero, acceleration=zero, arc_length_rate=zero, arc_length_acceleration=zero)
