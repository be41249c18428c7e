"""How fast whole episodes, the bare closed loop and the predictors run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from experiments._batches import BatchDriver, make_batches
from experiments._measuring import Budget, compile_ahead, measure
from jaxfrenet._typing import Array
from jaxfrenet.config import Sampling

Kind = Literal["neural", "constant_velocity", "ground_truth"]
Extent = Literal["step", "table"]
PREDICTIONS: tuple[tuple[Kind, Extent], ...] = (
    ("neural", "step"),
    ("neural", "table"),
    ("constant_velocity", "step"),
    ("ground_truth", "step"),
)
"""What is timed of which predictor; only what the neural one says is tabulated before planning."""
PREDICTED_STEP = 20
"""The step at which predictors are timed: the past that the neural one reads is then complete."""


def measure_episodes(found: Sequence[jf.Scenario], preset: Sampling, batch: int) -> dict[str, Any]:
    """Drive scenarios to their ends, in batches; fewer scenarios than the batch holds are driven more than once."""
    driver = BatchDriver(jf.PlannerConfig.preset(preset, predictor="neural"), jf.CostWeights())
    repeated = _repeated(found, max(batch, len(found)))
    episodes: dict[int, jf.Episode] = {}
    for one in make_batches(repeated, batch):
        episodes |= driver.drive(one)
    steps = sum(int(episode.steps) for episode in episodes.values())
    return {
        "preset": preset,
        "batch": batch,
        "scenarios": len(found),
        "episodes": len(episodes),
        "steps": steps,
        "steps_per_second": steps / driver.seconds,
        "compile_seconds": driver.compile_seconds,
    }


def measure_environment(
    found: Sequence[jf.Scenario], preset: Sampling, batch: int, steps: int, budget: Budget
) -> dict[str, Any]:
    """Step a batch, in which every episode that ends starts again; predictions are tabulated before.

    Raises:
      DoesNotFit: it takes more memory than there is.
    """
    config = jf.PlannerConfig.preset(preset, predictor="neural")
    scenario = jax.jit(jax.vmap(partial(jf.with_predictions, config)))(_stacked(found, batch))
    program = compile_ahead(jax.vmap(partial(_step_on, config, steps), in_axes=(0, None)), scenario, jf.CostWeights())
    (durations,) = measure([program.run], budget)
    return {
        "preset": preset,
        "batch": batch,
        "scenarios": min(batch, len(found)),
        "steps": steps,
        "ended_episodes": int(np.sum(program.run()[0])),
        "steps_per_second": batch * steps / float(np.median(durations)),
        "repeats": len(durations),
        "compile_seconds": program.compile_seconds,
    }


def _step_on(
    config: jf.PlannerConfig, steps: int, scenario: jf.Scenario, weights: jf.CostWeights
) -> tuple[Array, jf.StepReport]:
    """Whether each step `[steps]` of one scenario's closed loop ended an episode, and what it reports."""
    start = jf.reset(config, scenario)

    def step(state: jf.SimulationState, _: None) -> tuple[jf.SimulationState, tuple[Array, jf.StepReport]]:
        moved, report = jf.step(config, scenario, state, weights)
        ended = moved.outcome != jf.Outcome.RUNNING
        again = jax.tree.map(lambda fresh, driven: jnp.where(ended, fresh, driven), start, moved)
        return again, (ended, report)

    return jax.lax.scan(step, start, length=steps)[1]


def measure_predictor(
    found: Sequence[jf.Scenario], kind: Kind, what: Extent, batch: int, budget: Budget
) -> dict[str, Any]:
    """Time a predictor.

    Args:
      found: scenarios to fill the batch with.
      kind: of the predictor.
      what: "step" for what is predicted at one step, "table" for all steps of a scenario at once.
      batch: scenarios in a batch; 1 is run without a batch axis.
      budget: how long to measure.

    Raises:
      DoesNotFit: it takes more memory than there is.
    """
    function = partial({"step": _predict, "table": _tabulate}[what], jf.PlannerConfig(predictor=kind))
    stacked = _stacked(found, batch)
    _, obstacles, steps = stacked.obstacles.valid.shape
    if batch == 1:
        program = compile_ahead(function, jax.tree.map(lambda leaf: leaf[0], stacked))
    else:
        program = compile_ahead(jax.vmap(function), stacked)
    (durations,) = measure([program.run], budget)
    return {
        "predictor": kind,
        "what": what,
        "batch": batch,
        "obstacles": obstacles,
        "steps": 1 if what == "step" else steps,
        "ms_per_scenario": 1e3 * float(np.median(durations)) / batch,
        "p99_ms": 1e3 * float(np.quantile(durations, 0.99)) / batch,
        "repeats": len(durations),
        "compile_seconds": program.compile_seconds,
    }


def _predict(config: jf.PlannerConfig, scenario: jf.Scenario) -> jf.Prediction:
    position = scenario.initial_state.position
    return jf.predict(config, scenario, jnp.int32(PREDICTED_STEP), position[0], position[1])


def _tabulate(config: jf.PlannerConfig, scenario: jf.Scenario) -> jf.PredictionTable | None:
    return jf.with_predictions(config, scenario).predictions


def _stacked(found: Sequence[jf.Scenario], batch: int) -> jf.Scenario:
    (one,) = make_batches(_repeated(found, batch), batch)
    return one.scenario


def _repeated(found: Sequence[jf.Scenario], count: int) -> list[jf.Scenario]:
    """So many of the scenarios, from the first one again after the last."""
    return [found[index % len(found)] for index in range(count)]
