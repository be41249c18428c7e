"""The paper's figures and tables from a study's data: each a picture, the numbers in it, and the paper's own."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scenarios.files import written_whole

HYBRID, DEFAULT, COLLISION, OTHER = "#2f6db3", "#e07b1a", "#d7263d", "#b9bec4"
"""The paper's colours: blue is the hybrid planner, orange the default one, collisions are red."""
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Comparison:
    """One number beside the paper's."""

    what: str
    ours: str
    paper: str = ""


@dataclass(frozen=True)
class Exhibit:
    """One figure or table."""

    name: str
    """Of its files."""
    title: str
    text: str
    """What is to be seen."""
    figure: Figure
    data: Sequence[Row]
    """Rows of the CSV file; all have the same columns."""
    compared: Sequence[Comparison] = ()


def write_exhibit(folder: Path, exhibit: Exhibit) -> None:
    """Write the picture as PNG and PDF, and the data as CSV beside it."""
    for form in ("png", "pdf"):
        with written_whole(folder / f"{exhibit.name}.{form}") as file:
            exhibit.figure.savefig(file, format=form, metadata={"CreationDate": None} if form == "pdf" else None)
    write_csv(folder / f"{exhibit.name}.csv", exhibit.data)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows that have the same columns; None and not-a-number become empty cells."""
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    with written_whole(path) as file:
        file.write(table.getvalue().encode())


def _cell(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def new_figure(width: float, height: float) -> Figure:
    """An empty figure [in]."""
    figure = Figure(figsize=(width, height), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain(axes: Axes, title: str = "", x: str = "", y: str = "") -> Axes:
    """Axes in the house's style."""
    axes.set_title(title, loc="left", fontsize=9)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e3e6e8", linewidth=0.6)
    axes.set_axisbelow(True)
    return axes


def box_plot(axes: Axes, values: Sequence[np.ndarray], labels: Sequence[str], colors: Sequence[str]) -> None:
    """Box plots with whiskers at the 5th and 95th percentile, and a triangle at the mean."""
    drawn = axes.boxplot(
        list(values), tick_labels=list(labels), whis=(5, 95), showmeans=True, patch_artist=True, widths=0.55,
        flierprops={"marker": ".", "markersize": 2.5, "alpha": 0.4, "markeredgewidth": 0.0, "markerfacecolor": "black"},
        meanprops={"marker": "^", "markerfacecolor": "#2e9e6b", "markeredgecolor": "white", "markersize": 8},
        medianprops={"color": "black"},
    )  # fmt: skip
    for box, color in zip(drawn["boxes"], colors, strict=True):
        box.set(facecolor=color, alpha=0.55)
