"""A run's settings in a file: `config.json`, which another run can begin with."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import ppo
from experiments._presets import Preset
from experiments._training_options import LearningOptions, TrainOptions
from scenarios.command_line import UserError, option_words, spelled
from scenarios.files import written_whole

MACHINE = "config", "resume", "out", "devices", "distributed", "coordinator", "processes", "process"
"""Options that have nothing to do with what is learned."""
PLAIN = "total_steps", "sampling", "generate", "validate_every", "kinds", "conflicts"
"""Fields of a preset that JSON can hold as they are."""


def config_document(options: TrainOptions, preset: Preset) -> dict[str, Any]:
    """What is learned and how, as JSON can hold it: the options, and the settings that they make of a preset."""
    plain = {name: value for name, value in asdict(options).items() if name not in (*MACHINE, "total_steps")}
    return {"options": json.loads(json.dumps(plain, default=str)), "preset": _preset_as_plain(preset)}


def settle_config(folder: Path, options: TrainOptions, preset: Preset) -> None:
    """Write the options, or make sure that a run that is resumed had the same ones."""
    document = config_document(options, preset)
    file = folder / "config.json"
    if options.resume and file.is_file():
        earlier = json.loads(file.read_text())["options"]
        unchanged = config_document(TrainOptions(), preset)["options"]
        for name, value in document["options"].items():
            if (had := earlier.get(name, unchanged[name])) != value:
                raise UserError(f"{file}: the run had --{name.replace('_', '-')} {had}; resume with the same options")
    elif not options.resume and ppo.Checkpoints(folder / "checkpoints").steps():
        raise UserError(f"{folder}: holds another run; go on with --resume, or name another folder with --out")
    with written_whole(file) as handle:
        handle.write(json.dumps(document, indent=1).encode() + b"\n")


def _preset_as_plain(preset: Preset) -> dict[str, Any]:
    return {
        "ppo": asdict(preset.ppo),
        "hyperparameters": vars(preset.hyperparameters),
        "rewards": vars(preset.rewards),
        "adjustments": [asdict(one) for one in preset.adjustments],
        **{name: getattr(preset, name) for name in PLAIN},
    }


def command_line(options: TrainOptions) -> str:
    """The command that trains so, wherever it writes and on whatever devices."""
    return spelled(options, "experiments.train", MACHINE)


def with_config(options_type: type[LearningOptions], arguments: Sequence[str]) -> list[str]:
    """The command line with the options of the file that its `--config` names before its own ones.

    Raises:
      UserError: the file cannot be read, or has other options than `train`.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config", nargs="?")
    named = parser.parse_known_args(arguments)[0].config
    if named is None:
        return list(arguments)
    known, taken = {field.name for field in fields(TrainOptions)}, {field.name for field in fields(options_type)}
    words: list[str] = []
    for name, value in _read_options(Path(named)).items():
        if name not in known - set(MACHINE):
            raise UserError(f"--config {named}: training has no option {name!r}; name the config.json of a run")
        if name in taken and value is not None:
            words += option_words(name, value)
    return words + list(arguments)


def _read_options(file: Path) -> dict[str, Any]:
    """The options in a file, and how many steps they led to."""
    expected = "name the config.json of a run, or the best.json of a sweep"
    try:
        document = json.loads(file.read_text())
        return document["options"] | {"total_steps": document["preset"]["total_steps"]}
    except OSError as error:
        raise UserError(f"--config {file}: {error.strerror}; {expected}") from None
    except (ValueError, KeyError, TypeError):
        raise UserError(f"--config {file}: holds no settings of a run; {expected}") from None
