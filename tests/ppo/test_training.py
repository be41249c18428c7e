"""The training loop: what it carries along, what it is deterministic in, and what it keeps."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ppo_environments import SMALL, Drift

import ppo
from ppo import distributions, networks
from ppo.rollout import collect, sequence
from ppo.update import learning_rate


@pytest.fixture(scope="module")
def go_on(unbroken):
    """State before a rollout that begins amid episodes, its policy, and what `collect` makes of a correlation."""
    state, _ = unbroken[0]
    policy = ppo.current_policy(SMALL, state)

    @jax.jit
    def run(correlation):
        return collect(SMALL, Drift(), policy, state.actors, None, jax.random.key(5), noise_correlation=correlation)

    return state, policy, run


@pytest.fixture(scope="module")
def second_rollout(go_on):
    """State before a rollout that begins amid episodes, its policy, the rollout and its summary."""
    state, policy, run = go_on
    return state, policy, *run(0.0)


def test_update_sees_the_probabilities_of_the_rollout(second_rollout):
    state, policy, _, rollout, _ = second_rollout
    assert not np.all(state.actors.reset), "some episodes go on from the rollout before"
    assert np.any(rollout.terminated[:-1]) and np.any(rollout.truncated[:-1])
    observations, resets = sequence(policy, rollout)
    _, output = networks.apply(SMALL.network, state.parameters, state.actors.carry, observations, resets)
    log_probs = distributions.log_prob(output.mean, output.log_std, rollout.actions)
    np.testing.assert_allclose(log_probs, rollout.log_probs, atol=1e-5)
    np.testing.assert_allclose(output.value, rollout.values, atol=1e-5)
    _, forgetful = networks.apply(SMALL.network, state.parameters, state.actors.carry, observations, resets | True)
    assert np.max(np.abs(forgetful.value - rollout.values)) > 1e-3, "what is remembered matters"


def test_noise_of_full_correlation_stays_until_an_episode_ends(go_on):
    state, _, run = go_on
    after, rollout, _ = run(1.0)
    observations, resets = sequence(ppo.current_policy(SMALL, state), rollout)
    _, output = networks.apply(SMALL.network, state.parameters, state.actors.carry, observations, resets)
    noise = np.asarray((rollout.actions - output.mean) / np.exp(output.log_std))
    before = np.concatenate([state.actors.noise[None], noise[:-1]])
    same = np.all(np.abs(noise - before) < 1e-4, axis=-1)
    np.testing.assert_array_equal(same, ~resets)
    np.testing.assert_allclose(after.noise, noise[-1], atol=1e-4)


def test_first_minibatch_has_ratio_one(unbroken, one_step):
    _, metrics = one_step(unbroken[0][0], ppo.Hyperparameters())
    assert abs(float(metrics["approximate_kl"])) < 1e-6
    assert float(metrics["clip_fraction"]) == 0.0


def test_sequence_at_once_is_the_same_as_step_by_step(second_rollout):
    state, policy, _, rollout, _ = second_rollout
    observations, resets = sequence(policy, rollout)
    last, at_once = networks.apply(SMALL.network, state.parameters, state.actors.carry, observations, resets)
    carry, apply_one = state.actors.carry, jax.jit(networks.apply_one, static_argnums=0)
    for time in range(SMALL.rollout_steps):
        carry, one = apply_one(SMALL.network, state.parameters, carry, observations[time], resets[time])
        np.testing.assert_allclose(one.mean, at_once.mean[time], atol=1e-6)
        np.testing.assert_allclose(one.value, at_once.value[time], atol=1e-6)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-6), carry, last)


def test_next_values_are_of_what_was_seen_before_the_reset(second_rollout):
    """A rollout by hand, with the same keys, step by step without `vmap` of the environment's reset."""
    state, policy, after, rollout, _ = second_rollout
    carry, step = state.actors.carry, jax.jit(jax.vmap(Drift().step, in_axes=(0, 0, 0, None)))
    act, judge = jax.jit(ppo.act), jax.jit(ppo.value)
    all_keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(jax.random.key(5), jnp.arange(SMALL.rollout_steps))
    all_keys = jax.vmap(jax.vmap(jax.random.fold_in, in_axes=(None, 0)), in_axes=(0, None))(all_keys, jnp.arange(8))
    environments, observation, reset = state.actors.environment, state.actors.observation, state.actors.reset
    for time in range(SMALL.rollout_steps):
        step_keys = jax.vmap(jax.random.split)(all_keys[time])[:, 1]
        carry, _ = act(policy, carry, observation, reset)
        observation, environments, reward, terminated, truncated, info = step(
            step_keys, environments, rollout.actions[time], None
        )
        reset = terminated | truncated
        np.testing.assert_allclose(reward, rollout.rewards[time], atol=1e-5)
        _, values = judge(policy, carry, info["last_observation"], jnp.zeros(8, bool))
        expected = np.where(terminated, 0.0, values / policy.return_std)
        found = np.where(terminated, 0.0, rollout.next_values[time])
        np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(observation, after.observation, atol=1e-5)


def test_summary_is_that_of_a_loop(second_rollout):
    state, _, after, rollout, summary = second_rollout
    total, length = np.array(state.actors.episode_return), np.array(state.actors.episode_length)
    ended = np.asarray(rollout.terminated | rollout.truncated)
    returns, lengths = [], []
    for time in range(SMALL.rollout_steps):
        total, length = total + rollout.rewards[time], length + 1
        returns += list(total[ended[time]])
        lengths += list(length[ended[time]])
        total, length = np.where(ended[time], 0.0, total), np.where(ended[time], 0, length)
    expected = {
        "episodes": len(returns),
        "return": np.mean(returns),
        "length": np.mean(lengths),
        "environment/reward": np.mean(rollout.rewards),
        "environment/ended": np.mean(ended),
        "episode/terminated": np.sum(rollout.terminated) / ended.sum(),
        "episode/last_reward": np.mean(np.asarray(rollout.rewards)[ended]),
    }
    assert summary.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(summary[name], value, rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(after.episode_return, total, atol=1e-5)
    np.testing.assert_array_equal(after.episode_length, length)


def test_first_policy_has_mean_nearly_zero_and_the_std_asked_for(start):
    policy = ppo.current_policy(SMALL, start)
    observation = 5.0 * jax.random.normal(jax.random.key(0), (50, 3))
    _, action = ppo.act(policy, ppo.initial_carry(policy, (50,)), observation, jnp.ones(50, bool))
    assert np.max(np.abs(action)) < 0.05
    np.testing.assert_allclose(np.exp(start.parameters["log_std"]), 0.3, rtol=1e-6)


def test_runs_are_the_same_bit_for_bit(start, update_once, unbroken, assert_equal):
    state = start
    for _ in range(2):
        state, metrics = update_once(state)
    assert_equal((state, metrics), unbroken[1])
    other, _ = update_once(replace(start, key=jax.random.key(1)))
    assert np.any(other.actors.observation != unbroken[0][0].actors.observation)


def test_hyperparameters_do_not_compile_anew(start):
    run: Any = jax.jit(partial(ppo.train_update, SMALL, Drift()))
    found = []
    for rate in (3e-4, 1, jnp.float32(1e-2)):
        settings = ppo.Hyperparameters(learning_rate=float(rate), discount=0.9, clip_epsilon=0.3)
        found.append(run(start, settings, None)[1]["learning_rate"])
    np.testing.assert_allclose(found, [3e-4, 1.0, 1e-2], rtol=1e-6)
    assert run._cache_size() == 1


def test_learning_rate_decays_linearly():
    def rates(**settings):
        return [float(learning_rate(ppo.Hyperparameters(**settings), jnp.int32(update))) for update in (0, 5, 10, 20)]

    found = rates(learning_rate=1e-3, final_learning_rate=2e-4, decay_updates=10)
    np.testing.assert_allclose(found, [1e-3, 6e-4, 2e-4, 2e-4], rtol=1e-6)
    np.testing.assert_allclose(rates(learning_rate=1e-3), [1e-3] * 4, rtol=1e-6)


def score(policy: ppo.Policy):
    total = jnp.sum(policy.parameters["log_std"])
    return total, {"total": total}


def assert_close(index, several, one):
    np.testing.assert_allclose(several[index], one, atol=1e-5)


@pytest.fixture(scope="module")
def chunk():
    """Two updates and a validation; of state, hyperparameters and whether to validate."""

    def run(state, settings, validate):
        return ppo.train_chunk(SMALL, Drift(), state, settings, None, 2, validate, score)

    return run


def test_seeds_at_once_are_the_same_as_one_by_one(chunk, start, update_once):
    settings = [ppo.Hyperparameters(learning_rate=rate, discount=0.9 * rate + 0.9) for rate in (1e-3, 1e-2)]
    states = [replace(start, key=jax.random.key(seed)) for seed in (1, 2)]
    stacked = (
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *states),
        jax.tree.map(lambda *leaves: jnp.float32(leaves), *settings),
    )
    several = jax.vmap(chunk, in_axes=(0, 0, None))
    conds = str(jax.make_jaxpr(several)(*stacked, True)).count(" cond[")
    assert conds == 1, "whether to validate stays a choice; that of bootstrapping has become one of both"
    found, metrics, _ = jax.jit(several)(*stacked, True)
    for index, (state, setting) in enumerate(zip(states, settings, strict=True)):
        for update in range(2):
            state, expected = update_once(state, setting)
            for name, value in expected.items():
                np.testing.assert_allclose(metrics[name][index, update], value, atol=1e-5, rtol=1e-5, err_msg=name)
        together, alone = (found.parameters, found.moments), (state.parameters, state.moments)
        jax.tree.map(partial(assert_close, index), together, alone)
    assert list(found.best_update) == [2, 2] and found.best_score[0] != found.best_score[1]


def test_the_best_policy_is_kept(chunk, start, assert_equal):
    run = jax.jit(chunk)
    rising, falling = ppo.Hyperparameters(entropy_coefficient=10.0), ppo.Hyperparameters(learning_rate=1e-2)
    state, metrics, scores = run(start, rising, False)
    assert np.isnan(scores["score"]) and float(scores["total"]) == 0.0
    assert int(state.best_update) == -1 and float(state.best_score) == -np.inf
    assert metrics["loss"].shape == (2,) and list(metrics["update"]) == [1, 2]

    state, _, scores = run(state, rising, True)
    first = ppo.current_policy(SMALL, state)
    assert_equal(state.best, first)
    assert int(state.best_update) == 4 and state.best_score == scores["score"] == scores["total"]

    lower = replace(state, parameters=state.parameters | {"log_std": state.parameters["log_std"] - 1.0})
    state, _, scores = run(lower, falling, True)
    assert float(scores["score"]) < float(state.best_score)
    assert_equal(state.best, first)
    assert int(state.best_update) == 4
