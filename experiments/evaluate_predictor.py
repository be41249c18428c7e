"""Compare predictors of the traffic with what was recorded: distances, likelihood, calibration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tqdm import tqdm

import jaxfrenet as jf
from experiments._predictions import BINS, LEVELS, Tally, Traffic, score, tally
from experiments._sources import load_files, named_draws
from jaxfrenet._typing import Array
from jaxfrenet.prediction import constant_velocity, neural
from scenarios import Dataset
from scenarios.command_line import UserError, prepare_folder, run_command
from scenarios.files import written_whole

HORIZONS = (10, 30, 50)
"""Steps after which predictions are looked at."""
PREDICTORS = ("constant_velocity", "neural")
COLORS = {"constant_velocity": "#5b6570", "neural": "#d7263d"}
MAX_WASTE = 1.0
"""Scenarios of unlike sizes share a program as long as padding takes no more memory than they do."""
LEAST_FUTURE = 1
"""Predictions are made where at least so many steps are recorded to come."""


@dataclass(frozen=True)
class EvaluatePredictorOptions:
    """Compare predictors with what was recorded, for each family of scenarios: a table, predictor.json and a plot."""

    scenarios: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """CommonRoad files, folders or archives of them, or .npz sets; each PATH is a family of its own. Without any,
    scenarios are generated."""
    generate: int = 64
    """How many scenarios to generate of every kind."""
    kinds: tuple[str, ...] = ()
    """Kinds to generate, each FAMILY or FAMILY:PRESET, for example tjunction:hard; all where none is named."""
    generator_seed: int = 1
    """Seed of the generated scenarios; the shipped predictor was trained on those of seed 0."""
    parameters: Path | None = None
    """A predictor.npz from train_predictor; by default the one that comes with the package."""
    every: int = 5
    """Predict at every so many steps of a scenario."""
    out: Path = Path("runs/evaluate_predictor")
    """Folder for the results."""


def evaluate_predictor(options: EvaluatePredictorOptions) -> None:
    """Predict, compare, write the results and print their table."""
    if options.every < 1 or options.generate < 1:
        raise UserError(f"--every {options.every} --generate {options.generate}: give at least 1")
    parameters = read_parameters(options.parameters)
    folder = prepare_folder(options.out)
    families = _families(options)
    total = sum(len(dataset) for dataset in families.values())
    found: dict[str, dict[str, Tally]] = {}
    with tqdm(total=total * len(PREDICTORS), desc="predicting", unit=" scenarios", delay=2.0) as bar:
        for name, dataset in families.items():
            found[name] = {kind: _tally(kind, parameters, dataset, options.every, bar) for kind in PREDICTORS}
    results = {name: {kind: _as_plain(one) for kind, one in kinds.items()} for name, kinds in found.items()}
    config = {
        "scenarios": [str(path) for path in options.scenarios],
        "generated": {} if options.scenarios else {name: len(dataset) for name, dataset in families.items()},
        "generator_seed": options.generator_seed,
        "parameters": None if options.parameters is None else str(options.parameters),
        "every": options.every,
    }
    with written_whole(folder / "predictor.json") as file:
        file.write(json.dumps({"config": config, "families": results}, indent=1, allow_nan=False).encode() + b"\n")
    with written_whole(folder / "reliability.png") as file:
        _picture(results).savefig(file, format="png")
    print("\n".join(_table(results)))
    print(f"written to {folder / 'predictor.json'} and reliability.png")


def read_parameters(path: Path | None) -> neural.Parameters:
    """Parameters of the neural predictor from a file, or those that come with the package.

    Raises:
      UserError: the file holds none.
      OSError: it cannot be read.
    """
    try:
        return neural.load_parameters(path)
    except ValueError as error:
        raise UserError(str(error)) from None


def _families(options: EvaluatePredictorOptions) -> dict[str, Dataset]:
    if options.scenarios:
        names = [path.name.split(".")[0] or str(path) for path in options.scenarios]
        if len(set(names)) < len(names):
            names = [str(path) for path in options.scenarios]
        return {
            name: Dataset.from_set(load_files((path,))) for name, path in zip(names, options.scenarios, strict=True)
        }
    draws = named_draws(options.kinds, options.generate, options.generator_seed)
    return {name: Dataset.from_generator(draw) for name, draw in draws.items()}


def _tally(kind: str, parameters: neural.Parameters, dataset: Dataset, every: int, bar: tqdm) -> Tally:
    """Sums over all scenarios of a family."""
    parts = []
    for bucket in dataset.buckets(MAX_WASTE):
        traffic = Traffic(bucket.scenario.obstacles, bucket.scenario.lane_map)
        for row in range(len(bucket.indices)):
            parts.append(jax.device_get(_tally_scenario(kind, every, parameters, traffic.at(jnp.int32(row)))))
            bar.update()
    return jax.tree.map(lambda *leaves: np.sum(np.stack(leaves), axis=0, dtype=np.float64), *parts)


@partial(jax.jit, static_argnums=(0, 1))
def _tally_scenario(kind: str, every: int, parameters: neural.Parameters, traffic: Traffic) -> Tally:
    """Sums over the steps of one scenario."""

    def at(step: Array) -> Tally:
        return tally(score(_predict(kind, parameters, traffic, step), traffic.obstacles, step))

    steps = jnp.arange(0, max(traffic.obstacles.valid.shape[1] - LEAST_FUTURE, 1), every)
    return jax.lax.map(at, steps, batch_size=8).summed()


def _predict(kind: str, parameters: neural.Parameters, traffic: Traffic, step: Array) -> jf.Prediction:
    if kind == "neural":
        return neural.predict(parameters, traffic.obstacles, traffic.lane_map, step, neural.LONGEST_HORIZON)
    return constant_velocity.predict(traffic.obstacles, step, neural.LONGEST_HORIZON)


def _as_plain(sums: Tally) -> dict[str, Any]:
    """Means at the horizons, and the calibration over all steps, as JSON can hold them."""

    def mean(total: Any, count: Any) -> float | None:
        return round(float(total / count), 4) if count else None

    count = np.asarray(sums.count)
    result: dict[str, Any] = {"predictions": int(count[0])}
    for horizon in HORIZONS:
        end, to = horizon - 1, slice(0, horizon)
        result[f"{0.1 * horizon:g} s"] = {
            "fde": mean(sums.error[end], count[end]),
            "ade": mean(np.sum(sums.error[to]), np.sum(count[to])),
            "nll": mean(sums.nll[end], count[end]),
            "inside": {f"{100 * p:g} %": mean(sums.inside[end, i], count[end]) for i, p in enumerate(LEVELS)},
        }
    result["all steps"] = {
        "nll": mean(np.sum(sums.nll), np.sum(count)),
        "inside": {f"{100 * p:g} %": mean(np.sum(sums.inside[:, i]), np.sum(count)) for i, p in enumerate(LEVELS)},
    }
    below = np.cumsum(sums.histogram) / max(np.sum(sums.histogram), 1)
    result["reliability"] = [round(float(share), 4) for share in below]
    return result


def _table(results: dict[str, dict[str, Any]]) -> list[str]:
    """A line per family, predictor and horizon."""
    width = max(len(name) for name in results)
    head = f"{'family':<{width}}  {'predictor':<17}  {'after':>5}  {'FDE [m]':>8}  {'ADE [m]':>8}  {'NLL':>7}"
    lines = [head + "".join(f"{f'in {100 * p:g} %':>9}" for p in LEVELS)]
    for name, kinds in results.items():
        for kind, one in kinds.items():
            for horizon in (f"{0.1 * steps:g} s" for steps in HORIZONS):
                row = one[horizon]
                numbers = _shown(row["fde"], 8), _shown(row["ade"], 8), _shown(row["nll"], 7)
                inside = "".join(_shown(None if p is None else 100 * p, 9, 1) for p in row["inside"].values())
                lines.append(f"{name:<{width}}  {kind:<17}  {horizon:>5}  {'  '.join(numbers)}{inside}")
    return lines


def _shown(value: float | None, width: int, digits: int = 2) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.{digits}f}"


def _picture(results: dict[str, dict[str, Any]]) -> Figure:
    """A reliability diagram per family."""
    columns = min(4, len(results))
    rows = -(-len(results) // columns)
    with matplotlib.rc_context({"font.size": 8, "axes.edgecolor": "#8b939c", "axes.linewidth": 0.8}):
        figure = Figure(figsize=(3.1 * columns, 3.2 * rows), dpi=100, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        plots = list(figure.subplots(rows, columns, squeeze=False).flat)
        for axes, (name, kinds) in zip(plots, results.items(), strict=False):
            _draw_reliability(axes, name, kinds)
        for axes in plots[len(results) :]:
            axes.axis("off")
        figure.supxlabel("probability of the predicted ellipse", fontsize=9)
        figure.supylabel("share of true positions inside", fontsize=9)
    return figure


def _draw_reliability(axes: Axes, name: str, kinds: dict[str, Any]) -> None:
    levels = np.arange(BINS + 1) / BINS
    axes.plot([0, 1], [0, 1], color="#c3c9cf", linewidth=1.0)
    for kind, one in kinds.items():
        axes.plot(levels, [0.0, *one["reliability"]], color=COLORS[kind], linewidth=1.5, label=kind.replace("_", " "))
    axes.set_title(name, loc="left", fontsize=8, pad=4)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.set_aspect("equal")
    axes.legend(loc="lower right", frameon=False, fontsize=7)
    axes.grid(color="#e3e6e8", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(EvaluatePredictorOptions, evaluate_predictor, "experiments.evaluate_predictor", arguments)


if __name__ == "__main__":
    main()
