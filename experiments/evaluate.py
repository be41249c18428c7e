"""Drive scenarios in closed loop, in batches, and report how every episode ends."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._batches import Batch, BatchDriver, make_batches
from experiments._driving import DrivingOptions, cost_weights, planner_config
from experiments._results import driven_steps, episode_row, summarize, summary_table, write_results
from experiments._sources import SourceOptions, load_scenarios, source_as_plain
from scenarios.command_line import UserError, prepare_folder, print_table, run_command


@dataclass(frozen=True)
class EvaluateOptions(DrivingOptions):
    """Drive scenarios and report how every episode ends: a table, results.json and episodes.csv."""

    batch: int = 8
    """Largest number of scenarios that are driven at once."""
    solutions: bool = False
    """Also write one CommonRoad solution file per episode."""
    out: Path = Path("runs/evaluate")
    """Folder for the results."""


def evaluate(options: EvaluateOptions) -> None:
    """Drive the scenarios that the options name, write the results, and print their table."""
    if options.batch < 1:
        raise UserError(f"--batch {options.batch}: give at least 1")
    config, weights = planner_config(options), cost_weights(options.weights)
    found = load_scenarios(options)
    folder = prepare_folder(options.out)
    driver = BatchDriver(config, weights)
    episodes = _drive(driver, make_batches(found.scenarios, options.batch), len(found.scenarios))
    names = unique_names(found.infos)
    rows = [episode_row(*one) for one in zip(names, found.infos, episodes, strict=True)]
    summary = summarize(rows, found.skipped, driver.seconds, driver.compile_seconds)
    if options.solutions:
        _write_solutions(folder / "solutions", names, found, episodes, config.vehicle)
    write_results(folder, _as_plain(options, weights), summary, rows)
    print_table(summary_table(summary), "outcomes")
    print(f"written to {folder / 'results.json'} and episodes.csv")


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


def _as_plain(options: EvaluateOptions, weights: jf.CostWeights) -> dict[str, Any]:
    """The options as JSON can hold them, with all weights that rank trajectories."""
    source = {field.name for field in fields(SourceOptions)}
    rest = {name: value for name, value in asdict(options).items() if name not in source}
    ranking = {name: getattr(weights, name) for name in weights.names()}
    return source_as_plain(options) | rest | {"weights": ranking, "out": str(options.out)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(EvaluateOptions, evaluate, "experiments.evaluate", arguments)


if __name__ == "__main__":
    main()
