"""One episode, kept planning cycle by planning cycle on the host, for drawing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax

import jaxfrenet as jf
from experiments._planners import Planner


@dataclass(frozen=True)
class Recording:
    """What happened in one episode; all arrays are NumPy's."""

    name: str
    """The scenario's name."""
    planner: str
    """What the planner is called."""
    terms: tuple[str, ...]
    """Names of the cost terms, in the order of the cycles' costs and the reports' weights."""
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


def record(
    planner: Planner,
    called: str,
    name: str,
    scenario: jf.Scenario,
    after_step: Callable[[], object] = lambda: None,
) -> Recording:
    """Drive one episode to its end.

    Args:
      planner: what drives.
      called: what the planner is called.
      name: the scenario's name.
      scenario: one scenario, without a batch axis.
      after_step: called after each step, for a progress bar.
    """
    scenario = jax.jit(jf.with_predictions, static_argnums=0)(planner.config, scenario)
    step, parameters = jax.jit(planner.step), planner.parameters
    memory, state = jax.jit(planner.begin)(parameters, scenario)
    states, cycles, reports = [jax.device_get(state)], [], []
    while states[-1].outcome == jf.Outcome.RUNNING:
        memory, cycle, state, report = step(parameters, memory, state, scenario)
        cycles.append(jax.device_get(cycle))
        states.append(jax.device_get(state))
        reports.append(jax.device_get(report))
        after_step()
    return Recording(name, called, planner.terms, jax.device_get(scenario), states, cycles, reports)
