"""Running means and variances, by which observations and rewards are brought to a common scale."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from ppo._pytree import pytree_dataclass

VARIANCE_FLOOR = 1e-8
"""A variance of returns below this is none."""
CONSTANT = 1e-6
"""Returns whose variance is below this share of their squared mean are taken for constant."""


@pytree_dataclass
class RunningMoments:
    """Mean and variance of all that has been seen, `shape` each."""

    mean: Array
    variance: Array
    """Of the population: divided by the count."""
    count: Array
    """`[]` float32; beyond 2^24 it is rounded, which the weights of new values do not feel."""


def initial_moments(shape: tuple[int, ...]) -> RunningMoments:
    """Before anything is seen: mean 0, variance 1."""
    return RunningMoments(jnp.zeros(shape), jnp.ones(shape), jnp.float32(0.0))


def update_moments(moments: RunningMoments, values: Array) -> RunningMoments:
    """Take in `[..., *shape]` values, as by Chan, Golub and LeVeque (1979), equation 2.1, in terms of variances.

    The variance of the new values is found around their own mean, and all terms stay of the size of a variance, so
    nothing cancels and no sum grows with the count.
    """
    axes = tuple(range(values.ndim - moments.mean.ndim))
    added = jnp.float32(values.size / moments.mean.size)
    mean = jnp.mean(values, axis=axes)
    variance = jnp.mean((values - mean) ** 2, axis=axes)
    count = moments.count + added
    share, difference = added / count, mean - moments.mean
    return RunningMoments(
        mean=moments.mean + share * difference,
        variance=(1.0 - share) * (moments.variance + share * difference**2) + share * variance,
        count=count,
    )


def normalize(moments: RunningMoments, values: Array, clip: float, floor: float) -> Array:
    """Shift and scale `[..., *shape]` values to mean 0 and variance 1, and bound them by ± `clip`.

    `floor`² is added to variances before dividing.
    """
    standard = (values - moments.mean) * jax.lax.rsqrt(moments.variance + floor**2)
    return jnp.clip(standard, -clip, clip)


@pytree_dataclass
class ReturnScale:
    """The standard deviation of discounted returns, by which rewards are divided; they are never shifted."""

    moments: RunningMoments
    """Of the discounted sums of past rewards, shape `[]`."""
    returns: Array
    """`[environments]`, those sums in the running episodes."""


def initial_return_scale(environments: int) -> ReturnScale:
    """Before any reward."""
    return ReturnScale(initial_moments(()), jnp.zeros(environments))


def update_return_scale(scale: ReturnScale, rewards: Array, ended: Array, discount: Array | float) -> ReturnScale:
    """Take in a rollout.

    Args:
      scale: before it.
      rewards: `[time, environments]`.
      ended: `[time, environments]`, whether an episode ended with the step.
      discount: γ; a return is R ← γ R + reward, and begins at 0 with each episode.
    """

    def step(returns: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        reward, ended = inputs
        returns = discount * returns + reward
        return jnp.where(ended, 0.0, returns), returns

    running, returns = jax.lax.scan(step, scale.returns, (rewards, ended))
    return ReturnScale(update_moments(scale.moments, returns), running)


def return_std(scale: ReturnScale) -> Array:
    """What rewards are divided by, `[]`: 1 as long as returns are all the same."""
    moments = scale.moments
    varies = moments.variance > CONSTANT * moments.mean**2 + VARIANCE_FLOOR
    return jnp.where(varies, jnp.sqrt(jnp.where(varies, moments.variance, 1.0)), 1.0)
