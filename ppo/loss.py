"""The loss of proximal policy optimization (Schulman et al., 2017)."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from ppo import distributions
from ppo.config import Hyperparameters
from ppo.networks import PolicyOutput

ADVANTAGE_FLOOR = 1e-8
"""Added to the standard deviation of advantages before dividing."""


class Batch(NamedTuple):
    """What was collected, as the loss needs it; `[time, environments, ...]`."""

    actions: Array
    """`[..., action_size]`."""
    log_probs: Array
    """`[...]`, of the actions when they were drawn."""
    advantages: Array
    """`[...]`."""
    returns: Array
    """`[...]`, estimates that values are to meet."""


class LossTerms(NamedTuple):
    """Parts of the loss and what tells how an update goes, `[]` each."""

    policy_loss: Array
    value_loss: Array
    entropy: Array
    approximate_kl: Array
    """Estimate of the Kullback-Leibler divergence to the policy that collected: mean of (ratio − 1) − log ratio."""
    clip_fraction: Array
    """Share of actions whose ratio of probabilities left the bounds."""


def ppo_loss(outputs: PolicyOutput, batch: Batch, hyperparameters: Hyperparameters) -> tuple[Array, LossTerms]:
    """The clipped surrogate (equation 7 of the paper), half the squared error of values, and the entropy bonus.

    Advantages are shifted and scaled to mean 0 and variance 1 in the batch.

    Args:
      outputs: of the networks for the batch's observations.
      batch: what was collected.
      hyperparameters: clip range and coefficients.

    Returns:
      The loss `[]`, policy + value_coefficient · value − entropy_coefficient · entropy, and its parts.
    """
    advantages = batch.advantages - jnp.mean(batch.advantages)
    advantages = advantages / (jnp.sqrt(jnp.mean(advantages**2)) + ADVANTAGE_FLOOR)
    log_ratio = distributions.log_prob(outputs.mean, outputs.log_std, batch.actions) - batch.log_probs
    ratio, epsilon = jnp.exp(log_ratio), hyperparameters.clip_epsilon
    clipped = jnp.clip(ratio, 1.0 - epsilon, 1.0 + epsilon)
    terms = LossTerms(
        policy_loss=-jnp.mean(jnp.minimum(ratio * advantages, clipped * advantages)),
        value_loss=0.5 * jnp.mean((outputs.value - batch.returns) ** 2),
        entropy=jnp.mean(distributions.entropy(outputs.log_std)),
        approximate_kl=jnp.mean(ratio - 1.0 - log_ratio),
        clip_fraction=jnp.mean((jnp.abs(ratio - 1.0) > epsilon).astype(jnp.float32)),
    )
    loss = (
        terms.policy_loss
        + hyperparameters.value_coefficient * terms.value_loss
        - hyperparameters.entropy_coefficient * terms.entropy
    )
    return loss, terms


def explained_variance(values: Array, returns: Array) -> Array:
    """Share of the returns' variance that values account for, `[]`: 1 is perfect, 0 no better than a constant."""
    variance = jnp.var(returns)
    return 1.0 - jnp.var(returns - values) / jnp.where(variance > 0.0, variance, 1.0)
