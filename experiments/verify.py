"""Have CommonRoad's own tools judge the solutions that `evaluate --solutions` wrote."""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from experiments._checker import Verdict, check_solution, quieten
from experiments._sources import draw_of, scenario_paths
from scenarios.collection import scenario_files
from scenarios.command_line import UserError, print_table, run_command
from scenarios.families import documents
from scenarios.files import written_whole


@dataclass(frozen=True)
class VerifyOptions:
    """Have CommonRoad's own tools judge the solutions that `evaluate --solutions` wrote: a table and verify.json."""

    results: Path = Path("runs/evaluate")
    """Folder that `evaluate --solutions` wrote."""
    feasibility: bool = False
    """Also check that a kinematic single-track car can drive every transition: several seconds per solution."""
    limit: int | None = None
    """Judge only this many solutions, spread evenly over the set."""
    processes: int = os.cpu_count() or 1
    """Processes that judge at the same time."""


def verify(options: VerifyOptions) -> None:
    """Judge every solution, compare with the outcome that `evaluate` reported, and print how often they agree."""
    if importlib.util.find_spec("commonroad_dc") is None:
        raise UserError("needs commonroad-drivability-checker, which is not installed; install jaxfrenet[checker]")
    document = _read_results(options.results)
    texts = _scenario_texts(document["config"])
    episodes = _chosen(document["episodes"], options.limit)
    jobs = [(texts(row["scenario"]), _solution_of(options.results, row)) for row in episodes]
    verdicts = _judge(jobs, options)
    rows = [_compared(row, verdict) for row, verdict in zip(episodes, verdicts, strict=True)]
    with written_whole(options.results / "verify.json") as file:
        file.write(json.dumps(rows, indent=1).encode() + b"\n")
    print_table(_summary(rows, options.feasibility), "CommonRoad's verdict")
    print(f"written to {options.results / 'verify.json'}")


def _read_results(folder: Path) -> dict[str, Any]:
    path = folder / "results.json"
    if not path.is_file():
        raise UserError(f"{path}: no such file; run evaluate --solutions --out {folder} first")
    try:
        document = json.loads(path.read_bytes())
        config = document["config"]
        complete = bool(document["episodes"] and (config.get("scenarios") or draw_of(config).checked()))
    except (ValueError, KeyError, TypeError, AttributeError):
        complete = False
    if not complete:
        raise UserError(f"{path}: is not a complete result of evaluate; run evaluate again")
    if not document["config"].get("traffic", True):
        raise UserError(f"{path}: driven without traffic, which the checker has; run evaluate without --no-traffic")
    return document


def _scenario_texts(config: dict[str, Any]) -> Callable[[str], bytes]:
    """A function from an episode's name to the text of its CommonRoad file."""
    by_name = _file_readers(config["scenarios"]) if config.get("scenarios") else _generated_again(config)

    def text(name: str) -> bytes:
        if name not in by_name:
            raise UserError(f"{name}: not among the scenarios that were driven; put the files back where they were")
        return by_name[name]()

    return text


def _file_readers(sources: Sequence[str]) -> dict[str, Callable[[], bytes]]:
    paths = scenario_paths(map(Path, sources))
    kept = [str(path) for path in paths if path.suffix == ".npz"]
    if kept:
        raise UserError(f"{kept[0]}: holds no CommonRoad files to judge by; evaluate the files that it was made from")
    found = [file for path in paths for file in scenario_files(path)]
    by_name = {Path(file.name).stem: file.read for file in found}
    if len(by_name) < len(found):
        raise UserError("several scenarios have one name: evaluate and verify their folders one by one")
    return by_name


def _generated_again(config: dict[str, Any]) -> dict[str, Callable[[], bytes]]:
    draw = draw_of(config)
    made = tqdm(documents(draw), "generating", draw.count, unit=" scenarios", delay=5.0)
    return {name: lambda text=text: text for name, text in made}


def _chosen(episodes: list[dict[str, Any]], limit: int | None) -> list[dict[str, Any]]:
    if limit is None or limit >= len(episodes):
        return episodes
    if limit < 1:
        raise UserError(f"--limit {limit}: give at least 1")
    return [episodes[i * len(episodes) // limit] for i in range(limit)]


def _solution_of(folder: Path, row: dict[str, Any]) -> Path:
    path = folder / "solutions" / f"{row['scenario']}.xml"
    if not path.is_file():
        raise UserError(f"{path}: no such file; run evaluate with --solutions again")
    return path


def _judge(jobs: Sequence[tuple[bytes, Path]], options: VerifyOptions) -> list[Verdict]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max(1, options.processes), context, initializer=quieten) as pool:
        futures = [pool.submit(check_solution, *job, options.feasibility) for job in jobs]
        return [future.result() for future in tqdm(futures, desc="verifying", unit=" solutions", delay=5.0)]


def _compared(row: dict[str, Any], verdict: Verdict) -> dict[str, Any]:
    """The verdict, and whether it agrees with the outcome.

    An episode that ends on a collision may touch obstacle and road edge, or reach its goal, in the same step: of
    those the outcome tells the one that counts first.
    """
    outcome = row["outcome"]
    crashed = verdict.obstacle_collision or verdict.road_collision
    agrees = {
        "collision_obstacle": verdict.obstacle_collision,
        "collision_road": verdict.road_collision and not verdict.obstacle_collision,
        "goal_reached_in_time": verdict.goal_reached and not crashed,
    }.get(outcome, not verdict.goal_reached and not crashed)
    return {"scenario": row["scenario"], "outcome": outcome, "agrees": agrees, **asdict(verdict)}


def _summary(rows: Sequence[dict[str, Any]], feasibility: bool) -> list[tuple[str, str]]:
    def share(name: str) -> str:
        count = sum(row[name] for row in rows)
        return f"{count}/{len(rows)}"

    table = [(name.replace("_", " "), share(name)) for name in ("obstacle_collision", "road_collision", "goal_reached")]
    table.append(("agrees with outcome", share("agrees")))
    table += [(f"disagrees: {row['scenario']}", row["outcome"]) for row in rows if not row["agrees"]]
    if feasibility:
        table.append(("feasible", share("feasible")))
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(VerifyOptions, verify, "experiments.verify", arguments)


if __name__ == "__main__":
    main()
