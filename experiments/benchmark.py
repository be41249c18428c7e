"""Time the planner, whole episodes, the environment, training and the predictors, and the C++ reference beside."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args

from tqdm import tqdm

import jaxfrenet as jf
from experiments._benchmark_plot import draw_benchmark
from experiments._benchmark_tables import print_rows
from experiments._loop_timing import (
    PREDICTIONS,
    measure_environment,
    measure_episodes,
    measure_predictor,
    measure_training,
)
from experiments._machine import Peaks, describe_machine, measure_peaks, most_memory
from experiments._measuring import Budget, DoesNotFit, memory_watched
from experiments._planner_timing import Case, arms, measure_case, nearest_level, star
from experiments._planning_cases import Layout
from experiments._presets import PresetName
from experiments._reference import load_reference
from experiments._sources import SourceOptions, load_scenarios, source_as_plain
from jaxfrenet.config import Sampling
from scenarios.command_line import UserError, prepare_folder, print_table, run_command
from scenarios.files import written_whole

Part = Literal["planner", "episode", "environment", "training", "predictor"]
Job = tuple[str, Callable[[], dict[str, Any]]]
"""What is measured, in words, and what measures it."""
DIGITS = 5
"""Significant digits of the numbers that are written."""


@dataclass(frozen=True)
class BenchmarkOptions(SourceOptions):
    """Measure how fast everything runs: tables, benchmark.json and benchmark.png.

    The planner's part varies one thing at a time: batch sizes, layouts and numbers of obstacles, and numbers of
    trajectories. The others are held at 800 trajectories and 5 obstacles, mixed, in a batch of 64, when trajectories
    are varied in a batch of 1; where a list does not have that value, at the list's first. All others run on
    --scenarios, or on generated ones, as often as it takes to fill a batch.
    """

    parts: tuple[Part, ...] = ("planner", "episode", "environment", "training", "predictor")
    """What is measured."""
    batch: tuple[int, ...] = (1, 16, 64, 512)
    """Planner: scenarios in a batch; 1 is planned without a batch axis."""
    trajectories: tuple[int, ...] = (180, 800, 3564, 12716)
    """Planner: sampled trajectories; of 48, 180, 800, 3564 and 12716 the nearest is taken."""
    obstacles: tuple[int, ...] = (0, 5, 10, 30)
    """Planner: other cars."""
    layouts: tuple[Layout, ...] = ("near", "mixed", "far")
    """Planner: where other cars are; most, a quarter, or none of trajectories' points are within 7 m of them."""
    reference: bool = False
    """Planner: also give the same inputs to the C++ planner `frenetix`, in turn with ours."""
    presets: tuple[Sampling, ...] = ("full", "fast")
    """Episode and environment: how many trajectories a planning cycle samples."""
    loop_batch: tuple[int, ...] = (8, 64)
    """Episode, environment: scenarios in a batch. The predictor is measured with 1 and the last of these."""
    steps: int = 20
    """Environment: steps in one call."""
    training: tuple[PresetName, ...] = ("cpu",)
    """Training: presets of `train`."""
    seconds: float = 2.0
    """Measure each case for at least so long [s]."""
    repeats: int | None = None
    """Measure each case exactly so often instead."""
    out: Path = Path("runs/benchmark")
    """Folder for the results."""


def benchmark(options: BenchmarkOptions) -> None:
    """Measure what the options ask for; results are written after each part, so that little is lost."""
    _check(options)
    folder = prepare_folder(options.out)
    found = load_scenarios(options).scenarios if set(options.parts) - {"planner"} else ()
    peaks = measure_peaks() if "planner" in options.parts else None
    jobs = _jobs(options, found, peaks)
    machine = describe_machine(peaks) | {"frenetix": version("frenetix") if options.reference else None}
    results: dict[str, Any] = {"machine": machine, "options": _as_plain(options)}
    results |= {part: [] for part in get_args(Part)} | {"skipped": []}
    with tqdm(total=sum(map(len, jobs.values())), desc="measuring", unit=" cases") as bar:
        for part, cases in jobs.items():
            for name, job in cases:
                bar.set_postfix_str(f"{part}: {name}")
                try:
                    with memory_watched():
                        results[part].append(job())
                except DoesNotFit as reason:
                    results["skipped"].append({"part": part, "case": name, "reason": str(reason)})
                bar.update()
            machine["process_megabytes"] = most_memory()
            _write(folder / "benchmark.json", results)
    _report(options, results, folder)


def _check(options: BenchmarkOptions) -> None:
    """Refuse what cannot be measured, before anything is.

    Raises:
      UserError: an option is empty or out of range, or the reference is not installed.
    """
    for name in ("parts", "batch", "trajectories", "obstacles", "layouts", "presets", "loop_batch", "training"):
        if not getattr(options, name):
            raise UserError(f"--{name.replace('_', '-')} names nothing; name at least one, or leave the option out")
    for name, least in (("batch", 1), ("trajectories", 1), ("obstacles", 0), ("loop_batch", 1)):
        for value in getattr(options, name):
            if value < least:
                raise UserError(f"--{name.replace('_', '-')} {value}: give at least {least}")
    if options.steps < 1:
        raise UserError(f"--steps {options.steps}: give at least 1")
    if options.repeats is not None and options.repeats < 1:
        raise UserError(f"--repeats {options.repeats}: give at least 1")
    if not 0.0 <= options.seconds < math.inf:
        raise UserError(f"--seconds {options.seconds}: give 0 or more")
    if options.reference:
        load_reference()


def _jobs(options: BenchmarkOptions, found: Sequence[jf.Scenario], peaks: Peaks | None) -> dict[Part, list[Job]]:
    """What is to be measured, by part."""
    budget = Budget(options.seconds, options.repeats)
    jobs: dict[Part, list[Job]] = {}
    if peaks is not None:
        jobs["planner"] = [
            (str(case), partial(measure_case, case, peaks, options.reference, budget)) for case in _cases(options)
        ]
    loops = [(preset, batch) for preset in options.presets for batch in dict.fromkeys(options.loop_batch)]
    if "episode" in options.parts:
        jobs["episode"] = [(f"{one[0]}, batch {one[1]}", partial(measure_episodes, found, *one)) for one in loops]
    if "environment" in options.parts:
        step_on = partial(measure_environment, found, steps=options.steps, budget=budget)
        jobs["environment"] = [(f"{one[0]}, batch {one[1]}", partial(step_on, *one)) for one in loops]
    if "training" in options.parts:
        jobs["training"] = [(name, partial(measure_training, found, name, budget)) for name in options.training]
    if "predictor" in options.parts:
        sizes = dict.fromkeys((1, options.loop_batch[-1]))
        jobs["predictor"] = [
            (f"{kind}, {what}, batch {batch}", partial(measure_predictor, found, kind, what, batch, budget))
            for kind, what in PREDICTIONS
            for batch in sizes
        ]
    return jobs


def _cases(options: BenchmarkOptions) -> list[Case]:
    levels = [nearest_level(count) for count in options.trajectories]
    return star(options.batch, levels, options.obstacles, options.layouts)


def _as_plain(options: BenchmarkOptions) -> dict[str, Any]:
    """The options as JSON can hold them."""
    source = {field.name for field in fields(SourceOptions)}
    rest = {name: value for name, value in asdict(options).items() if name not in source}
    return source_as_plain(options) | rest | {"out": str(options.out)}


def _write(path: Path, results: dict[str, Any]) -> None:
    with written_whole(path) as file:
        file.write(json.dumps(_rounded(results), indent=1, allow_nan=False).encode() + b"\n")


def _rounded(value: Any) -> Any:
    """The same with fewer digits, in all depths."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _report(options: BenchmarkOptions, results: dict[str, Any], folder: Path) -> None:
    """Print the tables and draw the picture."""
    print_table([(name, str(value)) for name, value in _rounded(results["machine"]).items()], "machine")
    for part in get_args(Part):
        print_rows(part, results[part])
    if results["skipped"]:
        print_table([(f"{one['part']}: {one['case']}", one["reason"]) for one in results["skipped"]], "skipped")
    written = str(folder / "benchmark.json")
    if results["planner"]:
        batches, trajectories = arms(results["planner"], _cases(options))
        with written_whole(folder / "benchmark.png") as file:
            machine = results["machine"]
            name = machine["cpu"] if machine["platform"] == "cpu" else machine["device"]
            draw_benchmark(batches, trajectories, name).savefig(file, format="png")
        written += " and benchmark.png"
    print(f"written to {written}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(BenchmarkOptions, benchmark, "experiments.benchmark", arguments)


if __name__ == "__main__":
    main()
