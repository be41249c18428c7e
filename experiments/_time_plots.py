"""Speed, cost and feasible share over time, beside the view of the road."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

import jaxfrenet as jf
from experiments._recording import Recording

SPEED, DESIRED, COST, SHARE = "#d7263d", "#5b6570", "#2f6db3", "#2e9e6b"


class TimePlots:
    """Three plots that grow with the episode."""

    def __init__(self, axes: Sequence[Axes], recording: Recording) -> None:
        """Set up the plots in three axes, from top to bottom."""
        reports = recording.reports
        driven = np.array([state.ego.speed for state in recording.states])
        desired = np.array([report.desired_speed for report in reports])
        costs = np.maximum([report.cost for report in reports], 1e-3)
        shares = 100.0 * np.array([report.feasible_share for report in reports])
        self._times = jf.DT * np.arange(len(driven))
        self._series = [driven, desired, costs, shares]
        speed, cost, share = axes
        self._lines = [
            speed.plot([], [], color=SPEED, linewidth=1.6, label="driven")[0],
            speed.plot([], [], color=DESIRED, linewidth=1.2, linestyle="--", label="desired")[0],
            cost.plot([], [], color=COST, linewidth=1.4)[0],
            share.plot([], [], color=SHARE, linewidth=1.4)[0],
        ]
        self._style(speed, "speed [m/s]", (0.0, 1.1 * max(driven.max(), desired.max(), 1.0)))
        speed.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=7, ncols=2, frameon=False)
        cost.set_yscale("log")
        self._style(cost, "chosen cost", (0.5 * costs.min(), 2.0 * costs.max()))
        self._style(share, "feasible [%]", (0.0, 105.0))
        share.set_xlabel("time [s]")
        for ax in (speed, cost):
            ax.tick_params(labelbottom=False)

    def _style(self, axes: Axes, title: str, limits: tuple[float, float]) -> None:
        axes.set_title(title, loc="left", fontsize=8, pad=3)
        axes.set_xlim(0.0, max(self._times[-1], jf.DT))
        axes.set_ylim(*limits)
        axes.grid(color="#e3e6e8", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)

    def show(self, step: int) -> None:
        """Show everything up to a step."""
        for line, series in zip(self._lines, self._series, strict=True):
            shown = series[: step + 1]
            line.set_data(self._times[: len(shown)], shown)
