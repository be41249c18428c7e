"""Settings of whole training runs, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jaxfrenet.config import Sampling
from ppo import Hyperparameters, NetworkConfig, PPOConfig

PresetName = Literal["paper", "cpu", "gpu", "quick"]
FLOOR = 0.1
"""Observations have scales of their own already. Fields that hardly vary in training, such as means over the bundle,
shift with the number of trajectories and the family of scenarios; without a floor that would be blown up."""


@dataclass(frozen=True)
class Preset:
    """What a training run consists of, as far as the command line does not say otherwise."""

    ppo: PPOConfig
    hyperparameters: Hyperparameters
    total_steps: int
    """Environment steps."""
    sampling: Sampling
    """How many trajectories a planning cycle samples."""
    generate: int
    """Scenarios that are generated of every kind, if no files are named."""
    validate_every: int
    """Updates between validations."""


PRESETS: dict[PresetName, Preset] = {
    "paper": Preset(
        ppo=PPOConfig(
            environments=16,
            rollout_steps=147,
            epochs=5,
            minibatches=1,
            observation_floor=FLOOR,
            network=NetworkConfig(lstm_size=256),
        ),
        hyperparameters=Hyperparameters(),
        total_steps=7_000_000,
        sampling="full",
        generate=1000,
        validate_every=50,
    ),
    "cpu": Preset(
        ppo=PPOConfig(
            environments=64,
            rollout_steps=74,
            epochs=5,
            minibatches=8,
            observation_floor=FLOOR,
            network=NetworkConfig(lstm_size=128),
        ),
        hyperparameters=Hyperparameters(),
        total_steps=1_000_000,
        sampling="fast",
        generate=500,
        validate_every=20,
    ),
    "gpu": Preset(
        ppo=PPOConfig(
            environments=2048,
            rollout_steps=74,
            epochs=5,
            minibatches=16,
            observation_floor=FLOOR,
            network=NetworkConfig(),
        ),
        hyperparameters=Hyperparameters(),
        total_steps=50_000_000,
        sampling="full",
        generate=2000,
        validate_every=10,
    ),
    "quick": Preset(
        ppo=PPOConfig(
            environments=16,
            rollout_steps=74,
            epochs=5,
            minibatches=4,
            observation_floor=FLOOR,
            network=NetworkConfig(lstm_size=64),
        ),
        hyperparameters=Hyperparameters(),
        total_steps=100_000,
        sampling="fast",
        generate=100,
        validate_every=15,
    ),
}
"""`paper` has the paper's table; `cpu` is for two to four cores and an hour; `gpu` for one large GPU; `quick` takes a
few minutes and shows that learning works."""
