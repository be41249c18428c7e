"""The learning curve: how validation went while a policy was trained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from experiments._exhibits import new_figure
from scenarios.files import written_whole

POLICY, DEFAULT = "#2f6db3", "#8a8a8a"
PANELS = (
    ("return", "mean return", False),
    ("outcome/goal_reached_in_time", "goal reached in time", False),
    ("mean_ego_risk", "mean ego risk", True),
)
"""Quantity, title, whether its axis is logarithmic."""


def draw_learning_curve(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Write `learning_curve` as a PNG file."""
    with written_whole(path) as file:
        learning_curve(lines).savefig(file, format="png")


def learning_curve(lines: Sequence[Mapping[str, Any]]) -> Figure:
    """Validations over environment steps: the mean of all runs, a band from the lowest to the highest of them.

    Args:
      lines: of the run's `metrics.jsonl`.
    """
    matplotlib.rcParams.update({"font.size": 9})
    figure = new_figure(10.0, 3.0)
    found = [line for line in lines if line["kind"] == "validation"]
    baseline = next((line for line in lines if line["kind"] == "baseline"), None)
    for axes, (name, title, is_log) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
        _panel(axes, name, found, baseline)
        axes.set_title(title, loc="left")
        axes.set_xlabel("environment steps")
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        if is_log and all(line.get(name) for line in found):
            axes.set_yscale("log")
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(frameon=False)
    return figure


def _panel(axes: Axes, name: str, found: Sequence[Mapping[str, Any]], baseline: Mapping[str, Any] | None) -> None:
    steps = sorted({line["step"] for line in found})
    if steps:
        values = [[line[name] for line in found if line["step"] == step and line[name] is not None] for step in steps]
        known = [(step, value) for step, value in zip(steps, values, strict=True) if value]
        at = [step for step, _ in known]
        axes.fill_between(at, [min(v) for _, v in known], [max(v) for _, v in known], color=POLICY, alpha=0.25, lw=0)
        runs = len({line["seed"] for line in found})
        label = "policy" if runs == 1 else f"policy, mean and range of {runs} runs"
        axes.plot(at, [float(np.mean(v)) for _, v in known], color=POLICY, label=label)
    if baseline is not None and baseline.get(name) is not None:
        axes.axhline(baseline[name], color=DEFAULT, ls="--", label="default weights")
