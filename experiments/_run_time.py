"""How long the parts of the hybrid planner's step take, one scenario at a time, as the paper measures them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxfrenet as jf
import ppo
import scenarios
from experiments._planners import HybridPlanner

SCENARIOS = 10
"""As many as the paper times."""
PARTS = "policy", "bundle", "step"
"""The network alone; one planning cycle with predictions at hand, that is the trajectories, their checks and costs, and
the choice; and the whole step, which also predicts the traffic, moves the vehicle, and observes."""


def measure_run_time(
    planner: HybridPlanner, names: Sequence[str], found: Sequence[jf.Scenario]
) -> list[dict[str, Any]]:
    """Drive some of the scenarios and time each step's parts.

    Returns:
      A row for each step: scenario, step, and the time [ms] of each part.
    """
    chosen = np.unique(np.linspace(0, len(found) - 1, SCENARIOS).round().astype(int))
    stacked = scenarios.stack([found[one] for one in chosen])
    timed = _Timed(planner)
    rows: list[dict[str, Any]] = []
    with tqdm(total=len(chosen), desc="timing steps", unit=" scenarios", delay=5.0) as bar:
        for place, one in enumerate(chosen):
            scenario = jax.tree.map(lambda leaf, place=place: jnp.asarray(leaf[place]), stacked)
            rows += [{"scenario": names[one]} | row for row in timed.drive(scenario)]
            bar.update()
    return rows


class _Timed:
    """The programs whose calls are timed."""

    def __init__(self, planner: HybridPlanner) -> None:
        self._planner = planner
        self._predict = jax.jit(lambda scenario: jf.with_predictions(planner.config, scenario))
        self._begin, self._step = jax.jit(planner.begin), jax.jit(planner.step)
        self._act = jax.jit(ppo.act)
        self._plan = jax.jit(jf.plan, static_argnums=0)
        self._warm = False

    def drive(self, scenario: jf.Scenario) -> list[dict[str, int | float]]:
        parameters, config = self._planner.parameters, self._planner.config
        predicted = self._predict(scenario)
        memory, state = self._begin(parameters, scenario)
        rows = []
        while int(state.outcome) == jf.Outcome.RUNNING:
            observation = memory.situation.observation[None]
            calls: dict[str, Callable[[], Any]] = {
                "policy": lambda: self._act(parameters, memory.carry, observation, jnp.zeros(1, bool)),  # noqa: B023
                "bundle": lambda: self._plan(config, predicted, state, jf.CostWeights()),  # noqa: B023
                "step": lambda: self._step(parameters, memory, state, scenario),  # noqa: B023
            }
            if not self._warm:
                jax.block_until_ready([call() for call in calls.values()])
                self._warm = True
            timed = {part: _timed(call) for part, call in calls.items()}
            rows.append({"at_step": len(rows)} | {part: milliseconds for part, (milliseconds, _) in timed.items()})
            memory, _, state, _ = timed["step"][1]
        return rows


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """How long a call took [ms], and its result."""
    start = time.perf_counter()
    result = jax.block_until_ready(call())
    return float(f"{1e3 * (time.perf_counter() - start):.4g}"), result
