"""What `train` and `sweep` are told: their options, and the settings that they make of a preset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

import jaxfrenet as jf
import ppo
from experiments._presets import PRESETS, Preset, PresetName
from jaxfrenet.config import Sampling
from jaxfrenet.environment import (
    PAPER_ADJUSTMENTS,
    REWARD_TERMS,
    SAMPLING_ADJUSTMENTS,
    Adjustment,
    EnvironmentConfig,
    RewardFactors,
)
from scenarios.command_line import UserError

MINIMA = {"total_steps": 1, "validate_every": 1, "generate": 0, "seeds": 1, "devices": 1, "processes": 1}
"""Lowest values of options."""
SIZES = "environments", "rollout_steps", "epochs", "minibatches", "lstm_size"
"""What `--sizes` can change."""
HYPERPARAMETERS = tuple(field.name for field in fields(ppo.Hyperparameters))  # pyright: ignore[reportArgumentType]
"""What `--hyperparameters` can change."""
ACTION_SPACES = {"paper": PAPER_ADJUSTMENTS, "sampling": SAMPLING_ADJUSTMENTS}
"""What `--action-space` names."""
ADJUSTABLE = tuple(f"{one.term}.{part}" for one in SAMPLING_ADJUSTMENTS for part in ("scale", "low", "high", "default"))
"""What `--actions` can change."""


@dataclass(frozen=True)
class LearningOptions:
    """What is learned, from what, and how."""

    config: Path | None = None
    """Begin with the options in this file, the config.json of another run or the best.json of a sweep; what else is on
    the command line overrides them."""
    preset: PresetName = "cpu"
    """Settings of everything else: `quick` takes a few minutes; `cpu` takes about an hour and adjusts also how far the
    sampling reaches; `cpu-paper` adjusts the paper's five weights only; `gpu` is for one large GPU; `paper` has the
    paper's own numbers."""
    total_steps: int | None = None
    """Environment steps, if not as many as the preset has."""
    validate_every: int | None = None
    """Updates between validations, if not as many as the preset has; a checkpoint is written with each."""
    scenarios: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """CommonRoad files, folders or archives of them, or .npz sets, to train on; none are generated then, unless
    --generate asks for it."""
    generate: int | None = None
    """How many scenarios to generate of every kind, if not as many as the preset has."""
    kinds: tuple[str, ...] = ()
    """Kinds to generate, if not those of the preset, each FAMILY or FAMILY:PRESET; append =NUMBER for another number
    than --generate."""
    generator_seed: int = 0
    """Seed of the generated scenarios."""
    validation: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """Files to validate on; if none are named, 15 % of the files, and further generated scenarios."""
    keep: Literal["all", "conflicts"] | None = None
    """Which generated scenarios to train and to validate on, if not as the preset has it: `all`, or `conflicts`, those
    in which the traffic is in the way. In the others, which are most, even a planner that disregards it comes near
    nobody, and there is little to learn."""
    predictor: Literal["neural", "constant_velocity", "ground_truth"] = "neural"
    """How the planner predicts the traffic."""
    sampling: Sampling | None = None
    """How many trajectories a planning cycle samples, if not as the preset has it: `fast`, `full` or `dense`."""
    rewards: tuple[str, ...] = ()
    """Factors of the reward as NAME=VALUE, in place of the preset's; a wrong name lists all."""
    hyperparameters: tuple[str, ...] = ()
    """PPO's hyperparameters as NAME=VALUE, in place of the preset's; a wrong name lists all."""
    sizes: tuple[str, ...] = ()
    """PPO's sizes as NAME=NUMBER, in place of the preset's: environments, rollout_steps, epochs, minibatches,
    lstm_size."""
    action_space: Literal["paper", "sampling"] | None = None
    """What an action changes, if not as the preset has it: `paper`, five cost weights; `sampling`, also how far the
    sampled end speeds and offsets reach, as the paper's outlook proposes."""
    actions: tuple[str, ...] = ()
    """What an action may change, as TERM.PART=VALUE in place of the preset's numbers, for example
    velocity_offset.scale=0.05; parts are scale (the change per step), low, high and default."""
    seed: int = 0
    """Seed of everything random in training."""


@dataclass(frozen=True)
class TrainOptions(LearningOptions):
    """Train the hybrid planner: policy/ (the best on validation), metrics.jsonl, TensorBoard events, checkpoints/."""

    relative: bool = True
    """Reward what is gained over the default weights in the same scenario: the same optimum, learned with less noise.
    Validation tells plain returns."""
    keep_policies: bool = False
    """Keep the policy of every validation in policies/STEP, to compare them or to average them with
    experiments.average."""
    seeds: int = 1
    """How many runs to train side by side, which differ in their random numbers."""
    devices: int | None = None
    """Devices that share the environments; all that there are if not given."""
    distributed: bool = False
    """Train with several processes, one on each machine: start the same command on all of them."""
    coordinator: str | None = None
    """ADDRESS:PORT of the first process, where the cluster does not tell."""
    processes: int | None = None
    """Number of processes, where the cluster does not tell; also --process."""
    process: int | None = None
    """Number of this process, from 0."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    out: Path = Path("runs/train")
    """Folder for the results."""


def settings(options: LearningOptions) -> Preset:
    """The preset with what the command line changes.

    Raises:
      UserError: a number makes no sense.
    """
    preset = PRESETS[options.preset]
    for name, least in MINIMA.items():
        value = getattr(options, name, None)
        if value is not None and value < least:
            raise UserError(f"--{name.replace('_', '-')} {value}: give at least {least}")
    generate = (0 if options.scenarios else preset.generate) if options.generate is None else options.generate
    if not generate and not options.scenarios:
        raise UserError("--generate 0 leaves nothing to train on; name files with --scenarios")
    table = preset.adjustments if options.action_space is None else ACTION_SPACES[options.action_space]
    changed = named_numbers("--hyperparameters", options.hyperparameters, HYPERPARAMETERS)
    try:
        hyperparameters = replace(preset.hyperparameters, **changed)
    except ValueError as error:
        raise UserError(f"--hyperparameters: {str(error).removeprefix('Hyperparameters.')}") from None
    return replace(
        preset,
        ppo=_sized(preset.ppo, options.sizes),
        hyperparameters=hyperparameters,
        total_steps=options.total_steps or preset.total_steps,
        sampling=options.sampling or preset.sampling,
        generate=generate,
        validate_every=options.validate_every or preset.validate_every,
        rewards=changed_rewards("--rewards", preset, options.rewards),
        adjustments=_adjusted(table, options.actions),
        kinds=options.kinds or preset.kinds,
        conflicts=preset.conflicts if options.keep is None else options.keep == "conflicts",
    )


def _sized(config: ppo.PPOConfig, words: Sequence[str]) -> ppo.PPOConfig:
    found = named_numbers("--sizes", words, SIZES)
    try:
        sizes = {name: int(value) if value.is_integer() else value for name, value in found.items()}
        network = replace(config.network, lstm_size=sizes.pop("lstm_size", config.network.lstm_size))
        return replace(config, network=network, **sizes)
    except ValueError as error:
        raise UserError(f"--sizes: {str(error).partition('.')[2]}") from None


def changed_rewards(flag: str, preset: Preset, words: Sequence[str]) -> RewardFactors:
    """A preset's factors of the reward with what `NAME=VALUE` words of an option change."""
    return replace(preset.rewards, **named_numbers(flag, words, REWARD_TERMS))


def _adjusted(table: tuple[Adjustment, ...], words: Sequence[str]) -> tuple[Adjustment, ...]:
    """The table with what `TERM.PART=VALUE` words change."""
    found = named_numbers("--actions", words, ADJUSTABLE)
    parts: dict[str, dict[str, float]] = {one.term: {} for one in table}
    for name, value in found.items():
        term, _, part = name.partition(".")
        if term not in parts:
            raise UserError(f"--actions {name}: not in this action space; add --action-space sampling")
        parts[term][part] = value
    try:
        return tuple(replace(one, **parts[one.term]) for one in table)
    except ValueError as error:
        raise UserError(f"--actions: {error}") from None


def environment_config(options: LearningOptions, preset: Preset) -> EnvironmentConfig:
    """The planner and what an action may change; `preset` is what the options make of theirs."""
    planner = jf.PlannerConfig.preset(preset.sampling, predictor=options.predictor)
    return EnvironmentConfig(planner, preset.adjustments)


def named_numbers(flag: str, words: Sequence[str], names: Sequence[str]) -> dict[str, float]:
    """Numbers by name from the `NAME=VALUE` words of an option."""
    found: dict[str, float] = {}
    for word in words:
        name, _, value = word.partition("=")
        if name not in names:
            raise UserError(f"{flag} {word}: there is no {name!r}; there are {', '.join(names)}")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = float("nan")
        if not np.isfinite(found[name]):
            raise UserError(f"{flag} {word}: {value!r} is not a finite number; write for example {name}=0.1")
    return found
