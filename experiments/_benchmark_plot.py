"""The benchmark's picture: time per planning cycle against batch size and against trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

SERIES = (
    ("ms_per_cycle", "jaxfrenet", "#0072b2", "o", "-"),
    ("reference_serial_ms", "reference, serial", "#d55e00", "s", "--"),
    ("reference_concurrent_ms", "reference, concurrent", "#cc79a7", "^", ":"),
)
"""Field, name, colour, marker and line of each; the colours stay apart for the colour-blind (Okabe and Ito)."""


def draw_benchmark(batches: Sequence[dict[str, Any]], trajectories: Sequence[dict[str, Any]], machine: str) -> Figure:
    """Two panels, both axes logarithmic.

    Args:
      batches: rows of the results that differ in their batch only.
      trajectories: rows that differ in their trajectories only.
      machine: its name.
    """
    with matplotlib.rc_context({"font.size": 9, "axes.edgecolor": "#8b939c", "axes.linewidth": 0.8}):
        figure = Figure(figsize=(9.0, 4.0), dpi=120, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2, sharey=True)
        _draw_panel(left, batches, "batch", "scenarios in a batch")
        _draw_panel(right, trajectories, "trajectories", "trajectories per planning cycle")
        left.set_ylabel("time per planning cycle [ms]")
        left.legend(frameon=False)
        figure.suptitle(machine, fontsize=8, color="#5b6570")
    return figure


def _draw_panel(axes: Axes, rows: Sequence[dict[str, Any]], field: str, label: str) -> None:
    """Times of rows that differ in one field; nothing without rows."""
    if not rows:
        axes.set_axis_off()
        return
    rows = sorted(rows, key=lambda row: row[field])
    for key, name, color, marker, line in SERIES:
        points = [(row[field], row[key]) for row in rows if row[key] is not None]
        if points:
            axes.plot(*zip(*points, strict=True), line, color=color, marker=marker, markersize=5, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator([row[field] for row in rows]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel(label)
    axes.set_title(_common(rows[0], field), loc="left", fontsize=9, pad=6)
    axes.grid(color="#e3e6e8", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _common(row: dict[str, Any], field: str) -> str:
    """What rows that differ in one field have in common, in words."""
    rest = f"{row['trajectories']:,} trajectories" if field == "batch" else f"batch of {row['batch']}"
    return f"{row['obstacles']} obstacles, {row['layout']}; {rest}"
