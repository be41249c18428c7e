"""One episode, kept planning cycle by planning cycle on the host, for drawing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax

import jaxfrenet as jf


@dataclass(frozen=True)
class Recording:
    """What happened in one episode; all arrays are NumPy's."""

    name: str
    """The scenario's name."""
    scenario: jf.Scenario
    states: list[jf.SimulationState]
    """Before the first step and after each."""
    cycles: list[jf.PlanningCycle]
    """The planning cycle of each step."""
    reports: list[jf.StepReport]
    """What each step reported."""

    @property
    def outcome(self) -> jf.Outcome:
        """How the episode ended."""
        return jf.Outcome(int(self.states[-1].outcome))


@partial(jax.jit, static_argnums=0)
def _plan_and_step(
    config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState, weights: jf.CostWeights
) -> tuple[jf.PlanningCycle, jf.SimulationState, jf.StepReport]:
    """The cycle and the step that it leads to."""
    cycle = jf.plan(config, scenario, state, weights)
    return cycle, *jf.advance(config, scenario, state, cycle, weights)


def record(
    config: jf.PlannerConfig,
    name: str,
    scenario: jf.Scenario,
    weights: jf.CostWeights,
    after_step: Callable[[], object] = lambda: None,
) -> Recording:
    """Drive one episode to its end.

    Args:
      config: the planner's configuration.
      name: the scenario's name.
      scenario: one scenario, without a batch axis.
      weights: cost weights.
      after_step: called after each step, for a progress bar.
    """
    scenario = jax.jit(jf.with_predictions, static_argnums=0)(config, scenario)
    state = jax.jit(jf.reset, static_argnums=0)(config, scenario)
    states, cycles, reports = [jax.device_get(state)], [], []
    while states[-1].outcome == jf.Outcome.RUNNING:
        cycle, state, report = _plan_and_step(config, scenario, state, weights)
        cycles.append(jax.device_get(cycle))
        states.append(jax.device_get(state))
        reports.append(jax.device_get(report))
        after_step()
    return Recording(name, jax.device_get(scenario), states, cycles, reports)
