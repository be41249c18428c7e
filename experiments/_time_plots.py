"""Charts over time, beside the view of the road."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

import jaxfrenet as jf
from experiments._charts import Chart


class TimePlots:
    """Plots that grow with the episode."""

    def __init__(self, axes: Sequence[Axes], charts: Sequence[Chart]) -> None:
        """Set up one plot in each of the axes, from top to bottom."""
        longest = max(len(line.values) for chart in charts for line in chart.lines)
        self._times = jf.DT * np.arange(longest)
        self._series = [line.values for chart in charts for line in chart.lines]
        self._lines = []
        for ax, chart in zip(axes, charts, strict=True):
            compared = len({line.planner for line in chart.lines}) > 1
            for line in chart.lines:
                style = {
                    "linestyle": "--" if line.dashed else "-",
                    "linewidth": line.width,
                    "zorder": 3 - line.width / 9,
                }
                label = f"{line.label}, {line.planner}" if compared else line.label
                self._lines += ax.plot([], [], color=line.color, label=label, **style)
            self._style(ax, chart)
        for ax in axes[:-1]:
            ax.tick_params(labelbottom=False)
        axes[-1].set_xlabel("time [s]")

    def _style(self, axes: Axes, chart: Chart) -> None:
        axes.set_title(f"{chart.title} [{chart.unit}]" if chart.unit else chart.title, loc="left", fontsize=8, pad=3)
        axes.set_xlim(0.0, max(self._times[-1], jf.DT))
        axes.set_yscale("log" if chart.logarithmic else "linear")
        axes.set_ylim(*chart.limits)
        axes.grid(color="#e3e6e8", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        if len(chart.lines) > 1:
            place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.96)}
            axes.legend(fontsize=6, ncols=2, frameon=False, handlelength=1.5, columnspacing=1.0, **place)

    def show(self, step: int) -> None:
        """Show everything up to a step."""
        for line, series in zip(self._lines, self._series, strict=True):
            shown = series[: step + 1]
            line.set_data(self._times[: len(shown)], shown)
