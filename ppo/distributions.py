"""Gaussians with independent elements, of which policies draw their actions."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

LOG_2_PI = math.log(2.0 * math.pi)


def sample(key: Array, mean: Array, log_std: Array) -> Array:
    """Draw once from the Gaussian of `mean` and `log_std`, `[..., size]` each, with one key for all."""
    return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)


def log_prob(mean: Array, log_std: Array, value: Array) -> Array:
    """Logarithm of the density at `value`, `[...]` for arguments `[..., size]`."""
    standard = (value - mean) * jnp.exp(-log_std)
    return -0.5 * jnp.sum(standard**2 + 2.0 * log_std + LOG_2_PI, axis=-1)


def entropy(log_std: Array) -> Array:
    """Differential entropy in nats, `[...]` for `[..., size]`."""
    return jnp.sum(log_std + 0.5 * (1.0 + LOG_2_PI), axis=-1)
