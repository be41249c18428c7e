"""What one telling scenario shows: speed, risk and weights over time, and both paths on the map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

import jaxfrenet as jf
from experiments._exhibits import COLLISION, DEFAULT, HYBRID, Comparison, Exhibit, Row, new_figure, plain
from experiments._scene import box_corners, draw_surroundings, kind_color
from experiments._study import WEIGHTS, Driven, column
from jaxfrenet.costs import CostWeights

STAMP_EVERY = 20
"""Steps between time stamps on a path."""
MARGIN = 12.0
"""m, around both paths on the map."""
LEAST_DRAWN = 1e-12
"""Smaller risks are drawn as this one."""


class Shown(NamedTuple):
    """The scenario that is shown, as both planners drove it."""

    name: str
    default: np.ndarray
    """`[steps + 1, columns]`, see `_study.track_of`."""
    hybrid: np.ndarray
    collided: dict[str, bool]
    """By planner."""

    def tracks(self) -> dict[str, np.ndarray]:
        """By planner."""
        return {"default": self.default, "hybrid": self.hybrid}


STYLE = {"default": ("DP", DEFAULT), "hybrid": ("HP", HYBRID)}


def shown(place: int, default: Driven, hybrid: Driven) -> Shown:
    """One scenario of a study."""
    rows = {"default": default.rows[place], "hybrid": hybrid.rows[place]}
    collided = {name: row["outcome"].startswith("collision") for name, row in rows.items()}
    return Shown(default.rows[place]["scenario"], default.tracks[place], hybrid.tracks[place], collided)


def speed_and_risk(one: Shown) -> Exhibit:
    """Speed and ego risk over time."""
    figure = new_figure(7.0, 4.4)
    top, bottom = figure.subplots(2, 1, sharex=True)
    plain(top, one.name, y="speed [m/s]")
    plain(bottom, x="time [s]", y="ego risk").set_yscale("log")
    for name, track in one.tracks().items():
        short, color = STYLE[name]
        risk = np.maximum(column(track, "ego_risk"), LEAST_DRAWN)
        top.plot(_times(track), column(track, "speed"), color=color, label=short)
        bottom.plot(_times(track), risk, color=color, label=short)
        if one.collided[name]:
            _cross(top, _times(track)[-1], column(track, "speed")[-1])
            _cross(bottom, _times(track)[-1], np.nanmax(risk[-2:]))
    top.legend(fontsize=8)
    names = "speed", "offset", "ego_risk", "third_party_risk", "unweighted_cost"
    compared = [
        Comparison(f"largest ego risk, {STYLE[name][0]}", f"{np.nanmax(column(track, 'ego_risk')):.3g}")
        for name, track in one.tracks().items()
    ]
    text = (
        f"In {one.name}, {_why(one)}. A red cross marks a collision; risks below {LEAST_DRAWN:g} are drawn there. The "
        "paper shows the same of a scenario of its own."
    )
    return Exhibit("speed_and_risk", "Speed and ego risk over time", text, figure, _rows(one, names), compared)


def _why(one: Shown) -> str:
    if one.collided["default"]:
        return "in which the default planner collides" + (", as the hybrid one does" * one.collided["hybrid"])
    return "in which the default planner's risk is largest; it collides in no scenario"


def _times(track: np.ndarray) -> np.ndarray:
    return jf.DT * np.arange(len(track))


def _cross(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], marker="x", color=COLLISION, markersize=10, markeredgewidth=2.5, zorder=10)


def _rows(one: Shown, names: tuple[str, ...]) -> list[Row]:
    return [
        {"planner": name, "time": float(f"{time:.6g}")} | {what: column(track, what)[step] for what in names}
        for name, track in one.tracks().items()
        for step, time in enumerate(_times(track))
    ]


def paths(one: Shown, scenario: jf.Scenario, vehicle: jf.Vehicle) -> Exhibit:
    """Both paths on the map.

    Args:
      one: what was driven.
      scenario: where; NumPy arrays without a batch axis.
      vehicle: that drove.
    """
    figure = new_figure(7.0, 5.6)
    axes = figure.subplots()
    draw_surroundings(axes, scenario)
    moment = int(np.nanargmax(column(one.default, "ego_risk")))
    _draw_traffic(axes, scenario, moment)
    for name, track in one.tracks().items():
        short, color = STYLE[name]
        x, y = column(track, "x"), column(track, "y")
        axes.plot(x, y, color=color, linewidth=4.0 if name == "default" else 2.0, label=short, zorder=6)
        _stamp(axes, track, color, above=name == "hybrid")
        _draw_ego(axes, track, min(moment, len(track) - 1), vehicle, color)
        if one.collided[name]:
            _cross(axes, x[-1], y[-1])
    _frame(axes, one)
    text = (
        f"The rear axle's paths in {one.name}, with the time [s] along them. Boxes are the vehicles at "
        f"{jf.DT * moment:.1f} s, when the default planner's risk is largest: traffic in the colours of its kinds, DP "
        "orange, HP blue. A red cross marks a collision."
    )
    return Exhibit("paths", "Paths on the map", text, figure, _rows(one, ("x", "y")))


def _draw_traffic(axes: Axes, scenario: jf.Scenario, step: int) -> None:
    obstacles = scenario.obstacles
    now = min(step, obstacles.valid.shape[1] - 1)
    for place in np.flatnonzero(np.asarray(obstacles.valid)[:, now]):
        corners = box_corners(
            np.asarray(obstacles.position)[place, now], np.asarray(obstacles.heading)[place, now],
            np.asarray(obstacles.length)[place], np.asarray(obstacles.width)[place],
        )  # fmt: skip
        color = kind_color(np.asarray(obstacles.kind)[place])
        axes.fill(*corners.T, facecolor=color, edgecolor="white", linewidth=0.6, alpha=0.8, zorder=5)


def _draw_ego(axes: Axes, track: np.ndarray, step: int, vehicle: jf.Vehicle, color: str) -> None:
    position = np.stack([column(track, "x"), column(track, "y")], axis=-1)
    ahead = position[min(step + 1, len(track) - 1)] - position[max(step - 1, 0)]
    heading = np.arctan2(ahead[1], ahead[0])
    center = position[step] + vehicle.rear_axle_to_center * np.array([np.cos(heading), np.sin(heading)])
    corners = box_corners(center, heading, vehicle.length, vehicle.width)
    axes.fill(*corners.T, facecolor=color, edgecolor="black", linewidth=0.8, alpha=0.85, zorder=7)


def _stamp(axes: Axes, track: np.ndarray, color: str, *, above: bool) -> None:
    at = np.arange(0, len(track), STAMP_EVERY)
    x, y = column(track, "x")[at], column(track, "y")[at]
    axes.plot(x, y, ".", color=color, markersize=6, zorder=8)
    for step, here, there in zip(at, x, y, strict=True):
        axes.annotate(
            f"{jf.DT * step:.0f}", (here, there), xytext=(0, 6 if above else -12), textcoords="offset points",
            color=color, fontsize=7, ha="center", zorder=9,
        )  # fmt: skip


def _frame(axes: Axes, one: Shown) -> None:
    for axis, limits in (("x", axes.set_xlim), ("y", axes.set_ylim)):
        every = np.concatenate([column(track, axis) for track in one.tracks().values()])
        limits(every.min() - MARGIN, every.max() + MARGIN)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(one.name, loc="left", fontsize=9)
    axes.legend(fontsize=8)


def weights(one: Shown) -> Exhibit:
    """How the hybrid planner's weights move over the episode."""
    every = {name: column(one.hybrid, name) for name in WEIGHTS}
    every = {name: values for name, values in every.items() if np.isfinite(values).any()}
    defaults = {name: getattr(CostWeights(), name.removeprefix("weight_")) or 0.0 for name in every}
    figure = new_figure(7.0, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True)
    plain(top, one.name, y="weight")
    plain(bottom, x="time [s]", y="weight of prediction")
    for name in every:
        axes = bottom if name == "weight_prediction" else top
        axes.plot(_times(one.hybrid), every[name], label=name.removeprefix("weight_").replace("_", " "))
    for axes in (top, bottom):
        axes.legend(fontsize=7)
        for level in {defaults[name] for name in every if (axes is bottom) == (name == "weight_prediction")}:
            axes.axhline(level, color="#8a8a8a", linestyle="--", linewidth=0.9)
    data = [
        {"time": float(f"{time:.6g}")} | {name: values[step] for name, values in every.items()}
        for step, time in enumerate(_times(one.hybrid))
    ]
    text = f"The weights that the policy sets in {one.name}; dashed are the default planner's."
    return Exhibit("weights", "Weights over an episode", text, figure, data, _ranges(every, defaults))


def _ranges(every: Mapping[str, np.ndarray], defaults: Mapping[str, float]) -> list[Comparison]:
    def told(name: str) -> Any:
        values = every[name][np.isfinite(every[name])]
        return f"{values.min():.3g} to {values.max():.3g} (default {defaults[name]:g})"

    return [Comparison(name.removeprefix("weight_").replace("_", " "), told(name)) for name in every]
