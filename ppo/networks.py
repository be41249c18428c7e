"""The networks: an encoder, an LSTM and a head for the policy, the same for the value, and nothing shared."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax.linen.initializers import lecun_normal, orthogonal, variance_scaling, zeros_init
from jax import Array

from ppo.config import NetworkConfig
from ppo.lstm import Memory, lstm

Parameters = Any
"""A pytree of arrays."""

Carry = Memory | None
"""What the networks remember: `[batch, 2, lstm_size]` each, the policy's first; None without a memory."""

POLICY_SCALE = 0.01
"""Scale of the last weights of the policy: at first all means are nearly zero."""


class PolicyOutput(NamedTuple):
    """What the networks say about observations."""

    mean: Array
    """`[..., action_size]`, of the actions."""
    log_std: Array
    """`[action_size]`, logarithm of their standard deviation, the same everywhere."""
    value: Array
    """`[...]`, of the states, in units of scaled rewards."""


def init(
    config: NetworkConfig, key: Array, observation_size: int, action_size: int, initial_std: Array | float
) -> Parameters:
    """Parameters before training.

    Args:
      config: static settings.
      key: a typed random key.
      observation_size: elements of an observation.
      action_size: elements of an action.
      initial_std: standard deviation of every element of an action.

    Returns:
      `body`, all layers but the last, with policy and value along a new first axis of each array; `mean` and `value`,
      the last layers; `log_std`, `[action_size]`.
    """
    body_key, mean_key, value_key = jax.random.split(key, 3)
    observation, reset = jnp.zeros((1, 1, observation_size)), jnp.zeros((1, 1), bool)
    memory = jax.tree.map(lambda leaf: leaf[:, 0], initial_carry(config, (1,)))

    def body(key: Array) -> Parameters:
        return _Body(config).init(key, memory, observation, reset)["params"]

    features = jnp.zeros(_feature_size(config))
    return {
        "body": jax.vmap(body)(jax.random.split(body_key, 2)),
        "mean": _last_layer(action_size, POLICY_SCALE).init(mean_key, features)["params"],
        "value": _last_layer(1, 1.0).init(value_key, features)["params"],
        "log_std": jnp.full((action_size,), jnp.log(initial_std), jnp.float32),
    }


def initial_carry(config: NetworkConfig, batch_shape: tuple[int, ...]) -> Carry:
    """What the networks remember before an episode: zeros, `[*batch_shape, 2, lstm_size]` for policy and value."""
    if not config.memory:
        return None
    zeros = jnp.zeros((*batch_shape, 2, config.lstm_size))
    return Memory(zeros, zeros)


def apply(
    config: NetworkConfig, parameters: Parameters, carry: Carry, observation: Array, reset: Array
) -> tuple[Carry, PolicyOutput]:
    """Run the networks over a sequence.

    Args:
      config: static settings.
      parameters: of the networks.
      carry: what they remember of the time before.
      observation: `[time, batch, observation_size]`, normalised.
      reset: `[time, batch]` bool, whether an episode begins: what is remembered is forgotten before the observation.

    Returns:
      What they remember after it, and what they say, `[time, batch, ...]`.
    """
    run: Any = _Body(config).apply

    def body(parameters: Parameters, memory: Carry) -> tuple[Carry, Array]:
        return run({"params": parameters}, memory, observation, reset)

    carry, features = jax.vmap(body, in_axes=(0, 1), out_axes=(1, 0))(parameters["body"], carry)
    log_std = parameters["log_std"]
    mean: Any = _last_layer(log_std.size, POLICY_SCALE).apply({"params": parameters["mean"]}, features[0])
    value: Any = _last_layer(1, 1.0).apply({"params": parameters["value"]}, features[1])
    return carry, PolicyOutput(mean, log_std, value[..., 0])


def apply_one(
    config: NetworkConfig, parameters: Parameters, carry: Carry, observation: Array, reset: Array
) -> tuple[Carry, PolicyOutput]:
    """`apply` for one time step: `observation` is `[batch, observation_size]`, `reset` is `[batch]`."""
    carry, output = apply(config, parameters, carry, observation[None], reset[None])
    return carry, PolicyOutput(output.mean[0], output.log_std, output.value[0])


class _Body(nn.Module):
    """Dense layers, a memory, dense layers: all of one network but its last layer."""

    config: NetworkConfig

    @nn.compact
    def __call__(self, memory: Carry, observation: Array, reset: Array) -> tuple[Carry, Array]:
        config, features = self.config, observation
        for index, size in enumerate(config.encoder):
            features = _tanh_layer(size, f"encoder_{index}")(features)
        if memory is not None:
            memory, features = _LSTM(config.lstm_size, name="lstm")(memory, features, reset)
        else:
            features = _tanh_layer(config.lstm_size, "dense")(features)
        for index, size in enumerate(config.head):
            features = _tanh_layer(size, f"head_{index}")(features)
        return memory, features


class _LSTM(nn.Module):
    """The parameters of `ppo.lstm`."""

    size: int

    @nn.compact
    def __call__(self, memory: Memory, features: Array, reset: Array) -> tuple[Memory, Array]:
        project = self.param("input_kernel", lecun_normal(), (features.shape[-1], 4 * self.size))
        kernel = self.param("recurrent_kernel", _recurrent_kernel, (self.size, 4 * self.size))
        bias = self.param("bias", zeros_init(), (4 * self.size,))
        return lstm(kernel, features @ project + bias, reset, memory)


def _tanh_layer(size: int, name: str) -> Callable[[Array], Array]:
    layer = nn.Dense(size, kernel_init=lecun_normal(), name=name)
    return lambda features: jnp.tanh(layer(features))


def _last_layer(size: int, scale: float) -> nn.Module:
    return nn.Dense(size, kernel_init=variance_scaling(scale**2, "fan_in", "normal"))


def _feature_size(config: NetworkConfig) -> int:
    return config.head[-1] if config.head else config.lstm_size


def _recurrent_kernel(key: Array, shape: tuple[int, int]) -> Array:
    """An orthogonal matrix for every gate."""
    gates = jax.vmap(lambda key: orthogonal()(key, (shape[0], shape[0])))(jax.random.split(key, 4))
    return gates.transpose(1, 0, 2).reshape(shape)
