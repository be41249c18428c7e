"""One planning cycle (paper, "Sampling-based Motion Planner"): sample, check, cost, collision check, choose.

`plan` is a pure function of a scenario and a state; `jit` and `vmap` it freely. `config` is static.
"""

from __future__ import annotations

import dataclasses
from enum import IntEnum

import jax
import jax.numpy as jnp

from jaxfrenet import collision_check, costs, feasibility
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from jaxfrenet.config import PlannerConfig
from jaxfrenet.costs import CostInputs, CostWeights
from jaxfrenet.feasibility import Feasibility
from jaxfrenet.goal import desired_speed
from jaxfrenet.prediction import Prediction, predict
from jaxfrenet.sampling import sample_end_states
from jaxfrenet.scenario import Scenario
from jaxfrenet.state import SimulationState
from jaxfrenet.trajectories import Bundle, EgoState, generate


class PlanMode(IntEnum):
    """How the driven trajectory was found."""

    NORMAL = 0
    """The cheapest feasible trajectory without a collision."""
    EMERGENCY = 1
    """Every feasible trajectory collides: the one that stops hardest."""
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
    bundle: Bundle
    """All sampled trajectories."""
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


def plan(config: PlannerConfig, scenario: Scenario, state: SimulationState, weights: CostWeights) -> PlanningCycle:
    """Run one planning cycle from `state`.

    Args:
      config: static settings.
      scenario: one scenario, without a batch axis (`jax.vmap` adds one).
      state: where the ego is and which step it is.
      weights: weights of the cost terms; which are `None` is static.
    """
    ego = state.ego
    center, center_arc_length = state.center(config.vehicle), ego.arc_length + config.vehicle.rear_axle_to_center
    target = desired_speed(scenario.goal, state.step, center, center_arc_length, ego.speed)
    prediction = predict(config, scenario, state.step, ego.x, ego.y)

    end_states = sample_end_states(config, ego.speed, ego.arc_length_rate, ego.offset)
    bundle = generate(config, scenario.path, ego, end_states)
    checked = feasibility.check(config, bundle)
    inputs = CostInputs(bundle, prediction, target, scenario.path, scenario.lanes)
    unweighted = costs.evaluate(config, weights, inputs)
    cost = unweighted @ weights.values()
    free = collision_check.first_free(config, bundle, checked.feasible, cost, prediction, scenario.road)
    trajectory, chosen, mode = _choose(config, ego, bundle, checked, free)
    return PlanningCycle(
        trajectory=trajectory,
        mode=mode,
        chosen=chosen,
        bundle=bundle,
        feasibility=checked,
        costs=unweighted,
        cost=cost,
        collision_checked=free.checked,
        prediction=prediction,
        desired_speed=target,
    )


def _choose(
    config: PlannerConfig, ego: EgoState, bundle: Bundle, checked: Feasibility, free: collision_check.FirstFree
) -> tuple[EgoState, Array, Array]:
    """The trajectory to drive `[points]`, its place in the bundle, and the mode."""
    any_feasible = jnp.any(checked.feasible)
    at_rest = ego.speed <= config.standstill_speed
    blocked = jnp.where(at_rest, PlanMode.STANDSTILL, PlanMode.EMERGENCY)
    mode = jnp.where(free.found, PlanMode.NORMAL, jnp.where(any_feasible, blocked, PlanMode.INFEASIBLE))
    chosen = jnp.where(free.found, free.index, _hardest_stop(bundle, checked.feasible, ego))
    stay = (mode == PlanMode.STANDSTILL) | (mode == PlanMode.INFEASIBLE)
    driven = jax.tree.map(
        lambda still, sampled: jnp.where(stay, still, sampled[chosen]), _standstill(ego), bundle.motion
    )
    return driven, chosen.astype(jnp.int32), mode.astype(jnp.int32)


def _hardest_stop(bundle: Bundle, feasible: Array, ego: EgoState) -> Array:
    """The feasible trajectory with the lowest end speed, then the shortest time to it, then the least sideways."""
    chosen = feasible
    for key in (bundle.end_speed, bundle.end_step, jnp.abs(bundle.end_offset - ego.offset)):
        key = jnp.where(chosen, key.astype(jnp.float32), jnp.inf)
        chosen = chosen & (key <= jnp.min(key))
    return jnp.argmax(chosen)


def _standstill(ego: EgoState) -> EgoState:
    """The ego's state without motion."""
    zero = jnp.zeros_like(ego.speed)
    return dataclasses.replace(ego, speed=zero, acceleration=zero, arc_length_rate=zero, arc_length_acceleration=zero)
