"""Advantages, the loss, the Gaussian and running moments against plain NumPy in double precision."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from ppo import Hyperparameters, distributions
from ppo.advantages import generalized_advantages
from ppo.loss import Batch, explained_variance, ppo_loss
from ppo.lstm import Memory, lstm
from ppo.networks import PolicyOutput
from ppo.normalization import (
    initial_moments,
    initial_return_scale,
    normalize,
    return_std,
    update_moments,
    update_return_scale,
)

TIME, ENVIRONMENTS, ACTIONS = 12, 5, 3


def plain_advantages(rewards, values, next_values, terminated, truncated, discount, gae_lambda):
    """The sum that defines them, term by term, for every step anew."""
    advantages = np.zeros_like(rewards)
    for time, environment in np.ndindex(*rewards.shape):
        weight = 1.0
        for later in range(time, len(rewards)):
            at = later, environment
            following = 0.0 if terminated[at] else next_values[at]
            advantages[time, environment] += weight * (rewards[at] + discount * following - values[at])
            weight *= discount * gae_lambda
            if terminated[at] or truncated[at]:
                break
    return advantages


@pytest.mark.parametrize("seed", range(3))
def test_advantages_are_the_sum_that_defines_them(seed):
    random = np.random.default_rng(seed)
    rewards, values, next_values = random.normal(size=(3, TIME, ENVIRONMENTS))
    ends = random.integers(0, 6, size=(TIME, ENVIRONMENTS))
    arguments = rewards, values, next_values, ends == 0, ends == 1
    assert (ends == 0).any() and (ends == 1).any()
    expected = plain_advantages(*arguments, 0.95, 0.8)
    singles = (jnp.asarray(array, jnp.float32 if array.dtype == float else bool) for array in arguments)
    advantages, returns = jax.jit(generalized_advantages)(*singles, 0.95, 0.8)
    np.testing.assert_allclose(advantages, expected, atol=1e-5)
    np.testing.assert_allclose(returns, expected + values, atol=1e-5)


def test_a_terminations_next_value_may_be_anything():
    zeros, nothing = jnp.zeros((2, 1)), jnp.zeros((2, 1), bool)
    advantages, _ = generalized_advantages(zeros, zeros, zeros + jnp.nan, ~nothing, nothing, 0.9, 0.9)
    np.testing.assert_array_equal(advantages, zeros)


def plain_loss(outputs, batch, settings):
    """The loss and its parts in double precision."""
    (mean, log_std, value), (actions, log_probs, advantages, returns) = outputs, batch
    standard = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    log_ratio = stats.norm.logpdf(actions, mean, np.exp(log_std)).sum(-1) - log_probs
    ratio, epsilon = np.exp(log_ratio), settings.clip_epsilon
    policy = -np.minimum(ratio * standard, np.clip(ratio, 1 - epsilon, 1 + epsilon) * standard).mean()
    value = 0.5 * ((value - returns) ** 2).mean()
    entropy = stats.norm.entropy(0.0, np.exp(log_std)).sum()
    kl, clipped = (ratio - 1 - log_ratio).mean(), (np.abs(ratio - 1) > epsilon).mean()
    total = policy + settings.value_coefficient * value - settings.entropy_coefficient * entropy
    return total, (policy, value, entropy, kl, clipped)


@pytest.mark.parametrize("seed", range(3))
def test_loss_and_gradient_are_those_of_double_precision(seed):
    random = np.random.default_rng(seed)
    settings = Hyperparameters(clip_epsilon=0.2, entropy_coefficient=0.05)
    mean = random.normal(size=(TIME, ENVIRONMENTS, ACTIONS))
    log_std = random.normal(size=ACTIONS) * 0.3
    value, advantages, returns = random.normal(size=(3, TIME, ENVIRONMENTS))
    actions = mean + np.exp(log_std) * random.normal(size=mean.shape)
    log_probs = stats.norm.logpdf(actions, mean, np.exp(log_std)).sum(-1) + 0.3 * random.normal(size=value.shape)
    batch = actions, log_probs, advantages, returns
    expected, parts = plain_loss((mean, log_std, value), batch, settings)
    assert 0.1 < parts[-1] < 0.9, "some ratios are clipped and some are not"

    single = [jnp.asarray(array, jnp.float32) for array in (mean, log_std, value)]
    in_single = Batch(*(jnp.asarray(array, jnp.float32) for array in batch))
    compute = jax.jit(
        jax.value_and_grad(lambda *outputs: ppo_loss(PolicyOutput(*outputs), in_single, settings), (0, 1, 2), True)
    )
    (loss, terms), gradients = compute(*single)
    np.testing.assert_allclose(loss, expected, atol=1e-5)
    np.testing.assert_allclose(terms, parts, atol=1e-5)

    outputs = [mean, log_std, value]
    for position, gradient in enumerate(gradients):
        for index in np.ndindex(*outputs[position].shape):
            moved = [array.copy() for array in outputs]
            moved[position][index] += 1e-6
            above, _ = plain_loss(moved, batch, settings)
            moved[position][index] -= 2e-6
            below, _ = plain_loss(moved, batch, settings)
            np.testing.assert_allclose(gradient[index], (above - below) / 2e-6, atol=1e-5)


def test_explained_variance():
    returns = jnp.asarray([[1.0, 2.0], [3.0, 6.0]])
    assert float(explained_variance(returns + 5.0, returns)) == 1.0
    assert float(explained_variance(jnp.zeros_like(returns), returns)) == 0.0
    assert abs(float(explained_variance(0.5 * returns, returns)) - 0.75) < 1e-6


def test_gaussian_is_that_of_scipy():
    random = np.random.default_rng(0)
    mean, value = random.normal(size=(2, 4, ACTIONS)).astype(np.float32)
    log_std = random.normal(size=ACTIONS).astype(np.float32)
    expected = stats.norm.logpdf(value, mean, np.exp(log_std)).sum(-1)
    np.testing.assert_allclose(distributions.log_prob(*map(jnp.asarray, (mean, log_std, value))), expected, rtol=1e-5)
    expected = stats.norm.entropy(mean[0], np.exp(log_std)).sum()
    np.testing.assert_allclose(distributions.entropy(jnp.asarray(log_std)), expected, rtol=1e-5)


def test_noise_is_gaussian_and_correlated_as_told_until_an_episode_ends():
    keys = jax.random.split(jax.random.key(0), (3, 4000))
    none = jnp.zeros((4000, ACTIONS))

    def follow(keys, before, fresh, correlation=0.8):
        return jax.vmap(distributions.following_noise, in_axes=(0, 0, None, None))(keys, before, correlation, fresh)

    first = follow(keys[0], none, True)
    second = follow(keys[1], first, False)
    after_the_end, independent = follow(keys[2], second, True), follow(keys[2], second, False, 0.0)
    for noise in (first, second, after_the_end):
        for index in range(ACTIONS):
            assert stats.kstest(np.asarray(noise[:, index]), stats.norm.cdf).pvalue > 1e-3
            found = np.corrcoef(np.asarray([first, second, after_the_end])[:, :, index])
            np.testing.assert_allclose(found[np.triu_indices(3, 1)], [0.8, 0.0, 0.0], atol=0.06)
    np.testing.assert_array_equal(after_the_end, independent)


def test_moments_are_those_of_all_chunks_together():
    random = np.random.default_rng(0)
    moments, chunks = initial_moments((3,)), []
    for _ in range(6):
        shape = (*random.integers(1, 7, size=2), 3)
        chunks.append((random.normal(size=shape) * [0.01, 1.0, 300.0] + [100.0, 0.0, -2000.0]).astype(np.float32))
        moments = update_moments(moments, jnp.asarray(chunks[-1]))
    seen = np.concatenate([chunk.reshape(-1, 3) for chunk in chunks]).astype(float)
    np.testing.assert_allclose(moments.mean, seen.mean(0), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moments.variance, seen.var(0), rtol=1e-3)
    assert float(moments.count) == len(seen)
    standard = normalize(moments, jnp.asarray(seen, jnp.float32), 2.0, 1e-4)
    expected = np.clip((seen - seen.mean(0)) / seen.std(0), -2.0, 2.0)
    np.testing.assert_allclose(standard, expected, atol=2e-3)
    assert np.abs(expected).max() == 2.0
    np.testing.assert_allclose(
        normalize(moments, jnp.float32([100.5, 0.0, -2000.0]), 9.0, 0.1)[0], (100.5 - 100.0) / 0.1005, rtol=0.02
    )


def test_return_scale_is_that_of_a_loop():
    random = np.random.default_rng(0)
    scale, running, seen = initial_return_scale(ENVIRONMENTS), np.zeros(ENVIRONMENTS), []
    for _ in range(3):
        rewards = random.normal(size=(TIME, ENVIRONMENTS)) + 2.0
        ended = random.random((TIME, ENVIRONMENTS)) < 0.2
        for reward, end in zip(rewards, ended, strict=True):
            running = 0.9 * running + reward
            seen.append(running)
            running = np.where(end, 0.0, running)
        scale = update_return_scale(scale, jnp.asarray(rewards, jnp.float32), jnp.asarray(ended), 0.9)
    np.testing.assert_allclose(scale.returns, running, rtol=1e-5)
    np.testing.assert_allclose(return_std(scale), np.std(seen), rtol=1e-5)


def test_returns_that_are_all_the_same_scale_nothing():
    ended = jnp.ones((TIME, ENVIRONMENTS), bool)
    scale = update_return_scale(initial_return_scale(ENVIRONMENTS), jnp.full(ended.shape, 0.3), ended, 0.9)
    assert float(return_std(scale)) == 1.0


def plain_lstm(kernel, projected, reset, memory):
    """The same layer, whose derivative is left to JAX."""

    def step(memory, inputs):
        projected, reset = inputs
        hidden, cell = (jnp.where(reset[:, None], 0.0, part) for part in memory)
        write, keep, value, read = jnp.split(projected + hidden @ kernel, 4, axis=-1)
        cell = jax.nn.sigmoid(keep) * cell + jax.nn.sigmoid(write) * jnp.tanh(value)
        hidden = jax.nn.sigmoid(read) * jnp.tanh(cell)
        return Memory(hidden, cell), hidden

    return jax.lax.scan(step, memory, (projected, reset))


def test_derivative_of_the_lstm_is_that_of_jax():
    size, keys = 4, jax.random.split(jax.random.key(0), 6)
    kernel, weights = jax.random.normal(keys[0], (size, 4 * size)), jax.random.normal(keys[1], (TIME, 2, size))
    projected, reset = jax.random.normal(keys[2], (TIME, 2, 4 * size)), jax.random.bernoulli(keys[3], 0.3, (TIME, 2))
    memory = Memory(*jax.random.normal(keys[4], (2, 2, size)))

    def loss(layer, kernel, projected, memory):
        last, outputs = layer(kernel, projected, reset, memory)
        return jnp.sum(outputs * weights) + jnp.sum(last.hidden * weights[0]) + jnp.sum(last.cell * weights[1] ** 2)

    gradient = jax.jit(jax.grad(loss, argnums=(1, 2, 3)), static_argnums=0)
    found, expected = (gradient(layer, kernel, projected, memory) for layer in (lstm, plain_lstm))
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-5), found, expected)
