"""Settings of whole training runs, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from jaxfrenet.config import Sampling
from jaxfrenet.environment import PAPER_ADJUSTMENTS, Adjustment, RewardFactors
from ppo import Hyperparameters, NetworkConfig, PPOConfig

PresetName = Literal["paper", "cpu", "cpu-paper", "gpu", "quick"]
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
    rewards: RewardFactors = RewardFactors()
    """Factors of the reward."""
    adjustments: tuple[Adjustment, ...] = PAPER_ADJUSTMENTS
    """What an action changes."""
    kinds: tuple[str, ...] = ("tjunction:commonroad", "tjunction:hard")
    """Kinds of scenarios to generate, see `training_sets`."""
    conflicts: bool = False
    """Whether those that are generated are left out where the traffic is never in the way."""


REWARDS = RewardFactors(
    goal_reached_in_time=100.0,
    goal_reached_faster=50.0,
    goal_reached_late=30.0,
    collision=-200.0,
    infeasible=-200.0,
    timeout=-200.0,
    past_goal=-200.0,
    speed=-1.5,
    ego_risk=-300.0,
    third_party_risk=-300.0,
    risk_magnitude=-3.0,
    weights=-0.002,
    prediction_weight=0.0,
)
"""What a million steps can learn from: two terms that every step feels, the speed that is lost and the order of
magnitude of the risk, count more than ends, which are rare and mostly luck. With the published factors a risk of 1e-5
counts a thousandth of the rest."""
FAR_SIGHTED = Hyperparameters(
    final_learning_rate=3e-5,
    decay_updates=200,
    discount=0.995,
    gae_lambda=0.98,
    initial_std=0.2,
    entropy_coefficient=0.001,
    noise_correlation=0.5,
)
"""A weight that changes now tells a second or two later, and matters when it stays away for as long."""
AROUND_OWN_WEIGHTS = (
    Adjustment("prediction", scale=2.0, low=0.0, high=400.0, default=200.0),
    Adjustment("lateral_jerk", scale=0.02, low=0.001, high=2.0, default=1.0),
    Adjustment("longitudinal_jerk", scale=0.04, low=0.01, high=0.4, default=0.07),
    Adjustment("distance_to_reference_path", scale=0.02, low=0.001, high=2.0, default=1.0),
    Adjustment("velocity_offset", scale=0.05, low=0.05, high=0.8, default=0.3),
    Adjustment("acceleration_range", scale=0.1, low=1.0, high=3.0, default=2.0),
    Adjustment("braking_range", scale=0.1, low=0.2, high=1.0, default=0.5),
    Adjustment("lateral_range", scale=0.05, low=0.2, high=0.7, default=0.4),
)
"""Cost weights and sampling ranges around constants that lose less time than the default planner. In sparse traffic the
whole `braking_range` has least risk, in dense traffic little of it has fewest time-outs."""

_CPU = Preset(
    ppo=PPOConfig(
        environments=64,
        rollout_steps=74,
        epochs=5,
        minibatches=8,
        observation_floor=FLOOR,
        network=NetworkConfig(lstm_size=128),
    ),
    hyperparameters=FAR_SIGHTED,
    total_steps=1_000_000,
    sampling="full",
    generate=500,
    validate_every=20,
    rewards=REWARDS,
    adjustments=AROUND_OWN_WEIGHTS,
    conflicts=True,
)
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
    "cpu": _CPU,
    "cpu-paper": replace(_CPU, sampling="fast", adjustments=PAPER_ADJUSTMENTS),
    "gpu": replace(
        _CPU,
        ppo=PPOConfig(
            environments=2048,
            rollout_steps=74,
            epochs=5,
            minibatches=16,
            observation_floor=FLOOR,
            network=NetworkConfig(),
        ),
        hyperparameters=replace(FAR_SIGHTED, decay_updates=300),
        total_steps=50_000_000,
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
"""`paper` has the paper's table; `cpu` is for two to four cores and an hour; `cpu-paper` is the same with the paper's
actions, which start at the default planner's weights; `gpu` is for one large GPU; `quick` takes a few minutes."""
