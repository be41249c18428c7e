"""Gaussians with independent elements, of which policies draw their actions."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

LOG_2_PI = math.log(2.0 * math.pi)


def following_noise(key: Array, before: Array, correlation: Array | float, fresh: Array) -> Array:
    """Standard Gaussian noise that goes on from what was drawn before: a stationary first-order autoregression.

    Args:
      key: random key, one for all.
      before: `[..., size]`, standard Gaussian noise.
      correlation: `[]`, of every element with the one before; 0 forgets it.
      fresh: `[...]` bool, where nothing was before.
    """
    drawn = jax.random.normal(key, before.shape, before.dtype)
    kept = jnp.where(fresh, 0.0, jnp.asarray(correlation, before.dtype))[..., None]
    return kept * before + jnp.sqrt(1.0 - kept**2) * drawn


def log_prob(mean: Array, log_std: Array, value: Array) -> Array:
    """Logarithm of the density at `value`, `[...]` for arguments `[..., size]`."""
    standard = (value - mean) * jnp.exp(-log_std)
    return -0.5 * jnp.sum(standard**2 + 2.0 * log_std + LOG_2_PI, axis=-1)


def entropy(log_std: Array) -> Array:
    """Differential entropy in nats, `[...]` for `[..., size]`."""
    return jnp.sum(log_std + 0.5 * (1.0 + LOG_2_PI), axis=-1)
