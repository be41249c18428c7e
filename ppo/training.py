"""The training loop, as pure functions on a state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import Mesh

from ppo import networks
from ppo._pytree import pytree_dataclass
from ppo.advantages import generalized_advantages
from ppo.config import Hyperparameters, PPOConfig
from ppo.diagnosis import diagnose
from ppo.environment import Environment
from ppo.loss import Batch, explained_variance
from ppo.networks import Parameters
from ppo.normalization import (
    ReturnScale,
    RunningMoments,
    initial_moments,
    initial_return_scale,
    return_std,
    update_moments,
    update_return_scale,
)
from ppo.policy import Policy
from ppo.rollout import Actors, collect, initial_actors, sequence
from ppo.sharding import constrain, divided, replicated, shardings
from ppo.update import Sequences, initial_optimizer, learning_rate, update

Metrics = dict[str, Array]
Validation = Callable[[Policy], tuple[Array, Metrics]]
"""Judges a policy: a score `[]`, the higher the better, and scalars for the logs."""


@pytree_dataclass
class TrainingState:
    """All that training goes on from."""

    parameters: Parameters
    optimizer: Any
    moments: RunningMoments
    """Of observations."""
    return_scale: ReturnScale
    actors: Actors
    """Where the environments stand."""
    key: Array
    """Typed random key; what an update draws depends on it and on the update's number."""
    update: Array
    """`[]` int32, updates done."""
    best: Policy
    """The policy with the highest score in validation; the first one before any."""
    best_score: Array
    """`[]`, its score; -inf before any."""
    best_update: Array
    """`[]` int32, updates done when it was validated; -1 before any."""


def current_policy(config: PPOConfig, state: TrainingState) -> Policy:
    """The policy as it stands."""
    return _policy(config, state.parameters, state.moments, state.return_scale)


def initial_state(
    config: PPOConfig,
    environment: Environment,
    hyperparameters: Hyperparameters,
    params: Any,
    key: Array,
    mesh: Mesh | None = None,
) -> TrainingState:
    """The state before training.

    Args:
      config: static settings.
      environment: static.
      hyperparameters: of which the initial standard deviation is used.
      params: of the environment.
      key: a typed random key, from which everything random in training comes.
      mesh: devices that share the environments. With several processes all have to call this, and `params` has to be
        on all devices (`ppo.sharding.replicate`).

    Raises:
      ValueError: if the environments cannot be divided among the devices.
    """

    def make(hyperparameters: Hyperparameters, params: Any, key: Array) -> TrainingState:
        network_key, reset_key, key = jax.random.split(key, 3)
        parameters = networks.init(
            config.network,
            network_key,
            environment.observation_size,
            environment.action_size,
            hyperparameters.initial_std,
        )
        moments = initial_moments((environment.observation_size,))
        scale = initial_return_scale(config.environments)
        return TrainingState(
            parameters=parameters,
            optimizer=initial_optimizer(parameters),
            moments=moments,
            return_scale=scale,
            actors=initial_actors(config, environment, params, reset_key, mesh),
            key=key,
            update=jnp.int32(0),
            best=_policy(config, parameters, moments, scale),
            best_score=jnp.float32(-jnp.inf),
            best_update=jnp.int32(-1),
        )

    if mesh is None:
        return make(hyperparameters, params, key)
    shape = jax.eval_shape(make, hyperparameters, params, key)
    return jax.jit(make, out_shardings=state_shardings(shape, mesh))(hyperparameters, params, key)


def state_shardings(state: TrainingState, mesh: Mesh) -> TrainingState:
    """How a state lies on the devices: what belongs to environments is divided, all else is on every device."""
    everywhere = shardings(state, replicated(mesh))
    return replace(
        everywhere,
        actors=shardings(state.actors, divided(mesh)),
        return_scale=replace(everywhere.return_scale, returns=divided(mesh)),
    )


def train_update(
    config: PPOConfig,
    environment: Environment,
    state: TrainingState,
    hyperparameters: Hyperparameters,
    params: Any,
    mesh: Mesh | None = None,
) -> tuple[TrainingState, Metrics]:
    """Collect experience and learn from it, once.

    Observations are normalised by the moments of earlier rollouts, both when they are acted upon and when they are
    learned from; rewards are scaled by what is known after the rollout.

    Args:
      config: static settings.
      environment: static.
      state: before.
      hyperparameters: of this update.
      params: of the environment.
      mesh: as for `initial_state`.

    Returns:
      The state after it, and scalars about it: the summary of `ppo.rollout.collect`, the loss and its parts, means of
      the `reward` and of the actions' `std`, `explained_variance` of the values, `gradient_norm` before clipping,
      `learning_rate`, what `ppo.diagnosis.diagnose` says, `update`, the updates done after it, and `rollout_steps`.
    """
    collect_key, update_key = jax.random.split(jax.random.fold_in(state.key, state.update))
    policy = current_policy(config, state)
    actors, rollout, summary = collect(
        config, environment, policy, state.actors, params, collect_key, mesh, hyperparameters.noise_correlation
    )
    ended = rollout.terminated | rollout.truncated
    scale = update_return_scale(state.return_scale, rollout.rewards, ended, hyperparameters.discount)
    rewards = rollout.rewards / return_std(scale) if config.scale_rewards else rollout.rewards
    advantages, returns = generalized_advantages(
        rewards,
        rollout.values,
        rollout.next_values,
        rollout.terminated,
        rollout.truncated,
        hyperparameters.discount,
        hyperparameters.gae_lambda,
    )
    observations, resets = sequence(policy, rollout)
    batch = Batch(rollout.actions, rollout.log_probs, advantages, returns)
    sequences = Sequences(state.actors.carry, observations, resets, batch)
    rate = learning_rate(hyperparameters, state.update)
    parameters, optimizer_state, report = update(
        config, state.parameters, state.optimizer, sequences, hyperparameters, rate, update_key, mesh
    )
    moments = update_moments(state.moments, rollout.observations) if config.normalize_observations else state.moments
    new = replace(
        state,
        parameters=parameters,
        optimizer=optimizer_state,
        moments=constrain(moments, mesh, None),
        return_scale=ReturnScale(constrain(scale.moments, mesh, None), constrain(scale.returns, mesh, 0)),
        actors=actors,
        update=state.update + 1,
    )
    metrics = summary | report.terms._asdict()
    metrics |= {
        "loss": report.loss,
        "reward": jnp.mean(rollout.rewards),
        "explained_variance": explained_variance(rollout.values, returns),
        "gradient_norm": report.gradient_norm,
        "learning_rate": rate,
        "std": jnp.mean(jnp.exp(parameters["log_std"])),
        "update": new.update,
        "rollout_steps": jnp.int32(config.rollout_steps),
    }
    return new, metrics | diagnose(rollout, actors.observation, advantages, report, parameters)


def train_chunk(
    config: PPOConfig,
    environment: Environment,
    state: TrainingState,
    hyperparameters: Hyperparameters,
    params: Any,
    updates: int,
    validate: Array | bool = False,
    validation: Validation | None = None,
    mesh: Mesh | None = None,
) -> tuple[TrainingState, Metrics, Metrics]:
    """Some updates, then perhaps a validation that keeps the best policy.

    `jax.vmap` over states and hyperparameters trains several runs at once; `validate` is not to be mapped over, else
    every chunk is validated.

    Args:
      config: static settings.
      environment: static.
      state: before.
      hyperparameters: of these updates.
      params: of the environment.
      updates: static count.
      validate: traced, whether `validation` is called.
      validation: static; judges the policy after the updates.
      mesh: as for `initial_state`.

    Returns:
      The state after it, the metrics of `train_update`, `[updates]` each, and those of the validation, `[]` each, with
      its `score`; zeros, and a score that is not a number, if there was none, and no entries without `validation`.
    """

    def step(state: TrainingState, _: None) -> tuple[TrainingState, Metrics]:
        return train_update(config, environment, state, hyperparameters, params, mesh)

    state, metrics = jax.lax.scan(step, state, None, updates)
    if validation is None:
        return state, metrics, {}
    state, scores = _validated(config, state, validate, validation)
    return state, metrics, scores


def train(
    config: PPOConfig,
    environment: Environment,
    hyperparameters: Hyperparameters,
    params: Any,
    key: Array,
    updates: int,
    mesh: Mesh | None = None,
) -> tuple[TrainingState, Metrics]:
    """A whole training run: the state after it and metrics `[updates]`; arguments as for the functions above."""
    state = initial_state(config, environment, hyperparameters, params, key, mesh)
    state, metrics, _ = train_chunk(config, environment, state, hyperparameters, params, updates, mesh=mesh)
    return state, metrics


def _policy(config: PPOConfig, parameters: Parameters, moments: RunningMoments, scale: ReturnScale) -> Policy:
    return Policy(
        parameters=parameters,
        moments=moments,
        return_std=return_std(scale) if config.scale_rewards else jnp.float32(1.0),
        network=config.network,
        normalize_observations=config.normalize_observations,
        observation_clip=config.observation_clip,
        observation_floor=config.observation_floor,
    )


def _validated(
    config: PPOConfig, state: TrainingState, validate: Array | bool, validation: Validation
) -> tuple[TrainingState, Metrics]:
    policy = current_policy(config, state)
    shape = jax.eval_shape(validation, policy)

    def judge(policy: Policy) -> tuple[Array, Metrics]:
        score, scores = validation(policy)
        return jnp.asarray(score, jnp.float32), scores

    def skip(_: Policy) -> tuple[Array, Metrics]:
        return jnp.float32(jnp.nan), jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape[1])

    score, scores = jax.lax.cond(validate, judge, skip, policy)
    better = score > state.best_score
    best, best_score, best_update = jax.tree.map(
        lambda new, old: jnp.where(better, new, old),
        (policy, score, state.update),
        (state.best, state.best_score, state.best_update),
    )
    return replace(state, best=best, best_score=best_score, best_update=best_update), scores | {"score": score}
