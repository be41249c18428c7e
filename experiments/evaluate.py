"""Drive scenarios in closed loop, in batches, and report how every episode ends."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._batches import Batch, BatchDriver, make_batches
from experiments._comparison import compare, comparison_table
from experiments._driving import DrivingOptions, chosen_planner, fixed_weights, other_planners, own_name
from experiments._planners import Planner
from experiments._results import driven_steps, episode_row, summarize, summary_table, write_results
from experiments._sources import SourceOptions, load_scenarios, source_as_plain
from scenarios.command_line import UserError, prepare_folder, print_table, run_command
from scenarios.files import written_whole


@dataclass(frozen=True)
class EvaluateOptions(DrivingOptions):
    """Drive scenarios and report how every episode ends: a table, results.json and episodes.csv."""

    batch: int = 8
    """Largest number of scenarios that are driven at once."""
    compare: tuple[str, ...] | None = None
    """Drive other planners, too, and show all beside each other: `default`, `shipped` (the policy that comes with the
    project) or folders of policies; `default` if none is named."""
    solutions: bool = False
    """Also write one CommonRoad solution file per episode."""
    out: Path = Path("runs/evaluate")
    """Folder for the results."""


def evaluate(options: EvaluateOptions) -> None:
    """Drive the scenarios that the options name, write the results, and print their table."""
    if options.batch < 1:
        raise UserError(f"--batch {options.batch}: give at least 1")
    planner = chosen_planner(options)
    others = {} if options.compare is None else other_planners(options, options.compare or ("default",), planner.config)
    found = load_scenarios(options)
    folder = prepare_folder(options.out)
    batches, names = make_batches(found.scenarios, options.batch), unique_names(found.infos)
    driven = _driven(planner, batches, found, names)
    if options.solutions:
        _write_solutions(folder / "solutions", names, found, driven.episodes, planner.config.vehicle)
    config = _as_plain(options)
    beside = {name: _driven(other, batches, found, names) for name, other in others.items()}
    for name, other in beside.items():
        write_results(prepare_folder(folder / name), config | {"planner": name}, other.summary, other.rows)
    print_table(summary_table(driven.summary), "outcomes")
    if beside:
        compared = compare({name: one.rows for name, one in beside.items()} | {own_name(options): driven.rows})
        print("\n".join(comparison_table(compared)))
        with written_whole(folder / "comparison.json") as file:
            file.write(json.dumps(compared, indent=1, allow_nan=False).encode() + b"\n")
    write_results(folder, config, driven.summary, driven.rows)
    print(f"written to {folder / 'results.json'} and episodes.csv")


class Driven(NamedTuple):
    """What one planner did."""

    episodes: list[jf.Episode]
    rows: list[dict[str, Any]]
    summary: dict[str, Any]


def _driven(planner: Planner, batches: Sequence[Batch], found: scenarios.ScenarioSet, names: Sequence[str]) -> Driven:
    driver = BatchDriver(planner)
    episodes = _drive(driver, batches, len(found.scenarios))
    rows = [episode_row(*one) for one in zip(names, found.infos, episodes, strict=True)]
    return Driven(episodes, rows, summarize(rows, found.skipped, driver.seconds, driver.compile_seconds))


def _drive(driver: BatchDriver, batches: Sequence[Batch], total: int) -> list[jf.Episode]:
    """All episodes, in the order of the scenarios."""
    episodes: dict[int, jf.Episode] = {}
    with tqdm(total=total, desc="driving", unit=" scenarios", mininterval=1.0) as bar:
        for batch in batches:
            episodes |= driver.drive(batch)
            cycles = sum(int(episode.steps) for episode in episodes.values())
            bar.set_postfix_str(f"{cycles / driver.seconds:.0f} planning cycles/s", refresh=False)
            bar.update(len(batch.indices))
    return [episodes[index] for index in range(total)]


def unique_names(infos: Sequence[scenarios.ScenarioInfo]) -> list[str]:
    """The scenarios' names; further ones of the same name are numbered, so that each has its own file."""
    seen = Counter[str]()
    names = []
    for info in infos:
        seen[info.name] += 1
        names.append(info.name if seen[info.name] == 1 else f"{info.name}_{seen[info.name]}")
    return names


def _write_solutions(
    folder: Path,
    names: Sequence[str],
    found: scenarios.ScenarioSet,
    episodes: Sequence[jf.Episode],
    vehicle: jf.Vehicle,
) -> None:
    """Write one file per episode; the folder takes the place of an earlier run's when it is complete."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".solutions.") as partial:
        fresh = Path(partial) / "solutions"
        for name, info, scenario, episode in zip(names, found.infos, found.scenarios, episodes, strict=True):
            driven = slice(0, driven_steps(episode) + 1)
            motion = {
                field: getattr(episode.ego, field)[driven] for field in ("x", "y", "heading", "speed", "curvature")
            }
            scenarios.write_solution(fresh / f"{name}.xml", info, scenario, vehicle, **motion)
        if folder.is_dir():
            folder.rename(Path(partial) / "earlier")
        fresh.rename(folder)


def _as_plain(options: EvaluateOptions) -> dict[str, Any]:
    """The options as JSON can hold them; with all weights and ranges, where they are fixed."""
    source = {field.name for field in fields(SourceOptions)}
    rest = {name: value for name, value in asdict(options).items() if name not in source}
    paths = {name: None if rest[name] is None else str(rest[name]) for name in ("out", "policy")}
    weights, reach = fixed_weights(options.weights)
    fixed = {name: getattr(weights, name) for name in weights.names()} | asdict(reach or jf.SamplingRange())
    return source_as_plain(options) | rest | paths | {"weights": fixed if options.planner == "default" else None}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(EvaluateOptions, evaluate, "experiments.evaluate", arguments)


if __name__ == "__main__":
    main()
