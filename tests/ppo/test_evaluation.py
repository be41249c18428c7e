"""Episodes are driven to their first ends, each by itself."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from ppo_environments import SMALL, Drift

import ppo


def alone(policy, key, max_steps):
    """One episode in a plain loop."""
    act, advance = jax.jit(ppo.act), jax.jit(Drift().step)
    reset_key, step_key = jax.random.split(key)
    observation, state = Drift().reset(reset_key, None)
    carry, total, ends = ppo.initial_carry(policy, (1,)), 0.0, 0.0
    for step in range(max_steps):
        carry, action = act(policy, carry, observation[None], jnp.asarray([step == 0]))
        observation, state, reward, terminated, truncated, info = advance(
            jax.random.fold_in(step_key, step), state, action[0], None
        )
        total, ends = total + float(reward), ends + float(info["metrics"]["ended"])
        if terminated or truncated:
            return total, step + 1, True, float(info["episode"]["terminated"]), ends
    return total, max_steps, False, 0.0, ends


def test_episodes_are_the_same_as_one_by_one(unbroken):
    policy = ppo.current_policy(SMALL, unbroken[-1][0])
    keys, nothing = jax.random.split(jax.random.key(3), 12), jnp.zeros((12, 0))
    evaluate = partial(ppo.evaluate, Drift(), partial(ppo.act, policy), record=4)
    run = jax.jit(lambda: evaluate(nothing, keys, 5, ppo.initial_carry(policy, (12,))))
    found = run()
    assert jax.eval_shape(
        lambda: evaluate(nothing, keys, 5, ppo.initial_carry(policy, (12,)), record=0)
    ).rewards.shape == (12, 0)
    expected = [alone(policy, key, 5) for key in keys]
    returns, lengths, ended, terminated, ends = map(np.asarray, zip(*expected, strict=True))
    assert 0 < ended.sum() < 12 and len(set(lengths)) > 2
    np.testing.assert_allclose(found.returns, returns, atol=1e-5)
    np.testing.assert_allclose(found.metrics["reward"], returns, atol=1e-5)
    np.testing.assert_array_equal(found.lengths, lengths)
    np.testing.assert_array_equal(found.ended, ended)
    assert found.rewards.shape == (12, 4)
    short = lengths <= 4
    assert short.any()
    np.testing.assert_allclose(found.rewards.sum(axis=1)[short], returns[short], atol=1e-5)
    np.testing.assert_array_equal(found.rewards[np.arange(4) >= lengths[:, None]], 0.0)
    np.testing.assert_array_equal(found.metrics["ended"], ends)
    np.testing.assert_array_equal(np.where(ended, found.episode["terminated"], 0.0), terminated)
