"""What is charted over an episode: speed, risk, weights, costs; of one planner, or of two beside each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from experiments._recording import Recording
from experiments._scene import EGO, OTHER_EGO

PLANNER_COLORS = EGO, OTHER_EGO
"""Of the planner that is shown, and of the one that it is compared with."""
PLANNER_WIDTHS = 1.5, 2.6
"""Widths of their lines: the second planner's lie below the first's and remain visible where both do the same."""
TERM_COLORS = "#2f6db3", "#c77d1e", "#2e9e6b", "#7b4fa3", "#c2417c", "#0b8793", "#8a6d3b", "#5e6b78"
DECADES = 1e6
"""A logarithmic axis ends this factor below its largest value: what lies farther below does not matter."""


class Line(NamedTuple):
    """One curve."""

    label: str
    planner: str
    color: str
    values: np.ndarray
    """`[steps]` or `[steps + 1]`, from the first step on."""
    dashed: bool = False
    width: float = PLANNER_WIDTHS[0]


class Chart(NamedTuple):
    """Curves over time that share an axis."""

    title: str
    unit: str
    """Empty for numbers without one."""
    logarithmic: bool
    lines: list[Line]

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper end of the axis."""
        values = np.concatenate([np.asarray(line.values, float) for line in self.lines])
        if not self.logarithmic:
            return 1.1 * min(values.min(), 0.0), 1.1 * max(values.max(), 0.1)
        positive = values[values > 0.0]
        if not len(positive):
            return 0.1, 1.0
        return 0.5 * max(positive.min(), positive.max() / DECADES), 2.0 * positive.max()


def film_charts(recordings: Sequence[Recording]) -> list[Chart]:
    """What stands beside an animation."""
    return [speed(recordings), risk(recordings), cost(recordings), feasible_share(recordings)]


def player_charts(recordings: Sequence[Recording]) -> list[Chart]:
    """What stands beside the player's road."""
    every = speed, risk, weights, cost_terms, offset, feasible_share
    return [chart(recordings) for chart in every]


def speed(recordings: Sequence[Recording]) -> Chart:
    """Driven and desired speed."""
    driven = _per_planner(recordings, "driven", lambda one: [state.ego.speed for state in one.states])
    desired = _per_planner(recordings, "desired", lambda one: [report.desired_speed for report in one.reports], True)
    return Chart("speed", "m/s", False, [*driven, *desired])


def risk(recordings: Sequence[Recording]) -> Chart:
    """Risk of the driven trajectories to the ego and to others."""
    ego = _per_planner(recordings, "ego", lambda one: [report.ego_risk for report in one.reports])
    others = _per_planner(
        recordings, "third party", lambda one: [report.third_party_risk for report in one.reports], True
    )
    return Chart("risk", "", True, [*ego, *others])


def cost(recordings: Sequence[Recording]) -> Chart:
    """Weighted cost of the chosen trajectories."""
    return Chart("chosen cost", "", True, _total(recordings))


def cost_terms(recordings: Sequence[Recording]) -> Chart:
    """What the cost of the chosen trajectories is made of: terms times weights."""
    terms = _per_term(recordings, lambda one: [report.costs * report.weights for report in one.reports])
    return Chart("chosen cost, by terms", "", True, [*_total(recordings), *terms])


def weights(recordings: Sequence[Recording]) -> Chart:
    """Weights of the cost terms."""
    return Chart("weights", "", True, _per_term(recordings, lambda one: [report.weights for report in one.reports]))


def offset(recordings: Sequence[Recording]) -> Chart:
    """Distance to the reference path, positive to its left."""
    lines = _per_planner(recordings, "offset", lambda one: [state.ego.offset for state in one.states])
    return Chart("offset from the path", "m", False, lines)


def feasible_share(recordings: Sequence[Recording]) -> Chart:
    """Share of the sampled trajectories that can be driven."""
    lines = _per_planner(recordings, "share", lambda one: [100.0 * report.feasible_share for report in one.reports])
    return Chart("feasible", "%", False, lines)


def _total(recordings: Sequence[Recording]) -> list[Line]:
    return _per_planner(recordings, "total", lambda one: [report.cost for report in one.reports])


def _per_planner(
    recordings: Sequence[Recording], label: str, values: Callable[[Recording], Sequence], dashed: bool = False
) -> list[Line]:
    """One line per planner, in its colour."""
    return [
        Line(label, one.planner, color, np.asarray(values(one)), dashed, width)
        for one, color, width in zip(recordings, PLANNER_COLORS, PLANNER_WIDTHS, strict=False)
    ]


def _per_term(recordings: Sequence[Recording], values: Callable[[Recording], Sequence]) -> list[Line]:
    """One line per cost term, in its colour; dashed for the second planner."""
    names = list(dict.fromkeys(name for one in recordings for name in one.terms))
    lines = []
    for place, one in enumerate(recordings):
        table = np.asarray(values(one))
        for name, column in zip(one.terms, table.T, strict=True):
            color = TERM_COLORS[names.index(name) % len(TERM_COLORS)]
            lines.append(Line(name.replace("_", " "), one.planner, color, column, dashed=place > 0))
    return lines
