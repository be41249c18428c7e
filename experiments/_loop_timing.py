"""How fast whole episodes, the environment, training and the predictors run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
import ppo
from experiments._batches import BatchDriver, make_batches
from experiments._measuring import Budget, compile_ahead, measure
from experiments._planners import DefaultPlanner
from experiments._presets import PRESETS, PresetName
from jaxfrenet._typing import Array
from jaxfrenet.config import Sampling
from jaxfrenet.environment import (
    DrivingEnvironment,
    EnvironmentConfig,
    EnvironmentParams,
    EnvironmentState,
    make_params,
)

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
    driver = BatchDriver(DefaultPlanner(jf.PlannerConfig.preset(preset, predictor="neural"), jf.CostWeights()))
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
    """Step environments with the zero action; predictions are tabulated before, episodes that end begin anew.

    Raises:
      DoesNotFit: it takes more memory than there is.
    """
    environment, params = _environment(found, preset)
    reset = jax.jit(jax.vmap(environment.reset, (0, None)))
    states = reset(jax.random.split(jax.random.key(0), batch), params)[1]
    program = compile_ahead(partial(_step_on, environment, batch, steps), states, params)
    (durations,) = measure([program.run], budget)
    return {
        "preset": preset,
        "batch": batch,
        "scenarios": len(found),
        "steps": steps,
        "ended_episodes": int(program.run()),
        "steps_per_second": batch * steps / float(np.median(durations)),
        "repeats": len(durations),
        "compile_seconds": program.compile_seconds,
    }


def _environment(found: Sequence[jf.Scenario], preset: Sampling) -> tuple[DrivingEnvironment, EnvironmentParams]:
    environment = DrivingEnvironment(EnvironmentConfig(jf.PlannerConfig.preset(preset, predictor="neural")))
    (one,) = make_batches(found, len(found))
    return environment, make_params(environment.config, one.scenario)


def _step_on(
    environment: DrivingEnvironment, batch: int, steps: int, states: EnvironmentState, params: EnvironmentParams
) -> Array:
    """How many episodes ended within some steps."""
    zero = jnp.zeros((batch, environment.action_size))

    def step(states: EnvironmentState, key: Array) -> tuple[EnvironmentState, Array]:
        keys = jax.random.split(key, batch)
        _, states, _, terminated, _, _ = jax.vmap(environment.step, (0, 0, 0, None))(keys, states, zero, params)
        return states, jnp.sum(terminated.astype(jnp.int32))

    return jnp.sum(jax.lax.scan(step, states, jax.random.split(jax.random.key(0), steps))[1])


def measure_training(found: Sequence[jf.Scenario], name: PresetName, budget: Budget) -> dict[str, Any]:
    """Train with a preset's networks and batches: one update is a rollout and the learning from it.

    Raises:
      DoesNotFit: it takes more memory than there is.
    """
    preset = PRESETS[name]
    environment, params = _environment(found, preset.sampling)
    start = partial(ppo.initial_state, preset.ppo, environment, preset.hyperparameters)
    state = jax.jit(start)(params, jax.random.key(0))
    update = partial(ppo.train_update, preset.ppo, environment)
    program = compile_ahead(update, state, preset.hyperparameters, params)
    (durations,) = measure([program.run], budget)
    batch = preset.ppo.environments * preset.ppo.rollout_steps
    return {
        "preset": name,
        "sampling": preset.sampling,
        "environments": preset.ppo.environments,
        "rollout_steps": preset.ppo.rollout_steps,
        "scenarios": len(found),
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(state.parameters)),
        "steps_per_second": batch / float(np.median(durations)),
        "hours_per_million_steps": 1e6 / batch * float(np.median(durations)) / 3600.0,
        "repeats": len(durations),
        "compile_seconds": program.compile_seconds,
    }


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
