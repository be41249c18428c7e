"""The problem that a policy is trained for: scenarios to learn from and to be judged on, and a baseline."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

import ppo
from experiments._conflicts import with_conflicts
from experiments._presets import Preset
from experiments._training_options import LearningOptions, environment_config
from experiments._training_sets import (
    Driven,
    TrainingSets,
    baseline_of,
    drive_default,
    environment_params,
    one_each,
    shares,
    training_sets,
)
from jaxfrenet._typing import Array
from jaxfrenet.environment import DrivingEnvironment, EnvironmentConfig, EnvironmentParams, RewardFactors


class Problem(NamedTuple):
    """What is learned."""

    environment: DrivingEnvironment
    train: EnvironmentParams
    validation: EnvironmentParams
    """`[scenarios]` on every leaf, filled up to a number that the devices can share."""
    counted: Array
    """`[scenarios]`, 1 for those that count in validation, 0 for the rest."""
    max_steps: int
    """Steps after which every episode has ended."""
    baseline: dict[str, float]
    """What validation says of driving with the default weights."""


def scenario_sets(options: LearningOptions, preset: Preset) -> TrainingSets:
    """Read and generate the scenarios that the options ask for.

    Raises:
      UserError: nothing is left to train or to validate on.
      ScenarioError: a source holds nothing that can be driven.
    """
    keep = partial(with_conflicts, environment_config(options, preset)) if preset.conflicts else None
    return training_sets(
        options.scenarios, options.validation, preset.kinds, preset.generate, options.generator_seed, keep
    )


def make_problem(
    sets: TrainingSets,
    config: EnvironmentConfig,
    rewards: RewardFactors,
    discount: float | None = None,
    mesh: Mesh | None = None,
) -> Problem:
    """Predict the traffic, and drive with the default weights.

    Args:
      sets: scenarios to train and to validate on.
      config: static settings.
      rewards: factors of the reward, in training and in validation.
      discount: γ, if training rewards are to be relative to those with the default weights.
      mesh: devices that share the environments.
    """
    environment, max_steps = DrivingEnvironment(config), sets.max_steps()
    train, validation = environment_params(environment, sets, rewards)
    learnt = drive_default(environment, one_each(train), max_steps, "default weights: training set")
    train = replace(train, chances=jnp.cumsum(shares(sets.groups)))
    if discount is not None:
        train = replace(train, baseline=baseline_of(np.asarray(learnt.rewards), discount))
    driven = drive_default(environment, validation, max_steps, "default weights: validation set")
    baseline = mean_scores(driven, None)[1]
    _print_sets(sets, learnt.hard)
    counted = jnp.ones(len(sets.validation))
    if mesh is not None:
        missing = -len(sets.validation) % mesh.size
        filled = jnp.minimum(jnp.arange(len(sets.validation) + missing), len(sets.validation) - 1)
        validation = jax.tree.map(lambda leaf: leaf[filled], validation)
        counted = jnp.append(counted, jnp.zeros(missing))
        train, validation, counted = ppo.replicate((train, validation, counted), mesh)
    return Problem(environment, train, validation, counted, max_steps, {k: float(v) for k, v in baseline.items()})


def _print_sets(sets: TrainingSets, hard: np.ndarray) -> None:
    if jax.process_index() == 0:
        print(
            f"{len(sets.train)} scenarios to train on, {int(np.sum(hard))} of them hard with the default weights; "
            f"{len(sets.validation)} to validate on",
            flush=True,
        )


def mean_scores(driven: Driven, counted: Array | None) -> tuple[Array, dict[str, Array]]:
    """The mean return of episodes; means of it, of the sums of its terms, and of all that is told about episodes."""

    def mean(values: Any) -> Array:
        weights = jnp.ones(len(values)) if counted is None else counted
        return jnp.sum(jnp.asarray(values, jnp.float32) * weights) / jnp.sum(weights)

    told = {name: mean(value) for name, value in driven.episode.items()}
    told |= {name: mean(value) for name, value in driven.metrics.items() if name.startswith("reward/")}
    return mean(driven.returns), {"return": mean(driven.returns), "length": mean(driven.steps)} | told
