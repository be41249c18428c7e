"""Training solves what it has to be able to solve, and fails where it has to fail."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ppo_environments import ACTION, CONSTANT, DISCOUNTED, OBSERVED, TERMINATED, TRUNCATED, CartPole, Probe, Recall

import ppo

DISCOUNT = 0.8


@pytest.fixture(scope="module")
def probe_policies():
    """A policy for each probe, trained side by side."""
    config = ppo.PPOConfig(
        environments=8,
        rollout_steps=16,
        minibatches=2,
        network=ppo.NetworkConfig(lstm_size=16, encoder=(16,), head=(), memory=False),
        normalize_observations=False,
        scale_rewards=False,
    )
    settings = ppo.Hyperparameters(
        learning_rate=5e-3, final_learning_rate=1e-4, decay_updates=150, discount=DISCOUNT, entropy_coefficient=0.0
    )

    @jax.jit
    def run(kind):
        state, metrics = ppo.train(config, Probe(), settings, kind, jax.random.key(1), 200)
        return ppo.current_policy(config, state), metrics["return"][-1]

    return jax.vmap(run)(jnp.arange(6))


@pytest.mark.parametrize(
    ("kind", "observation", "expected"),
    [
        (CONSTANT, [0.0, 0.0], 1.0),
        (OBSERVED, [1.0, 0.0], 1.0),
        (OBSERVED, [-1.0, 0.0], -1.0),
        (DISCOUNTED, [0.0, 0.0], DISCOUNT),
        (DISCOUNTED, [0.0, 1.0], 1.0),
        (TRUNCATED, [0.0, 0.0], 1.0 / (1.0 - DISCOUNT)),
        (TERMINATED, [0.0, 0.0], 1.0 + DISCOUNT),
        (TERMINATED, [0.0, 1.0], 1.0),
    ],
)
def test_values_of_probes(probe_policies, kind, observation, expected):
    policies, _ = probe_policies
    policy = jax.tree.map(lambda leaf: leaf[kind], policies)
    _, value = ppo.value(policy, None, jnp.asarray([observation]), jnp.asarray([True]))
    assert float(value[0]) == pytest.approx(expected, abs=0.05)


def test_the_best_action_is_found(probe_policies):
    policies, returns = probe_policies
    policy = jax.tree.map(lambda leaf: leaf[ACTION], policies)
    _, action = ppo.act(policy, None, jnp.zeros((1, 2)), jnp.asarray([True]))
    assert float(action[0, 0]) == pytest.approx(0.5, abs=0.05)
    assert float(returns[ACTION]) > -0.05


def recalled(memory: bool) -> float:
    """Mean return after training on `Recall`."""
    config = ppo.PPOConfig(
        environments=16,
        rollout_steps=16,
        network=ppo.NetworkConfig(lstm_size=16, encoder=(), head=(), memory=memory),
    )
    settings = ppo.Hyperparameters(learning_rate=1e-2, discount=0.95, entropy_coefficient=0.0)

    @jax.jit
    def run():
        state, _ = ppo.train(config, Recall(), settings, None, jax.random.key(0), 60)
        policy = ppo.current_policy(config, state)
        keys, nothing = jax.random.split(jax.random.key(1), 200), jnp.zeros((200, 0))
        return ppo.evaluate(
            Recall(), partial(ppo.act, policy), nothing, keys, 10, ppo.initial_carry(policy, (200,))
        ).returns

    return float(np.mean(run()))


def test_only_a_memory_recalls():
    assert recalled(memory=True) > 0.9
    assert abs(recalled(memory=False)) < 0.3


def test_pole_is_balanced():
    config = ppo.PPOConfig(
        environments=16, rollout_steps=128, network=ppo.NetworkConfig(lstm_size=16, encoder=(16,), head=())
    )
    settings = ppo.Hyperparameters(learning_rate=3e-3, final_learning_rate=1e-4, decay_updates=60, initial_std=0.5)

    @jax.jit
    def run(key):
        state, _ = ppo.train(config, CartPole(), settings, None, key, 60)
        policy = ppo.current_policy(config, state)
        keys, nothing = jax.random.split(jax.random.key(1), 20), jnp.zeros((20, 0))
        carry = ppo.initial_carry(policy, (20,))
        return ppo.evaluate(CartPole(), partial(ppo.act, policy), nothing, keys, 501, carry)

    found = run(jax.random.key(0))
    assert np.all(found.ended)
    assert np.mean(found.returns) >= 475.0, found.returns
    assert np.max(found.returns) == 500.0, "episodes are cut there"
