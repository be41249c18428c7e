"""What `train` is told: its options, and the settings that they make of a preset."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

import ppo
from experiments._presets import PRESETS, Preset, PresetName
from jaxfrenet.config import Sampling
from scenarios.command_line import UserError, spelled
from scenarios.files import written_whole

MINIMA = {"total_steps": 1, "validate_every": 1, "generate": 0, "seeds": 1, "devices": 1, "processes": 1}
"""Lowest values of options."""
MACHINE = "resume", "out", "devices", "distributed", "coordinator", "processes", "process"
"""Options that have nothing to do with what is learned."""


@dataclass(frozen=True)
class TrainOptions:
    """Train the hybrid planner: policy/ (the best on validation), metrics.jsonl, TensorBoard events, checkpoints/."""

    preset: PresetName = "cpu"
    """Settings of everything else: `quick` takes a few minutes, `cpu` an hour, `gpu` is for one large GPU, `paper` has
    the paper's own numbers."""
    total_steps: int | None = None
    """Environment steps, if not as many as the preset has."""
    validate_every: int | None = None
    """Updates between validations, if not as many as the preset has; a checkpoint is written with each."""
    scenarios: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """CommonRoad files, folders or archives of them, or .npz sets, to train on; none are generated then, unless
    --generate asks for it."""
    generate: int | None = None
    """How many scenarios to generate of every kind, if not as many as the preset has."""
    kinds: tuple[str, ...] = ("tjunction:commonroad", "tjunction:hard")
    """Kinds to generate, each FAMILY or FAMILY:PRESET."""
    generator_seed: int = 0
    """Seed of the generated scenarios."""
    validation: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """Files to validate on; if none are named, 15 % of the files, and further generated scenarios."""
    hard_share: float = 0.5
    """Share of episodes in scenarios that are hard for the default planner (end badly, or have any risk), of every
    source of scenarios."""
    predictor: Literal["neural", "constant_velocity", "ground_truth"] = "neural"
    """How the planner predicts the traffic."""
    sampling: Sampling | None = None
    """How many trajectories a planning cycle samples, if not as the preset has it: `fast`, `full` or `dense`."""
    rewards: tuple[str, ...] = ()
    """Factors of the reward as NAME=VALUE, in place of the published ones; a wrong name lists all."""
    relative: bool = True
    """Reward what is gained over the default planner in the same scenario: the same optimum, learned with less noise.
    Validation tells plain returns."""
    hyperparameters: tuple[str, ...] = ()
    """PPO's hyperparameters as NAME=VALUE, in place of the preset's; a wrong name lists all."""
    seeds: int = 1
    """How many runs to train side by side, which differ in their random numbers."""
    seed: int = 0
    """Seed of everything random in training."""
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


def settings(options: TrainOptions) -> Preset:
    """The preset with what the command line changes.

    Raises:
      UserError: a number makes no sense.
    """
    preset = PRESETS[options.preset]
    for name, least in MINIMA.items():
        value = getattr(options, name)
        if value is not None and value < least:
            raise UserError(f"--{name.replace('_', '-')} {value}: give at least {least}")
    if not 0.0 <= options.hard_share < 1.0:
        raise UserError(f"--hard-share {options.hard_share}: give a number from 0 to below 1")
    generate = (0 if options.scenarios else preset.generate) if options.generate is None else options.generate
    if not generate and not options.scenarios:
        raise UserError("--generate 0 leaves nothing to train on; name files with --scenarios")
    try:
        changed = named_numbers("--hyperparameters", options.hyperparameters, preset.hyperparameters)
        hyperparameters = replace(preset.hyperparameters, **changed)
    except ValueError as error:
        raise UserError(f"--hyperparameters: {str(error).removeprefix('Hyperparameters.')}") from None
    return replace(
        preset,
        hyperparameters=hyperparameters,
        total_steps=options.total_steps or preset.total_steps,
        sampling=options.sampling or preset.sampling,
        generate=generate,
        validate_every=options.validate_every or preset.validate_every,
    )


def named_numbers(flag: str, words: tuple[str, ...], known: Any) -> dict[str, float]:
    """Numbers by name from `NAME=VALUE` words; `known` is a dataclass whose fields are the names."""
    names, found = [field.name for field in fields(known)], {}
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


def settle_config(folder: Path, options: TrainOptions, preset: Preset) -> None:
    """Write the options, or make sure that a run that is resumed had the same ones."""
    plain = {name: value for name, value in asdict(options).items() if name not in (*MACHINE, "total_steps")}
    document = {"options": json.loads(json.dumps(plain, default=str)), "preset": _preset_as_plain(preset)}
    file = folder / "config.json"
    if options.resume and file.is_file():
        earlier = json.loads(file.read_text())
        for name, value in document["options"].items():
            if (had := earlier["options"].get(name)) != value:
                raise UserError(f"{file}: the run had --{name.replace('_', '-')} {had}; resume with the same options")
    elif not options.resume and ppo.Checkpoints(folder / "checkpoints").steps():
        raise UserError(f"{folder}: holds another run; go on with --resume, or name another folder with --out")
    with written_whole(file) as handle:
        handle.write(json.dumps(document, indent=1).encode() + b"\n")


def _preset_as_plain(preset: Preset) -> dict[str, Any]:
    return {
        "ppo": asdict(preset.ppo),
        "hyperparameters": vars(preset.hyperparameters),
        **{name: getattr(preset, name) for name in ("total_steps", "sampling", "generate", "validate_every")},
    }


def command_line(options: TrainOptions) -> str:
    """The command that trains so, wherever it writes and on whatever devices."""
    return spelled(options, "experiments.train", MACHINE)
