"""One scenario from above: colours, surface, goal, lane, reference path, boxes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, SupportsInt

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Transform

import jaxfrenet as jf
from experiments._outlines import filled_area

OFF_ROAD, SURFACE, EDGE = "#eef0ea", "#d3d7dc", "#8b939c"
PATH, GOAL, EGO = "#5b6570", "#2e9e6b", "#d7263d"
OTHER_EGO = "#1b1f24"
"""The ego as another planner drives it."""
KIND_COLORS = {
    jf.ObstacleKind.CAR: "#2f6db3",
    jf.ObstacleKind.TRUCK: "#7b4fa3",
    jf.ObstacleKind.BUS: "#7b4fa3",
    jf.ObstacleKind.MOTORCYCLE: "#c77d1e",
    jf.ObstacleKind.BICYCLE: "#c77d1e",
    jf.ObstacleKind.PEDESTRIAN: "#c2417c",
    jf.ObstacleKind.PARKED_VEHICLE: "#5e6b78",
}
OTHER_KIND_COLOR = "#5e6b78"


def kind_color(kind: SupportsInt) -> str:
    """The colour of an `ObstacleKind`."""
    return KIND_COLORS.get(jf.ObstacleKind(int(kind)), OTHER_KIND_COLOR)


def kinds_in(obstacles: jf.Obstacles) -> set[jf.ObstacleKind]:
    """The kinds of all obstacles that are there at any time."""
    return {jf.ObstacleKind(int(kind)) for kind in np.asarray(obstacles.kind)[np.asarray(obstacles.valid).any(-1)]}


def kind_handles(kinds: Iterable[jf.ObstacleKind]) -> list[Patch]:
    """A legend's entries for kinds of obstacles; kinds of one colour share an entry."""
    labels: dict[str, list[str]] = {}
    for kind in sorted(kinds):
        labels.setdefault(kind_color(kind), []).append(kind.name.lower().replace("_", " "))
    return [Patch(color=color, label=", ".join(names)) for color, names in labels.items()]


def surroundings_handles() -> list[Patch | Line2D]:
    """A legend's entries for what `draw_surroundings` draws besides the road."""
    return [
        Line2D([], [], color=PATH, linewidth=1.0, dashes=(4, 3), label="reference path"),
        Patch(facecolor=to_rgba(GOAL, 0.25), edgecolor=GOAL, label="goal"),
    ]


def box_corners(center, heading, length, width) -> np.ndarray:
    """Corners `[..., 4, 2]` of oriented boxes with centres `[..., 2]`; in metres and radians."""
    along = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * np.asarray(length)[..., None] / 2
    across = np.stack([-np.sin(heading), np.cos(heading)], axis=-1) * np.asarray(width)[..., None] / 2
    front, rear = center + along, center - along
    return np.stack([front + across, front - across, rear - across, rear + across], axis=-2)


def draw_surroundings(axes: Axes, scenario: jf.Scenario, transform: Transform | None = None) -> None:
    """Draw what stays as it is: road surface, goal region, borders of the route's lane, reference path.

    Args:
      axes: what is drawn into.
      scenario: one scenario, without a batch axis.
      transform: from metres to the picture, in place of the axes' own.
    """
    place: dict[str, Any] = {"transform": transform or axes.transData}
    axes.set_facecolor(OFF_ROAD)
    axes.set_aspect("equal")
    surface = surface_area(scenario)
    if surface is not None:
        axes.add_patch(PathPatch(surface, facecolor=SURFACE, edgecolor=EDGE, linewidth=1.0, zorder=1, **place))
    region = goal_area(scenario)
    if region is not None:
        shade = to_rgba(GOAL, 0.25)
        axes.add_patch(PathPatch(region, facecolor=shade, edgecolor=GOAL, linewidth=1.0, zorder=2, **place))
    borders = LineCollection(lane_borders(scenario), colors="white", linewidths=1.0, zorder=1.5, **place)
    axes.add_collection(borders, autolim=False)
    axes.plot(*path_line(scenario).T, color=PATH, linewidth=1.0, dashes=(6, 4), zorder=2.5, **place)


def surface_area(scenario: jf.Scenario) -> Path | None:
    """The road's surface; None where the scenario has none."""
    return filled_area(np.asarray(scenario.road.segments)[np.asarray(scenario.road.valid)])


def goal_area(scenario: jf.Scenario) -> Path | None:
    """The goal's region; None where every position will do."""
    goal = scenario.goal
    return filled_area(np.asarray(goal.edges)[np.asarray(goal.edge_valid & np.asarray(goal.valid)[:, None])])


def path_line(scenario: jf.Scenario) -> np.ndarray:
    """The reference path `[nodes, xy]`, m."""
    path = scenario.path
    return np.stack([path.x, path.y], axis=-1)[np.asarray(path.arc_length <= path.length)]


def lane_borders(scenario: jf.Scenario) -> list[np.ndarray]:
    """Both borders of the route's lane along the reference path `[nodes, xy]`, m; not a number where it has none."""
    path, lanes = scenario.path, scenario.lanes
    heading, center = np.asarray(path.heading), np.asarray(lanes.center)[:, 0]
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    exists = (np.asarray(lanes.direction)[:, 0] != 0) & np.asarray(path.arc_length <= path.length)
    points = np.stack([path.x, path.y], axis=-1)
    offsets = [np.where(exists, center + side * np.asarray(lanes.width)[:, 0], np.nan) for side in (-0.5, 0.5)]
    return [points + offset[:, None] * normal for offset in offsets]
