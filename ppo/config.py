"""Settings: what shapes the compiled program, and what it can be run with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from ppo._pytree import pytree_dataclass


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the networks; policy and value have one of their own each, with the same sizes.

    Raises:
      ValueError: if a size is not a positive integer.
    """

    lstm_size: int = 256
    """Hidden values of the LSTM."""
    encoder: tuple[int, ...] = (64,)
    """Sizes of the dense layers before the LSTM."""
    head: tuple[int, ...] = (64,)
    """Sizes of the dense layers after it, without the last one."""
    memory: bool = True
    """False puts a dense layer in the LSTM's place: the control experiment that remembers nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "encoder", tuple(self.encoder))
        object.__setattr__(self, "head", tuple(self.head))
        _check_counts(self, ("lstm_size",))
        for name in ("encoder", "head"):
            for size in getattr(self, name):
                _check_count(f"NetworkConfig.{name}", size)


@dataclass(frozen=True)
class PPOConfig:
    """Settings that are constant in the compiled program.

    Raises:
      ValueError: if a count is not a positive integer, or if the environments cannot be divided into minibatches.
    """

    environments: int = 16
    """Environments that run side by side."""
    rollout_steps: int = 147
    """Steps of every environment between two updates."""
    epochs: int = 5
    """How often an update goes through what was collected."""
    minibatches: int = 4
    """Parts of an epoch; each has the whole sequences of some environments."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    normalize_observations: bool = True
    """Shift and scale observations by their running mean and standard deviation."""
    scale_rewards: bool = True
    """Divide rewards by the running standard deviation of the discounted return."""
    observation_clip: float = 10.0
    """Bound of normalised observations."""
    observation_floor: float = 1e-4
    """Standard deviations count as at least about this: what hardly varies in training is not blown up elsewhere."""

    def __post_init__(self) -> None:
        _check_counts(self, ("environments", "rollout_steps", "epochs", "minibatches"))
        if self.environments % self.minibatches:
            raise ValueError(
                f"PPOConfig.environments {self.environments} cannot be divided into minibatches "
                f"{self.minibatches}; give a multiple"
            )
        if not self.observation_clip > 0.0:
            raise ValueError(f"PPOConfig.observation_clip {self.observation_clip}: give a positive number")
        if not self.observation_floor > 0.0:
            raise ValueError(f"PPOConfig.observation_floor {self.observation_floor}: give a positive number")


@pytree_dataclass
class Hyperparameters:
    """Numbers that the compiled program takes as arguments: none of them makes it compile again.

    With arrays in some or all fields, `jax.vmap` trains with several settings at once.

    Raises:
      ValueError: if a Python number is outside its range.
    """

    learning_rate: Any = 3e-4
    final_learning_rate: Any = 0.0
    """After `decay_updates`."""
    decay_updates: Any = 0.0
    """Updates over which the learning rate goes linearly to its final value; 0 leaves it constant."""
    discount: Any = 0.99
    """γ."""
    gae_lambda: Any = 0.97
    """λ of the generalized advantage estimation."""
    clip_epsilon: Any = 0.1
    """Bound of what a change of an action's probability can gain."""
    entropy_coefficient: Any = 0.01
    value_coefficient: Any = 0.5
    max_gradient_norm: Any = 0.5
    """Gradients that are longer are shortened to it."""
    initial_std: Any = 0.3
    """Standard deviation of actions before training."""
    noise_correlation: Any = 0.0
    """Correlation of the noise of one action with that of the one before, within an episode. 0 draws every action by
    itself; near 1 the actions stray one way for about 1 / (1 - correlation) steps, so that what many small steps in the
    same direction lead to is found. The noise of a single action has the same distribution either way, which is what
    the loss sees (Hollenstein et al. 2024, coloured noise in PPO)."""

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):  # pyright: ignore[reportArgumentType]
            value = getattr(self, name)
            if isinstance(value, int | float):
                _check_range(name, float(value))
                object.__setattr__(self, name, float(value))


_POSITIVE = "learning_rate", "clip_epsilon", "max_gradient_norm", "initial_std"
_SHARES = "discount", "gae_lambda", "noise_correlation"


def _check_range(name: str, value: float) -> None:
    if name in _SHARES:
        valid, expected = 0.0 <= value <= 1.0, "a number between 0 and 1"
    elif name in _POSITIVE:
        valid, expected = value > 0.0, "a positive number"
    else:
        valid, expected = value >= 0.0, "a number of at least 0"
    if not (valid and math.isfinite(value)):
        raise ValueError(f"Hyperparameters.{name} {value:g}: give {expected}")


def _check_counts(config: Any, names: tuple[str, ...]) -> None:
    for name in names:
        _check_count(f"{type(config).__name__}.{name}", getattr(config, name))


def _check_count(name: str, value: Any) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ValueError(f"{name} {value!r}: give a positive integer")
