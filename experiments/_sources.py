"""Options that say where scenarios come from, everywhere the same, and the scenarios that they name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

import scenarios
from scenarios.command_line import UserError
from scenarios.families import FAMILIES, Draw, generate

BUILTIN = Path("builtin")
"""Stands for the scenarios that come with the project."""


@dataclass(frozen=True)
class GeneratorOptions:
    """Which scenarios are generated."""

    generate: int = 16
    """How many scenarios to generate."""
    generator_seed: int = 0
    """Seed of the generated scenarios; the same seed gives the same scenarios."""
    family: str = "tjunction"
    """Kind of the generated scenarios: tjunction, crossing or highway."""
    preset: str = "default"
    """What they are drawn from: default, hard or, for T-junctions, commonroad (like CommonRoad's own)."""

    def draw(self) -> Draw:
        """What the generator is asked for."""
        return Draw(self.generate, self.generator_seed, self.family, self.preset)


GENERATOR_FIELDS = tuple(field.name for field in fields(GeneratorOptions))


@dataclass(frozen=True)
class SourceOptions(GeneratorOptions):
    """Where scenarios come from: files, or the generator."""

    scenarios: Annotated[tuple[Path, ...] | None, tyro.conf.arg(metavar="PATH...")] = None
    """CommonRoad files, folders or .tar.xz/.zip archives of them, .npz sets, or `builtin`; not generated ones then."""
    planning_problem: int | None = None
    """Identifier of the planning problem in the files; the first of each file where it is not given."""
    traffic: bool = True
    """Whether there are other road users; without them only the road and the goal are left."""


def load_scenarios(options: SourceOptions) -> scenarios.ScenarioSet:
    """Read or generate the scenarios that the options ask for.

    Raises:
      UserError: they ask for none, or for both.
      ScenarioError: nothing that can be driven was found, or the generator was asked for something impossible.
      OSError: a file cannot be read.
    """
    found = _from_source(options)
    if options.traffic:
        return found
    return replace(found, scenarios=tuple(scenarios.without_traffic(scenario) for scenario in found.scenarios))


def _from_source(options: SourceOptions) -> scenarios.ScenarioSet:
    if options.scenarios is None:
        if options.planning_problem is not None:
            wanted = f"--planning-problem {options.planning_problem}"
            raise UserError(f"{wanted}: generated scenarios have but one; leave it out, or name --scenarios")
        with tqdm(desc="generating", unit=" scenarios", delay=5.0) as bar:
            return generate(options.draw(), _reporter(bar))
    for name in GENERATOR_FIELDS:
        if getattr(options, name) != getattr(GeneratorOptions, name):
            flag = f"--{name.replace('_', '-')}"
            raise UserError(f"--scenarios and {flag} name two sources of scenarios; leave one of them out")
    return load_files(options.scenarios, options.planning_problem)


def load_files(sources: tuple[Path, ...], planning_problem: int | None = None) -> scenarios.ScenarioSet:
    """Read the scenarios that `--scenarios` names; folders and archives that were read before come from a cache.

    Raises:
      UserError: none is named.
      ScenarioError: nothing that can be driven was found.
      OSError: a file cannot be read.
    """
    if not sources:
        raise UserError("--scenarios: no file named; name at least one, or leave the option out")
    with tqdm(desc="importing", unit=" files", delay=5.0) as bar:
        return scenarios.load_cached(scenario_paths(sources), planning_problem, progress=_reporter(bar))


def choose(found: scenarios.ScenarioSet, name: str | None) -> int:
    """Index of the scenario with a name; the first one for None.

    Raises:
      UserError: there is no such scenario.
    """
    names = [info.name for info in found.infos]
    if name is None:
        return 0
    if name not in names:
        raise UserError(f"--name {name}: no such scenario; there are {', '.join(names[:10])}{' …' * (len(names) > 10)}")
    return names.index(name)


def scenario_paths(sources: Iterable[Path]) -> list[Path]:
    """The paths that `--scenarios` names; `builtin` stands for the project's own files."""
    return [path for source in sources for path in (scenarios.builtin_paths() if source == BUILTIN else [source])]


def source_as_plain(options: SourceOptions) -> dict[str, Any]:
    """The options that name the source, as JSON can hold them; those of the other source are left out."""
    if options.scenarios is None:
        source = {name: getattr(options, name) for name in GENERATOR_FIELDS}
    else:
        source = {"scenarios": [str(path) for path in options.scenarios], "planning_problem": options.planning_problem}
    return source | {"traffic": options.traffic}


def draw_of(config: dict[str, Any]) -> Draw:
    """What the generator was asked for, from `source_as_plain`."""
    return GeneratorOptions(**{name: config[name] for name in GENERATOR_FIELDS}).draw()


def named_draws(kinds: tuple[str, ...], count: int, seed: int) -> dict[str, Draw]:
    """What the generator is asked for by words `FAMILY` or `FAMILY:PRESET`, by their full names; everything if none.

    Raises:
      ScenarioError: there is no such family or preset, or a number is out of range.
    """
    draws: dict[str, Draw] = {}
    for kind in kinds or tuple(FAMILIES):
        family, _, preset = kind.partition(":")
        presets = (preset,) if preset or family not in FAMILIES else tuple(FAMILIES[family].presets)
        draws |= {f"{family}:{one}": Draw(count, seed, family, one).checked() for one in presets}
    return draws


def _reporter(bar: tqdm) -> Callable[[int, int], None]:
    def report(done: int, total: int) -> None:
        bar.total = total
        bar.update(done - bar.n)

    return report
