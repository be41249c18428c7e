"""Small environments whose solutions are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

import ppo

SMALL = ppo.PPOConfig(
    environments=8,
    rollout_steps=12,
    epochs=2,
    minibatches=2,
    network=ppo.NetworkConfig(lstm_size=8, encoder=(8,), head=(8,)),
)
"""Settings that compile and run in no time."""


@dataclass(frozen=True)
class Episodic:
    """Environments in terms of `begin`, `advance` and `observe`, which begin the next episode by themselves."""

    observation_size: int = 1
    action_size: int = 1

    def begin(self, key: Array, params: Any) -> Any:
        """First state."""
        raise NotImplementedError

    def advance(self, key: Array, state: Any, action: Array, params: Any) -> tuple[Any, Array, Array, Array]:
        """Next state, reward, terminated, truncated."""
        raise NotImplementedError

    def observe(self, state: Any, params: Any) -> Array:
        """Observation of a state."""
        raise NotImplementedError

    def reset(self, key: Array, params: Any) -> tuple[Array, Any]:
        """As `ppo.Environment` asks."""
        state = self.begin(key, params)
        return self.observe(state, params), state

    def step(self, key: Array, state: Any, action: Array, params: Any) -> tuple:
        """As `ppo.Environment` asks."""
        step_key, reset_key = jax.random.split(key)
        moved, reward, terminated, truncated = self.advance(step_key, state, jnp.clip(action, -1, 1), params)
        last, (first, fresh) = self.observe(moved, params), self.reset(reset_key, params)
        ended = terminated | truncated
        after = jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, moved)
        info = {
            "last_observation": last,
            "metrics": {"reward": reward, "ended": ended},
            "episode": {"terminated": terminated, "last_reward": reward},
        }
        return jnp.where(ended, first, last), after, reward, terminated, truncated, info


@dataclass(frozen=True)
class Drift(Episodic):
    """A point that drifts about, with ends of both kinds at random, and a loop as long as chance has it."""

    observation_size: int = 3
    action_size: int = 2

    def begin(self, key, params):
        return jax.random.normal(key, (3,)), jnp.int32(0)

    def advance(self, key, state, action, params):
        point, steps = state
        end_key, noise_key, loop_key = jax.random.split(key, 3)
        turns = jax.random.randint(loop_key, (), 0, 4)
        _, noise = jax.lax.while_loop(
            lambda carry: carry[0] < turns,
            lambda carry: (carry[0] + 1, 0.5 * carry[1]),
            (jnp.int32(0), jax.random.normal(noise_key, (3,))),
        )
        point = 0.9 * point + 0.3 * noise + 0.1 * jnp.concatenate([action, action[:1]])
        reward = 1.0 - jnp.sum((action - point[:2]) ** 2)
        terminated = jax.random.uniform(end_key) < 0.15
        truncated = ~terminated & (steps >= 5)
        return (point, steps + 1), reward, terminated, truncated

    def observe(self, state, params):
        return state[0]


@dataclass(frozen=True)
class Broken(Drift):
    """`Drift` without ends that breaks at step `params["at"]`: what it observes then, or else its reward."""

    def advance(self, key, state, action, params):
        (point, steps), reward, _, _ = super().advance(key, state, action, params)
        bad = steps == params["at"] + 1
        reward = jnp.where(bad & ~params["observation"], jnp.nan, reward)
        point = point.at[1].set(jnp.where(bad & params["observation"], jnp.nan, point[1]))
        return (point, steps), reward, jnp.asarray(False), jnp.asarray(False)


CONSTANT, OBSERVED, DISCOUNTED, ACTION, TRUNCATED, TERMINATED = range(6)
PROBE_STEPS = 1, 1, 2, 1, 3, 2


@dataclass(frozen=True)
class Probe(Episodic):
    """Six environments in one, of which `params` names one; see `test_probes`."""

    observation_size: int = 2

    def begin(self, key, params):
        return jnp.sign(jax.random.uniform(key, minval=-1.0)), jnp.int32(0)

    def advance(self, key, state, action, params):
        cue, steps = state
        last = steps + 1 >= jnp.asarray(PROBE_STEPS)[params]
        one = jnp.float32(1.0)
        rewards = jnp.stack([one, cue, last.astype(jnp.float32), -((action[0] - 0.5) ** 2), one, one])
        return (cue, steps + 1), rewards[params], last & (params != TRUNCATED), last & (params == TRUNCATED)

    def observe(self, state, params):
        cue, steps = state
        timed = (params == DISCOUNTED) | (params == TERMINATED)
        return jnp.stack([jnp.where(params == OBSERVED, cue, 0.0), jnp.where(timed, steps.astype(jnp.float32), 0.0)])


@dataclass(frozen=True)
class Recall(Episodic):
    """The first observation shows a sign that the action has to show three steps later; only that step counts."""

    observation_size: int = 2

    def begin(self, key, params):
        return jnp.sign(jax.random.uniform(key, minval=-1.0)), jnp.int32(0)

    def advance(self, key, state, action, params):
        cue, steps = state
        last = steps == 3
        return (cue, steps + 1), jnp.where(last, action[0] * cue, 0.0), last, jnp.asarray(False)

    def observe(self, state, params):
        cue, steps = state
        return jnp.stack([jnp.where(steps == 0, cue, 0.0), (steps == 3).astype(jnp.float32)])


@dataclass(frozen=True)
class CartPole(Episodic):
    """Barto, Sutton and Anderson (1983) as in Gymnasium's CartPole-v1; the action's sign is the force's."""

    observation_size: int = 4

    def begin(self, key, params):
        return jax.random.uniform(key, (4,), minval=-0.05, maxval=0.05), jnp.int32(0)

    def advance(self, key, state, action, params):
        (x, speed, angle, turning), steps = state
        force = jnp.where(action[0] > 0, 10.0, -10.0)
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        push = (force + 0.05 * turning**2 * sine) / 1.1
        turn = (9.8 * sine - cosine * push) / (0.5 * (4.0 / 3.0 - 0.1 * cosine**2 / 1.1))
        moved = jnp.stack(
            [x + 0.02 * speed, speed + 0.02 * (push - 0.05 * turn * cosine / 1.1), angle + 0.02 * turning, turning]
        )
        moved = moved.at[3].add(0.02 * turn)
        fallen = (jnp.abs(moved[0]) > 2.4) | (jnp.abs(moved[2]) > 0.2095)
        return (moved, steps + 1), jnp.float32(1.0), fallen, ~fallen & (steps + 1 >= 500)

    def observe(self, state, params):
        return state[0]
