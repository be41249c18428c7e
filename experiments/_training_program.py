"""The compiled program of training: a few updates, then perhaps a validation, for one run or several side by side."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
from jax.sharding import Mesh
from jax.stages import Wrapped

import ppo
from experiments._training_problem import mean_scores
from experiments._training_sets import Driven
from jaxfrenet._typing import Array
from jaxfrenet.environment import DrivingEnvironment, EnvironmentParams

CHUNK = 5
"""Updates in one call of the compiled program."""


class Together(NamedTuple):
    """What has a leading axis of runs: 0 where each run has its own, None where all share it."""

    state: int | None = None
    hyperparameters: int | None = None
    rewards: int | None = None


@cache
def training_program(
    config: ppo.PPOConfig,
    environment: DrivingEnvironment,
    max_steps: int,
    mesh: Mesh | None = None,
    together: Together | None = None,
) -> Wrapped:
    """`CHUNK` updates and perhaps a validation, compiled for each kind of argument.

    Args:
      config: static settings of the learner.
      environment: static.
      max_steps: steps after which every episode has ended.
      mesh: devices that share the environments.
      together: what several runs have side by side; None for a single run.

    Returns:
      (state, hyperparameters, factors of the reward in training, parameters of the environment in training, those in
      validation, which of its episodes count, whether to validate) → state, metrics of the updates, scores.
    """

    def judge(policy: ppo.Policy, params: EnvironmentParams, counted: Array) -> tuple[Array, dict[str, Array]]:
        def act(carry: Any, observation: Array, reset: Array) -> tuple[Any, Array]:
            return ppo.act(policy, carry, observation, reset)

        episodes = counted.shape[0]
        keys = jax.random.split(jax.random.key(0), episodes)
        carry = ppo.initial_carry(policy, (episodes,))
        found = ppo.evaluate(environment, act, params, keys, max_steps, carry, mesh)
        return mean_scores(Driven.of(found), counted)

    def advance(state, hyperparameters, rewards, train, validation, counted, validate):
        return ppo.train_chunk(
            config, environment, state, hyperparameters, replace(train, rewards=rewards), CHUNK, validate,
            lambda policy: judge(policy, validation, counted), mesh,
        )  # fmt: skip

    return jax.jit(advance if together is None else jax.vmap(advance, (*together, None, None, None, None)))
