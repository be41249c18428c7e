"""One episode as a learning problem: how it begins and what an action makes of it, for one scenario at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.environment.action import adjust, cost_weights, default_weights, sampling_range
from jaxfrenet.environment.config import EnvironmentConfig
from jaxfrenet.environment.observation import first_observation, observe
from jaxfrenet.planner import PlanningCycle, plan
from jaxfrenet.prediction import with_predictions
from jaxfrenet.scenario import Scenario
from jaxfrenet.simulation import Episode, StepReport, advance, record, reset
from jaxfrenet.state import SimulationState

Memory = TypeVar("Memory")


@pytree_dataclass
class Situation:
    """Where an episode stands."""

    simulation: SimulationState
    weights: Float[Array, "*batch actions"]
    """`[actions]`, the cost weights of the last step."""
    start: Float[Array, "*batch"]
    """`[]`, m, arc length at which the episode began."""
    observation: Float[Array, "*batch fields"]
    """`[fields]`, what the agent sees."""


def begin(config: EnvironmentConfig, scenario: Scenario) -> Situation:
    """The start of an episode: the default weights."""
    state, weights = reset(config.planner, scenario), default_weights(config.adjustments)
    return Situation(state, weights, state.ego.arc_length, first_observation(config, scenario, state, weights))


def proceed(
    config: EnvironmentConfig, scenario: Scenario, situation: Situation, action: Float[Array, "actions"]
) -> tuple[Situation, PlanningCycle, StepReport]:
    """Adjust the weights, plan, move one step, judge, observe.

    Args:
      config: static settings.
      scenario: one scenario.
      situation: where the episode stands.
      action: `[actions]` within [-1, 1]; zero leaves the weights as they are.

    Returns:
      Where it stands then, the planning cycle of the step, and what the step told.
    """
    before = situation.simulation
    weights = adjust(config.adjustments, situation.weights, action)
    planned = cost_weights(config.adjustments, weights)
    cycle = plan(config.planner, scenario, before, planned, sampling_range(config.adjustments, weights))
    after, report = advance(config.planner, scenario, before, cycle, planned)
    seen = observe(config, scenario, before, after, situation.start, cycle, report, weights)
    return Situation(after, weights, situation.start, seen), cycle, report


@partial(jax.jit, static_argnums=(0, 2, 4))
def roll_out_policy(
    config: EnvironmentConfig,
    scenario: Scenario,
    act: Callable[[Memory, Float[Array, "fields"]], tuple[Memory, Float[Array, "actions"]]],
    memory: Memory,
    max_steps: int,
) -> Episode:
    """Drive one scenario to its end with a policy; like `jaxfrenet.roll_out`, whose other arguments it shares.

    Args:
      config: static settings.
      scenario: one scenario.
      act: static; what the policy does, from its memory and an observation, and what it remembers.
      memory: a pytree: what the policy knows and remembers at the start, its parameters among it.
      max_steps: static.
    """
    if scenario.predictions is None:
        scenario = with_predictions(config.planner, scenario)
    start = begin(config, scenario)

    def drive(
        carry: tuple[Memory, Situation], state: SimulationState
    ) -> tuple[tuple[Memory, Situation], SimulationState, StepReport]:
        memory, situation = carry
        memory, action = act(memory, situation.observation)
        moved, _, report = proceed(config, scenario, situation, action)
        return (memory, moved), moved.simulation, report

    return record(drive, (memory, start), start.simulation, max_steps)
