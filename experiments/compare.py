"""Compare scenarios from files with generated ones: speeds, distances to the goal, gaps in the traffic."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from tqdm import tqdm

import scenarios
from experiments._scenario_statistics import QUANTILES, QUANTITIES, ks_distance, scenario_statistics
from experiments._sources import GeneratorOptions, load_files
from scenarios.command_line import prepare_folder, run_command
from scenarios.families import generate
from scenarios.files import written_whole

COLORS = {"files": "#2f6db3", "generated": "#d7263d"}
TITLES = {"files": "from files", "generated": "generated"}
Samples = dict[str, np.ndarray]
"""All values of each quantity."""


@dataclass(frozen=True, kw_only=True)
class CompareOptions(GeneratorOptions):
    """Compare scenarios from files with generated ones: a table, compare.json and a picture."""

    scenarios: tuple[Path, ...]
    """CommonRoad files, folders or .tar.xz/.zip archives of them, or .npz sets."""
    generate: int = 400
    """How many scenarios to generate."""
    preset: str = "commonroad"
    """What they are drawn from: default, hard or, for T-junctions, commonroad (like CommonRoad's own)."""
    out: Path = Path("runs/compare")
    """Folder for the results."""


def compare(options: CompareOptions) -> None:
    """Read the files, generate the scenarios, and write and print how their quantities are distributed."""
    draw = options.draw().checked()
    files = load_files(options.scenarios)
    folder = prepare_folder(options.out)
    samples = {"files": _samples(files), "generated": _samples(generate(draw))}
    results = {
        "files": {"scenarios": [str(path) for path in options.scenarios], "count": len(files)},
        "generated": draw._asdict(),
        "quantities": {name: _compared(name, samples) for name in QUANTITIES},
    }
    with written_whole(folder / "compare.json") as file:
        file.write(json.dumps(results, indent=1).encode() + b"\n")
    with written_whole(folder / "compare.png") as file:
        counts = {source: results[source]["count"] for source in COLORS}
        _picture(samples, results["quantities"], counts).savefig(file, format="png")
    print("\n".join(_table(results["quantities"])))
    print(f"written to {folder / 'compare.json'} and compare.png")


def _samples(found: scenarios.ScenarioSet) -> Samples:
    every = [scenario_statistics(one) for one in tqdm(found.scenarios, "measuring", unit=" scenarios", delay=5.0)]
    return {name: np.concatenate([one[name] for one in every]) for name in QUANTITIES}


def _compared(name: str, samples: dict[str, Samples]) -> dict[str, Any]:
    """One quantity of both sources, as JSON can hold it."""
    title, unit = QUANTITIES[name]
    ks = ks_distance(*(sample[name] for sample in samples.values()))
    return {"title": title, "unit": unit, "ks_distance": ks} | {
        source: {"count": len(sample[name]), "quantiles": _quantiles(sample[name])}
        for source, sample in samples.items()
    }


def _quantiles(values: np.ndarray) -> dict[str, float] | None:
    """Rounded to 0.001; None where there is no value."""
    if not len(values):
        return None
    found = np.percentile(values, QUANTILES)
    return {f"{share}%": round(float(value), 3) for share, value in zip(QUANTILES, found, strict=True)}


def _table(quantities: dict[str, Any]) -> list[str]:
    """Two lines per quantity: the quantiles of each source."""
    lines = [f"{'':<34}{'':<10}" + "".join(f"{share}%".rjust(8) for share in QUANTILES) + f"{'KS':>8}"]
    for one in quantities.values():
        ks = "" if one["ks_distance"] is None else f"{one['ks_distance']:8.3f}"
        for source, title, end in (("files", f"{one['title']} [{one['unit']}]", ks), ("generated", "", "")):
            shown = one[source]["quantiles"] or {}
            lines.append(f"{title:<34}{source:<10}" + "".join(f"{value:8.2f}" for value in shown.values()) + end)
    return lines


def _picture(samples: dict[str, Samples], quantities: dict[str, Any], counts: dict[str, int]) -> Figure:
    """The cumulative distributions of all quantities, and a legend with the numbers of scenarios."""
    with matplotlib.rc_context({"font.size": 8, "axes.edgecolor": "#8b939c", "axes.linewidth": 0.8}):
        figure = Figure(figsize=(10.4, 5.6), dpi=100, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        *plots, last = figure.subplots(2, 3).flat
        for axes, (name, one) in zip(plots, quantities.items(), strict=True):
            _draw_distributions(axes, name, one, samples)
        last.axis("off")
        handles = [
            Line2D(
                [], [], marker="o", color=color, markersize=3.5, label=f"{counts[source]} scenarios {TITLES[source]}"
            )
            for source, color in COLORS.items()
        ]
        title = "share of values that are not larger\nKS: largest difference between the shares\n"
        last.legend(handles=handles, title=title, loc="center left", frameon=False, fontsize=9, alignment="left")
    return figure


def _draw_distributions(axes: Axes, name: str, one: dict[str, Any], samples: dict[str, Samples]) -> None:
    """Cumulative distributions of one quantity, with a dot at each quantile."""
    for source, color in COLORS.items():
        values = np.sort(samples[source][name])
        if len(values):
            axes.step(values, np.arange(1, len(values) + 1) / len(values), color=color, linewidth=1.4, where="post")
            axes.plot(np.percentile(values, QUANTILES), np.array(QUANTILES) / 100, "o", color=color, markersize=3.5)
    ks = "" if one["ks_distance"] is None else f"    KS {one['ks_distance']:.2f}"
    axes.set_title(f"{one['title']} [{one['unit']}]{ks}", loc="left", fontsize=8, pad=4)
    axes.set_ylim(-0.03, 1.03)
    axes.set_yticks(np.array(QUANTILES) / 100, [f"{share} %" for share in QUANTILES])
    axes.grid(color="#e3e6e8", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(CompareOptions, compare, "experiments.compare", arguments)


if __name__ == "__main__":
    main()
