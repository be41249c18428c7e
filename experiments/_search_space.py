"""What a sweep searches: settings of PPO, reward, actions and planner, and the values that they may have."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution

from experiments._training_options import (
    ADJUSTABLE,
    HYPERPARAMETERS,
    SIZES,
    LearningOptions,
    settings,
)
from jaxfrenet.environment import REWARD_TERMS
from scenarios.command_line import UserError

Options = TypeVar("Options", bound=LearningOptions)
DEFAULT = """\
# Ranges and lists: arguments of the compiled program, which trials side by side can have different values of.
[hyperparameters]
learning_rate = {low = 1e-4, high = 1e-3, log = true}
clip_epsilon = {low = 0.05, high = 0.3}
entropy_coefficient = {low = 1e-4, high = 3e-2, log = true}
gae_lambda = {low = 0.9, high = 0.99}

[rewards]
risk_magnitude = {low = -5.0, high = 0.0}
weights = {low = -0.3, high = 0.0}

# Lists only: every combination of these is a program of its own, which is compiled once.
# [ppo]
# lstm_size = [64, 128]
# [actions.velocity_offset]
# scale = [0.05, 0.1]
# [planner]
# sampling = ["fast", "full"]
"""
"""The space that is searched if no file is named."""
NAMES: dict[str, Sequence[str]] = {
    "hyperparameters": HYPERPARAMETERS,
    "rewards": REWARD_TERMS,
    "ppo": SIZES,
    "actions": ADJUSTABLE,
    "planner": ("sampling", "predictor"),
}
"""Sections of the file, and what can be in each."""
OPTIONS = {"hyperparameters": "hyperparameters", "rewards": "rewards", "ppo": "sizes", "actions": "actions"}
"""Options of `train` that are `NAME=VALUE` words, by section."""
TRACED = "hyperparameters", "rewards"
"""Sections whose values are arguments of the compiled program; all others shape it."""
CHOICES = {"sampling": ("fast", "full", "dense"), "predictor": ("neural", "constant_velocity", "ground_truth")}
"""Settings that are words."""
MOST_PROGRAMS = 64
"""Combinations of settings that shape the program."""


@dataclass(frozen=True)
class Space:
    """Settings by name, `SECTION.NAME`, and the values that they may have."""

    distributions: dict[str, BaseDistribution]
    text: str
    """Of the file that tells so."""

    def options(self, base: Options, chosen: Mapping[str, Any]) -> Options:
        """The options of a trial.

        Args:
          base: of all trials.
          chosen: settings by name.
        """
        found: dict[str, Any] = {}
        for key, value in chosen.items():
            section, _, name = key.partition(".")
            if section == "planner":
                found[name] = value
                continue
            option = OPTIONS[section]
            words = dict(word.split("=", 1) for word in found.get(option, getattr(base, option)))
            found[option] = tuple(f"{name}={value}" for name, value in (words | {name: repr(value)}).items())
        return replace(base, **found)


def read_space(file: Path | None, base: LearningOptions) -> Space:
    """Read a space and make sure that trials can have every setting in it; the default one without a file.

    Raises:
      UserError: it cannot be read, or a setting makes no sense.
    """
    source = "--space" if file is None else f"--space {file}"
    try:
        text = DEFAULT if file is None else file.read_text()
        tables = tomllib.loads(text)
    except OSError as error:
        raise UserError(f"{source}: {error.strerror}; without --space the default space is searched") from None
    except ValueError as error:
        raise UserError(f"{source}: is no TOML: {error}") from None
    try:
        space = Space(dict(_distributions(tables)), text)
        _check(space, base)
    except UserError as error:
        raise UserError(f"{source}: {str(error).lstrip('-')}") from None
    return space


def _distributions(tables: Mapping[str, Any]) -> Iterator[tuple[str, BaseDistribution]]:
    for section, table in tables.items():
        if section not in NAMES or not isinstance(table, dict):
            raise UserError(f"there is no section [{section}]; there are {', '.join(NAMES)}")
        for name, value in _entries(section, table):
            if name not in NAMES[section]:
                raise UserError(f"[{section}] has no {name!r}; it has {', '.join(NAMES[section])}")
            yield f"{section}.{name}", _distribution(section, name, value)
    if not any(tables.values()):
        raise UserError("names no settings; add for example learning_rate = [1e-4, 3e-4] below [hyperparameters]")


def _entries(section: str, table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and values of a section; actions have a table for each cost term."""
    for name, value in table.items():
        if section == "actions" and isinstance(value, dict):
            yield from ((f"{name}.{part}", own) for part, own in value.items())
        else:
            yield name, value


def _distribution(section: str, name: str, value: Any) -> BaseDistribution:
    if isinstance(value, dict):
        if section not in TRACED:
            raise UserError(f"{name}: shapes the program; give a list of values in place of a range")
        return _range(name, value)
    choices = value if isinstance(value, list) else [value]
    for one in choices:
        if name in CHOICES and one not in CHOICES[name]:
            raise UserError(f"{name}: {one!r} is none of {', '.join(CHOICES[name])}")
        if name not in CHOICES and not _is_number(one):
            raise UserError(f"{name}: {one!r} is not a finite number")
    if not choices or len(set(choices)) < len(choices):
        raise UserError(f"{name}: give at least one value, and each once")
    return CategoricalDistribution(choices)


def _range(name: str, value: Mapping[str, Any]) -> FloatDistribution:
    example = "write for example {low = 1e-4, high = 1e-3, log = true}"
    if not {"low", "high"} <= value.keys() <= {"low", "high", "log"}:
        raise UserError(f"{name}: a range has low, high and perhaps log; {example}")
    low, high, is_log = value["low"], value["high"], value.get("log", False)
    if not (_is_number(low) and _is_number(high) and isinstance(is_log, bool)):
        raise UserError(f"{name}: low and high are finite numbers, log is true or false; {example}")
    if low >= high:
        raise UserError(f"{name}: low {low} is not below high {high}")
    if is_log and low <= 0:
        raise UserError(f"{name}: low {low} has no logarithm; give a positive number, or leave log out")
    return FloatDistribution(low, high, log=is_log)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _check(space: Space, base: LearningOptions) -> None:
    """Make sure that all combinations of what shapes the program, and both ends of every range, can be trained with."""
    ends = {key: _ends(distribution) for key, distribution in space.distributions.items()}
    shaping = {key: values for key, values in ends.items() if key.partition(".")[0] not in TRACED}
    programs = math.prod(map(len, shaping.values()))
    if programs > MOST_PROGRAMS:
        raise UserError(f"[ppo], [actions] and [planner] have {programs} combinations; give at most {MOST_PROGRAMS}")
    first = {key: values[0] for key, values in ends.items()}
    tried = [first | dict(zip(shaping, values, strict=True)) for values in itertools.product(*shaping.values())]
    tried += [first | {key: value} for key, values in ends.items() if key not in shaping for value in values]
    for chosen in tried:
        settings(space.options(base, chosen))


def _ends(distribution: BaseDistribution) -> tuple[Any, ...]:
    if isinstance(distribution, FloatDistribution):
        return distribution.low, distribution.high
    assert isinstance(distribution, CategoricalDistribution)
    return distribution.choices
