"""Collect experience: the policy acts in all environments for some steps."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ppo import distributions, networks
from ppo._pytree import pytree_dataclass
from ppo.config import PPOConfig
from ppo.environment import Environment, Info
from ppo.networks import Carry
from ppo.policy import Policy, normalized, outputs
from ppo.sharding import check_divisible, constrain, map_environments


@pytree_dataclass
class Actors:
    """Where all environments stand; every leaf begins with their axis."""

    environment: Any
    """States of the environments."""
    observation: Array
    """`[environments, observation_size]`, not yet acted upon."""
    carry: Carry
    """What the networks remember."""
    reset: Array
    """`[environments]` bool, whether an episode begins with `observation`."""
    noise: Array
    """`[environments, action_size]`, the last action's, of standard deviation 1."""
    episode_return: Array
    """`[environments]`, sum of the rewards of the running episode."""
    episode_length: Array
    """`[environments]` int32, its steps."""


class Rollout(NamedTuple):
    """What was experienced, `[time, environments, ...]`."""

    observations: Array
    """`[..., observation_size]`, as the environment gave them."""
    resets: Array
    """`[...]` bool, whether an episode began with the observation."""
    actions: Array
    """`[..., action_size]`."""
    log_probs: Array
    """`[...]`, of the actions."""
    values: Array
    """`[...]`, of the observations."""
    next_values: Array
    """`[...]`, of what was observed after the step, before any reset; of no meaning after a termination."""
    rewards: Array
    """`[...]`, unscaled."""
    terminated: Array
    """`[...]` bool."""
    truncated: Array
    """`[...]` bool."""


class _Sums(NamedTuple):
    """Sums over steps, `[environments]` each, so that devices add up their own."""

    metrics: dict[str, Array]
    episode: dict[str, Array]
    episodes: Array
    returns: Array
    lengths: Array


def initial_actors(
    config: PPOConfig, environment: Environment, params: Any, key: Array, mesh: jax.sharding.Mesh | None = None
) -> Actors:
    """Reset all environments, each with a key that depends on its index alone."""
    check_divisible(config.environments, mesh)
    reset = map_environments(environment.reset, (0, None), mesh)
    observation, state = reset(_environment_keys(key, config.environments, mesh), params)
    zeros = jnp.zeros(config.environments)
    actors = Actors(
        environment=jax.tree.map(_strong, state),
        observation=_strong(observation),
        carry=networks.initial_carry(config.network, (config.environments,)),
        reset=jnp.ones(config.environments, bool),
        noise=jnp.zeros((config.environments, environment.action_size)),
        episode_return=zeros,
        episode_length=zeros.astype(jnp.int32),
    )
    return constrain(actors, mesh, 0)


def collect(
    config: PPOConfig,
    environment: Environment,
    policy: Policy,
    actors: Actors,
    params: Any,
    key: Array,
    mesh: jax.sharding.Mesh | None = None,
    noise_correlation: Array | float = 0.0,
) -> tuple[Actors, Rollout, dict[str, Array]]:
    """Let the policy act for `config.rollout_steps`.

    What the networks remember goes on from rollout to rollout and is forgotten where an episode begins.

    Args:
      config: static settings.
      environment: static.
      policy: that acts; its scales stay as they are.
      actors: where the environments stand.
      params: of the environment.
      key: draws actions and whatever the environments draw; each environment's share depends on its index alone.
      mesh: devices that share the environments.
      noise_correlation: `[]`, of an action's noise with the one before it (`ppo.Hyperparameters`).

    Returns:
      Where the environments stand then, what they went through, and a summary `[]` each: means over all steps of
      `environment/<metric>`, and over the `episodes` that ended of `episode/<value>`, `return` (unscaled) and
      `length`; these are not a number where none ended.
    """
    step_environment = map_environments(environment.step, (0, 0, 0, None), mesh)

    def step(carry: tuple[Actors, _Sums], index: Array) -> tuple[tuple[Actors, _Sums], Rollout]:
        actors, sums = carry
        keys = _environment_keys(jax.random.fold_in(key, index), config.environments, mesh)
        action_keys, step_keys = jax.vmap(jax.random.split, out_axes=1)(keys)
        remembered, output = outputs(policy, actors.carry, actors.observation, actors.reset)
        noise = jax.vmap(distributions.following_noise, in_axes=(0, 0, None, 0))(
            action_keys, actors.noise, noise_correlation, actors.reset
        )
        action = output.mean + jnp.exp(output.log_std) * noise
        observation, state, reward, terminated, truncated, info = step_environment(
            step_keys, actors.environment, action, params
        )
        bootstrap = _value_where(policy, remembered, info["last_observation"], truncated)
        ended = terminated | truncated
        returns, lengths = actors.episode_return + reward, actors.episode_length + 1
        sums = _add(sums, info, ended, returns, lengths)
        moved = Actors(
            environment=state,
            observation=observation,
            carry=remembered,
            reset=ended,
            noise=noise,
            episode_return=jnp.where(ended, 0.0, returns),
            episode_length=jnp.where(ended, 0, lengths),
        )
        seen = Rollout(
            observations=actors.observation,
            resets=actors.reset,
            actions=action,
            log_probs=distributions.log_prob(output.mean, output.log_std, action),
            values=output.value,
            next_values=bootstrap,
            rewards=reward,
            terminated=terminated,
            truncated=truncated,
        )
        return (constrain(moved, mesh, 0), sums), seen

    actors = constrain(actors, mesh, 0)
    start = actors, _no_sums(config, environment, actors, params, key)
    (actors, sums), rollout = jax.lax.scan(step, start, jnp.arange(config.rollout_steps))
    _, after = outputs(policy, actors.carry, actors.observation, actors.reset)
    following = jnp.concatenate([rollout.values[1:], after.value[None]])
    next_values = jnp.where(rollout.truncated, rollout.next_values, following)
    rollout = constrain(rollout._replace(next_values=next_values), mesh, 1)
    return actors, rollout, _summary(sums, config.rollout_steps * config.environments)


def sequence(policy: Policy, rollout: Rollout) -> tuple[Array, Array]:
    """What the networks get to see of a rollout: normalised observations, and resets."""
    return normalized(policy, rollout.observations), rollout.resets


def _environment_keys(key: Array, environments: int, mesh: jax.sharding.Mesh | None) -> Array:
    indices = constrain(jnp.arange(environments), mesh, 0)
    return jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, indices)


def _value_where(policy: Policy, carry: Carry, observation: Array, wanted: Array) -> Array:
    """Values of observations within an episode, or zeros if none is wanted, which is so in most steps."""

    def values() -> Array:
        return outputs(policy, carry, observation, jnp.zeros_like(wanted))[1].value

    return jax.lax.cond(jnp.any(wanted), values, lambda: jnp.zeros(wanted.shape))


def _no_sums(config: PPOConfig, environment: Environment, actors: Actors, params: Any, key: Array) -> _Sums:
    state = jax.tree.map(lambda leaf: leaf[0], actors.environment)
    action = jnp.zeros(environment.action_size)
    info: Info = jax.eval_shape(environment.step, key, state, action, params)[-1]
    zeros = jnp.zeros(config.environments)
    return _Sums(
        metrics={name: zeros for name in info["metrics"]},
        episode={name: zeros for name in info["episode"]},
        episodes=zeros,
        returns=zeros,
        lengths=zeros,
    )


def _add(sums: _Sums, info: Info, ended: Array, returns: Array, lengths: Array) -> _Sums:
    def of_ended(values: Array) -> Array:
        return jnp.where(ended, values.astype(jnp.float32), 0.0)

    return _Sums(
        metrics={name: sums.metrics[name] + value.astype(jnp.float32) for name, value in info["metrics"].items()},
        episode={name: sums.episode[name] + of_ended(value) for name, value in info["episode"].items()},
        episodes=sums.episodes + ended.astype(jnp.float32),
        returns=sums.returns + of_ended(returns),
        lengths=sums.lengths + of_ended(lengths),
    )


def _summary(sums: _Sums, steps: int) -> dict[str, Array]:
    episodes = jnp.sum(sums.episodes)
    summary = {f"environment/{name}": jnp.sum(total) / steps for name, total in sums.metrics.items()}
    summary |= {f"episode/{name}": jnp.sum(total) / episodes for name, total in sums.episode.items()}
    return summary | {
        "episodes": episodes,
        "return": jnp.sum(sums.returns) / episodes,
        "length": jnp.sum(sums.lengths) / episodes,
    }


def _strong(leaf: Array) -> Array:
    """The same array, of a type that does not give way to others: it stays the same from step to step."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.extended):
        return leaf
    return jnp.asarray(leaf, leaf.dtype)
