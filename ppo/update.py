"""The update: several epochs of gradient descent on what was collected."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from ppo import networks
from ppo.config import Hyperparameters, PPOConfig
from ppo.loss import Batch, LossTerms, ppo_loss
from ppo.networks import Carry, Parameters
from ppo.sharding import constrain

ADAM_EPSILON = 1e-5
"""As in most implementations of the algorithm."""


class Sequences(NamedTuple):
    """Whole sequences to learn from."""

    carry: Carry
    """`[environments, ...]`, what the networks remembered before them."""
    observations: Array
    """`[time, environments, observation_size]`, normalised."""
    resets: Array
    """`[time, environments]` bool."""
    batch: Batch
    """`[time, environments, ...]`."""


class UpdateReport(NamedTuple):
    """How an update went, `[]` each."""

    terms: LossTerms
    """Means over all minibatches."""
    loss: Array
    """Mean over all minibatches."""
    gradient_norm: Array
    """Mean over all minibatches, before clipping."""


def optimizer(learning_rate: Array | float, max_gradient_norm: Array | float) -> optax.GradientTransformation:
    """Adam on gradients whose norm is bounded; its state does not depend on the arguments.

    It works on all parameters in one vector, which takes a fraction of the time to compile.
    """
    return optax.chain(
        optax.clip_by_global_norm(max_gradient_norm),  # pyright: ignore[reportArgumentType]
        optax.scale_by_adam(eps=ADAM_EPSILON),
        optax.scale_by_learning_rate(learning_rate),
    )


def initial_optimizer(parameters: Parameters) -> Any:
    """State of `optimizer` before training."""
    with jax.numpy_dtype_promotion("standard"):
        return optimizer(0.0, 1.0).init(ravel_pytree(parameters)[0])


def learning_rate(hyperparameters: Hyperparameters, update: Array) -> Array:
    """The learning rate of update number `update`, from 0 on, `[]`."""
    first, last, over = (
        jnp.asarray(value, jnp.float32)
        for value in (
            hyperparameters.learning_rate,
            hyperparameters.final_learning_rate,
            hyperparameters.decay_updates,
        )
    )
    progress = jnp.minimum(update.astype(jnp.float32) / jnp.where(over > 0.0, over, 1.0), 1.0)
    return jnp.where(over > 0.0, first + (last - first) * progress, first)


def update(
    config: PPOConfig,
    parameters: Parameters,
    optimizer_state: Any,
    sequences: Sequences,
    hyperparameters: Hyperparameters,
    rate: Array,
    key: Array,
    mesh: jax.sharding.Mesh | None = None,
) -> tuple[Parameters, Any, UpdateReport]:
    """Go through the sequences `config.epochs` times, in minibatches of whole sequences.

    Args:
      config: static settings.
      parameters: of the networks.
      optimizer_state: of `optimizer`.
      sequences: to learn from.
      hyperparameters: of the loss and the bound of gradients.
      rate: learning rate.
      key: shuffles the sequences anew in every epoch.
      mesh: devices that share the sequences.

    Returns:
      Parameters, state of the optimizer, and how it went.
    """
    flat, unravel = ravel_pytree(parameters)

    def step(carry: tuple[Array, Any], chosen: Array) -> tuple[tuple[Array, Any], UpdateReport]:
        flat, optimizer_state = carry
        part = _minibatch(sequences, chosen, mesh)
        (loss, terms), gradient = jax.value_and_grad(_loss, argnums=1, has_aux=True)(
            config, unravel(flat), part, hyperparameters
        )
        gradient = constrain(ravel_pytree(gradient)[0], mesh, None)
        with jax.numpy_dtype_promotion("standard"):  # optax multiplies floats by step counts
            optimize: Any = optimizer(rate, hyperparameters.max_gradient_norm).update
            change, optimizer_state = optimize(gradient, optimizer_state)
        return (flat + change, optimizer_state), UpdateReport(terms, loss, jnp.sqrt(jnp.sum(gradient**2)))

    order = jnp.argsort(jax.random.uniform(key, (config.epochs, config.environments)), axis=1)
    chosen = order.reshape(config.epochs * config.minibatches, config.environments // config.minibatches)
    (flat, optimizer_state), reports = jax.lax.scan(step, (flat, optimizer_state), chosen)
    return unravel(flat), optimizer_state, jax.tree.map(jnp.mean, reports)


def _minibatch(sequences: Sequences, chosen: Array, mesh: jax.sharding.Mesh | None) -> Sequences:
    carry = jax.tree.map(lambda leaf: leaf[chosen], sequences.carry)
    rest = jax.tree.map(lambda leaf: leaf[:, chosen], sequences._replace(carry=None))
    return constrain(rest, mesh, 1)._replace(carry=constrain(carry, mesh, 0))


def _loss(
    config: PPOConfig, parameters: Parameters, sequences: Sequences, hyperparameters: Hyperparameters
) -> tuple[Array, LossTerms]:
    _, outputs = networks.apply(config.network, parameters, sequences.carry, sequences.observations, sequences.resets)
    return ppo_loss(outputs, sequences.batch, hyperparameters)
