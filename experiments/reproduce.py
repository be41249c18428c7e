"""The paper's study by one command: the default planner in several settings and the hybrid planner, side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from tqdm import tqdm

import jaxfrenet as jf
from experiments import _episode_exhibits, _paper, _study_exhibits
from experiments._batches import BatchDriver, make_batches
from experiments._comparison import compare, comparison_table
from experiments._exhibits import Exhibit, write_csv, write_exhibit
from experiments._machine import describe_machine
from experiments._planners import SHIPPED, DefaultPlanner, HybridPlanner, describe, load_hybrid
from experiments._report import source_version, write_report
from experiments._run_time import measure_run_time
from experiments._sources import SourceOptions, choose, load_scenarios, source_as_plain
from experiments._study import COLUMNS, Driven, Study, column, digest, settle_study, telling_scenario
from experiments._training_log import METRICS, read_metrics
from experiments.evaluate import unique_names
from jaxfrenet.config import Sampling
from scenarios.command_line import UserError, prepare_folder, run_command, spelled
from scenarios.files import written_whole

DEFAULT_WEIGHT = 200.0
"""Weight of the collision probability that makes the default planner."""


@dataclass(frozen=True)
class ReproduceOptions(SourceOptions):
    """Repeat the paper's study and write report.html: every figure and table beside the paper's numbers.

    All scenarios are driven by the default planner (DP) at several weights of the collision probability, and by the
    hybrid planner (HP). Figures are PNG and PDF, with their data as CSV. A run that was stopped goes on where it was.
    """

    policy: Path | None = None
    """Folder of the hybrid planner's policy, written by `train`; the one that comes with the project if not given."""
    collision_weights: tuple[float, ...] = _paper.COLLISION_WEIGHTS
    """Weights of the collision probability to try with the default planner; its own, 200, is always tried."""
    predictor: Literal["neural", "constant_velocity", "ground_truth"] = "neural"
    """How the planner predicts the traffic."""
    sampling: Sampling = "full"
    """How many trajectories a planning cycle samples: `full` 800, `fast` 180, `dense` 3,564."""
    name: str | None = None
    """Scenario whose episode is shown; if not given, one where only the default planner collides, or else comes closest
    to it."""
    batch: int = 8
    """Largest number of scenarios that are driven at once."""
    seed: int = 0
    """Seed of everything random; the study draws nothing."""
    out: Path = Path("runs/reproduce")
    """Folder for the results."""


def reproduce(options: ReproduceOptions) -> None:
    """Drive what has not been driven yet, write every figure and the report, and print how the planners compare."""
    weights = _checked_weights(options)
    config = jf.PlannerConfig.preset(options.sampling, predictor=options.predictor)
    hybrid = load_hybrid(options.policy, config)
    found = load_scenarios(options)
    names = unique_names(found.infos)
    place = None if options.name is None else choose(found, options.name)
    folder = prepare_folder(options.out)
    settle_study(folder, _settings(options, hybrid, found.scenarios))
    study = Study(folder, make_batches(found.scenarios, options.batch), names, found)
    driven = _drive(study, config, weights, hybrid)
    times = _run_times(folder, hybrid, names, found.scenarios)
    default = driven[_named_default()]
    place = telling_scenario(default, driven["hybrid"]) if place is None else place
    exhibits = _exhibits(options, driven, times, config, found.scenarios[place], place)
    for exhibit in exhibits:
        write_exhibit(folder, exhibit)
    _write_data(folder, driven, names)
    write_report(folder / "report.html", "Default and hybrid planner", _facts(options, found, study, driven), exhibits)
    print("\n".join(comparison_table(compare({"DP": default.rows, "HP": driven["hybrid"].rows}))))
    print(f"written to {folder / 'report.html'}, with every figure as PNG, PDF and CSV beside it")


def _checked_weights(options: ReproduceOptions) -> list[float]:
    if options.batch < 1:
        raise UserError(f"--batch {options.batch}: give at least 1")
    for weight in options.collision_weights:
        if not 0.0 <= weight < np.inf:
            raise UserError(f"--collision-weights {weight}: give finite numbers of at least 0")
    return sorted({DEFAULT_WEIGHT, *map(float, options.collision_weights)})


def _named_default(weight: float = DEFAULT_WEIGHT) -> str:
    return f"default_{weight:g}"


def _settings(options: ReproduceOptions, hybrid: HybridPlanner, found: Sequence[jf.Scenario]) -> dict[str, Any]:
    """What the parts of a study depend on."""
    leaves = [np.asarray(leaf) for scenario in found for leaf in jax.tree.leaves(scenario)]
    actions = json.dumps(describe(hybrid.environment)["adjustments"]).encode()
    return {
        "scenarios": digest(*leaves),
        "policy": digest(*map(np.asarray, jax.tree.leaves(hybrid.parameters)), np.frombuffer(actions, np.uint8)),
        "predictor": options.predictor,
        "sampling": options.sampling,
        "batch": options.batch,
    }


def _drive(
    study: Study, config: jf.PlannerConfig, weights: Sequence[float], hybrid: HybridPlanner
) -> dict[str, Driven]:
    """What every configuration did, by name."""
    first = DefaultPlanner(config, jf.CostWeights())
    shared = BatchDriver(first)
    found: dict[str, Driven] = {}
    with tqdm(total=(len(weights) + 1) * len(study.names), unit=" episodes", mininterval=1.0) as bar:
        for weight in weights:
            name = _named_default(weight)
            bar.set_description(name)
            found[name] = study.drive(name, DefaultPlanner(config, jf.CostWeights(prediction=weight)), shared, bar)
        bar.set_description("hybrid")
        found["hybrid"] = study.drive("hybrid", hybrid, BatchDriver(hybrid), bar)
    return found


def _run_times(
    folder: Path, hybrid: HybridPlanner, names: Sequence[str], found: Sequence[jf.Scenario]
) -> list[dict[str, Any]]:
    file = folder / "parts" / "run_time.json"
    if not file.is_file():
        rows = measure_run_time(hybrid, names, found)
        with written_whole(file) as handle:
            handle.write(json.dumps(rows).encode())
    return json.loads(file.read_text())


def _exhibits(
    options: ReproduceOptions,
    driven: dict[str, Driven],
    times: list[dict[str, Any]],
    config: jf.PlannerConfig,
    scenario: jf.Scenario,
    place: int,
) -> list[Exhibit]:
    """The paper's figures and tables, in the order of the report."""
    default, hybrid = driven[_named_default()], driven["hybrid"]
    one = _episode_exhibits.shown(place, default, hybrid)
    exhibits = [
        _study_exhibits.outcomes(driven),
        _study_exhibits.risk(default, hybrid),
        _episode_exhibits.speed_and_risk(one),
        _episode_exhibits.paths(one, jax.tree.map(np.asarray, scenario), config.vehicle),
        _study_exhibits.driving(default, hybrid),
        _study_exhibits.run_time(times),
    ]
    if lines := _training_record(options.policy):
        exhibits.append(_study_exhibits.training(lines))
    return [*exhibits, _episode_exhibits.weights(one)]


def _training_record(policy: Path | None) -> list[dict[str, Any]]:
    """The record of the policy's training: beside it, or where training has left it; empty if there is none."""
    folder = SHIPPED if policy is None else policy
    where = next((one for one in (folder, folder.parent) if (one / METRICS).is_file()), None)
    return [] if where is None else read_metrics(where)


def _write_data(folder: Path, driven: Mapping[str, Driven], names: Sequence[str]) -> None:
    """Write all episodes, and all steps of the two planners that are compared step by step."""
    rows = [{"configuration": name} | row for name, one in driven.items() for row in one.rows]
    write_csv(folder / "episodes.csv", rows)
    compared = {"default": driven[_named_default()], "hybrid": driven["hybrid"]}
    kept = [name for name in COLUMNS if not name.startswith("weight_")]
    steps = [
        {"planner": planner, "scenario": name, "step": step} | dict(zip(kept, values, strict=True))
        for planner, one in compared.items()
        for name, track in zip(names, one.tracks, strict=True)
        for step, values in enumerate(np.stack([column(track, what) for what in kept], axis=-1).tolist())
    ]
    write_csv(folder / "steps.csv", steps)


def _facts(options: ReproduceOptions, found: Any, study: Study, driven: Mapping[str, Driven]) -> dict[str, str]:
    """What the report says about itself."""
    machine = describe_machine(None)
    cycles = sum(row["steps"] for one in driven.values() for row in one.rows)
    seconds = sum(one.seconds for one in driven.values())
    skipped = "".join(f"; left out {one.file}: {one.reason}" for one in found.skipped)
    return {
        "Scenarios": f"{len(study.names)} ({_source(options)}){skipped}",
        "Planner": f"sampling {options.sampling}, predictor {options.predictor}",
        "Policy": "the one that comes with the project" if options.policy is None else str(options.policy),
        "Driven": f"{cycles:,} planning cycles in {seconds:.0f} s, compiling aside",
        "Machine": f"{machine['cpu']}, {machine['cores']} cores, {machine['device']}; jax {machine['jax']}",
        "Source": source_version(),
        "Command": spelled(options, "experiments.reproduce"),
        "Train such a policy": _training_command(options.policy),
    }


def _source(options: ReproduceOptions) -> str:
    plain = source_as_plain(options)
    return ", ".join(f"{name} {value}" for name, value in plain.items() if value is not None and name != "traffic")


def _training_command(policy: Path | None) -> str:
    folder = SHIPPED if policy is None else policy
    return json.loads((folder / "policy.json").read_text())["description"].get("command", "not known")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(ReproduceOptions, reproduce, "experiments.reproduce", arguments)


if __name__ == "__main__":
    main()
