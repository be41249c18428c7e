"""Generalized advantage estimation (Schulman et al., 2016)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array


def generalized_advantages(
    rewards: Array,
    values: Array,
    next_values: Array,
    terminated: Array,
    truncated: Array,
    discount: Array | float,
    gae_lambda: Array | float,
) -> tuple[Array, Array]:
    """How much better than expected actions turned out.

    With δ = reward + γ next_value − value, where the next value counts 0 after a termination, the advantage is
    A_t = δ_t + γ λ A_{t+1}, and A_{t+1} counts 0 after either kind of end (equations 11 and 16 of the paper).

    Args:
      rewards: `[time, environments]`.
      values: `[time, environments]`, of the observations that were acted upon.
      next_values: `[time, environments]`, of what was observed after each step, before any reset.
      terminated: `[time, environments]`, whether the episode ended with the step.
      truncated: `[time, environments]`, whether it was cut.
      discount: γ.
      gae_lambda: λ.

    Returns:
      Advantages and returns (advantages plus values), `[time, environments]` each.
    """
    errors = rewards + discount * jnp.where(terminated, 0.0, next_values) - values
    ended = terminated | truncated

    def step(later: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        error, ended = inputs
        advantage = error + discount * gae_lambda * jnp.where(ended, 0.0, later)
        return advantage, advantage

    _, advantages = jax.lax.scan(step, jnp.zeros_like(errors[0]), (errors, ended), reverse=True)
    return advantages, advantages + values
