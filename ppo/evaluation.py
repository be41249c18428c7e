"""Drive episodes to their ends and sum up how they went."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import Mesh

from ppo.environment import Environment
from ppo.sharding import check_divisible, map_environments

Act = Callable[[Any, Array, Array], tuple[Any, Array]]
"""What is done: (carry, observation `[episodes, observation_size]`, reset `[episodes]`) → (carry, action)."""


class Evaluation(NamedTuple):
    """How episodes went, `[episodes]` each."""

    returns: Array
    """Sums of rewards."""
    lengths: Array
    """int32, steps."""
    ended: Array
    """bool; False where an episode was still running after the last step that was allowed."""
    metrics: dict[str, Array]
    """Sums of `info["metrics"]` over the steps."""
    episode: dict[str, Array]
    """`info["episode"]` of the last step."""
    rewards: Array
    """`[episodes, recorded]`, of the first steps, as many as were to be recorded; 0 after an episode's end."""


class _Running(NamedTuple):
    """Episodes on their way."""

    carry: Any
    observation: Array
    environment: Any
    keys: Array
    step: Array
    found: Evaluation


def evaluate(
    environment: Environment,
    act: Act,
    params: Any,
    keys: Array,
    max_steps: int,
    carry: Any = None,
    mesh: Mesh | None = None,
    record: int = 0,
) -> Evaluation:
    """Drive one episode for each leading element of `params` and `keys`, to its end.

    Args:
      environment: static.
      act: what is done, for all episodes at once; `functools.partial(ppo.act, policy)` is a policy's mean action.
      params: of the environment, with a leading axis of episodes.
      keys: `[episodes]` typed random keys; an episode depends on its own key alone.
      max_steps: traced or not; episodes that run longer are left there.
      carry: what `act` remembers before the first step, for example `ppo.initial_carry(policy, (episodes,))`.
      mesh: devices that share the episodes.
      record: static; of how many steps the rewards are to be recorded.

    Returns:
      How the episodes went.
    """
    episodes = keys.shape[0]
    check_divisible(episodes, mesh)
    reset = map_environments(environment.reset, (0, 0), mesh)
    step_environment = map_environments(environment.step, (0, 0, 0, 0), mesh)
    reset_keys, step_keys = jax.vmap(jax.random.split, out_axes=1)(keys)
    observation, state = reset(reset_keys, params)
    action = jnp.zeros((episodes, environment.action_size))
    info = jax.eval_shape(step_environment, step_keys, state, action, params)[-1]
    zeros = jnp.zeros(episodes)
    nothing = Evaluation(
        returns=zeros,
        lengths=jnp.zeros(episodes, jnp.int32),
        ended=jnp.zeros(episodes, bool),
        metrics={name: zeros for name in info["metrics"]},
        episode={name: zeros for name in info["episode"]},
        rewards=jnp.zeros((episodes, record)),
    )

    def goes_on(running: _Running) -> Array:
        return (running.step < max_steps) & ~jnp.all(running.found.ended)

    def drive(running: _Running) -> _Running:
        keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(running.keys, running.step)
        begins = jnp.full((episodes,), running.step == 0)
        carry, action = act(running.carry, running.observation, begins)
        observation, state, reward, terminated, truncated, info = step_environment(
            keys, running.environment, action, params
        )
        found = _taken_in(running.found, running.step, reward, terminated | truncated, info)
        return _Running(carry, observation, state, running.keys, running.step + 1, found)

    start = _Running(carry, observation, state, step_keys, jnp.int32(0), nothing)
    return jax.lax.while_loop(goes_on, drive, start).found


def _taken_in(found: Evaluation, step: Array, reward: Array, ended: Array, info: dict[str, Any]) -> Evaluation:
    """Add a step of those episodes that were still running; the others have begun anew and do not count."""
    active = ~found.ended

    def added(total: Array, value: Array) -> Array:
        return jnp.where(active, total + value.astype(total.dtype), total)

    def latest(old: Array, value: Array) -> Array:
        return jnp.where(active, value.astype(old.dtype), old)

    return Evaluation(
        returns=added(found.returns, reward),
        lengths=added(found.lengths, active),
        ended=found.ended | ended,
        metrics={name: added(found.metrics[name], value) for name, value in info["metrics"].items()},
        episode={name: latest(found.episode[name], value) for name, value in info["episode"].items()},
        rewards=_recorded(found.rewards, step, jnp.where(active, reward, 0.0)),
    )


def _recorded(rewards: Array, step: Array, reward: Array) -> Array:
    """The record with one more step, unless it is full."""
    return rewards.at[:, step].set(reward, mode="drop") if rewards.shape[1] else rewards
