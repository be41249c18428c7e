"""The goal of a CommonRoad planning problem: regions and intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxfrenet import DT
from scenarios import polyline
from scenarios.lanelets import Lanelet, Network
from scenarios.polyline import Points
from scenarios.road import outline_edges

ANY_SPEED = (-1e3, 1e3)
ANY_HEADING = (0.0, 4.0)
"""Middle and half width [rad] of an interval that contains every direction."""


@dataclass(frozen=True)
class GoalState:
    """One of the goal's alternatives, in the local frame."""

    edges: NDArray[np.float64]
    """`[edges, end, xy]`, m, outline of the region; `[0, 2, 2]` if every position will do."""
    lanelets: tuple[int, ...]
    """Lanelets that the route may end on."""
    steps: tuple[int, int]
    speed: tuple[float, float] | None
    heading: tuple[float, float]
    """Middle and half width [rad]."""

    @property
    def has_position(self) -> bool:
        """Whether the goal state names a region."""
        return len(self.edges) > 0


def read_goal(goal: Any, network: Network, origin: Points, file_dt: float, start_step: int) -> list[GoalState]:
    """The goal states of a commonroad-io `GoalRegion`.

    Args:
      goal: the goal region.
      network: lanelets in the local frame.
      origin: `[2]`, m, of the local frame.
      file_dt: duration of the file's time steps [s].
      start_step: the file's step at which the closed loop starts.
    """
    states = []
    for index, state in enumerate(goal.state_list):
        named = (goal.lanelets_of_goal_position or {}).get(index, [])
        edges = region_edges(state.position, origin) if state.has_value("position") else np.zeros((0, 2, 2))
        heading = _heading(state.orientation) if state.has_value("orientation") else ANY_HEADING
        speed = _interval(state.velocity) if state.has_value("velocity") else None
        lanelets = _goal_lanelets(named, edges, heading, network) if len(edges) else ()
        states.append(GoalState(edges, lanelets, _steps(state.time_step, file_dt, start_step), speed, heading))
    return states


def region_edges(shape: Any, origin: Points) -> NDArray[np.float64]:
    """Outline `[edges, end, xy]`, m, of the union of a CommonRoad shape's parts, in the local frame."""
    import shapely

    return outline_edges(shapely.union_all([_polygon(part, origin) for part in getattr(shape, "shapes", [shape])]))


def _polygon(shape: Any, origin: Points) -> Any:
    import shapely

    if hasattr(shape, "shapes"):
        return shapely.union_all([_polygon(part, origin) for part in shape.shapes])
    if hasattr(shape, "radius"):
        return shapely.Point(np.asarray(shape.center) - origin).buffer(shape.radius, quad_segs=32)
    return shapely.make_valid(shapely.Polygon(np.asarray(shape.vertices, float)[:, :2] - origin))


def _interval(value: Any) -> tuple[float, float]:
    return (float(value.start), float(value.end)) if hasattr(value, "start") else (float(value), float(value))


def _heading(value: Any) -> tuple[float, float]:
    start, end = _interval(value)
    return 0.5 * (start + end), 0.5 * (end - start)


def _steps(time_step: Any, file_dt: float, start_step: int) -> tuple[int, int]:
    """First and last step of the closed loop inside the interval; the nearest step if there is none."""
    start, end = ((value - start_step) * file_dt / DT for value in _interval(time_step))
    first, last = math.ceil(start - 1e-6), math.floor(end + 1e-6)
    return (first, last) if first <= last else (round(start), round(start))


def _goal_lanelets(
    named: list[int], edges: NDArray[np.float64], heading: tuple[float, float], network: Network
) -> tuple[int, ...]:
    """The lanelets named in the file, else those under the region's centre, else all that it touches.

    Only those along the goal's direction, if there are any.
    """
    if named:
        return tuple(id_ for id_ in named if id_ in network)
    center = edges[:, 0].mean(axis=0)
    touched = [lane for lane in network.values() if _touches(lane, edges)]
    central = [lane for lane in touched if lane.contains(center)]
    aligned = {lane.id for lane in touched if _points_along(lane, center, heading)}
    for choice in (central, touched):
        if any(lane.id in aligned for lane in choice):
            return tuple(lane.id for lane in choice if lane.id in aligned)
    return tuple(lane.id for lane in central or touched)


def _touches(lane: Lanelet, edges: NDArray[np.float64]) -> bool:
    import shapely

    outline = shapely.make_valid(shapely.Polygon(lane.outline))
    meets = shapely.intersects(shapely.linestrings(edges), outline)
    return bool(np.any(meets)) or bool(polyline.contains(edges, lane.center_line[:1])[0])


def _points_along(lane: Lanelet, position: Points, heading: tuple[float, float]) -> bool:
    direction = polyline.heading_at(lane.center_line, position)
    return polyline.angle_between(direction, heading[0]) < heading[1] + 0.5 * np.pi


def arc_length_range(edges: NDArray[np.float64], arc_length: NDArray[np.float64], path: Points) -> tuple[float, float]:
    """Where a path enters and leaves a region [m]; if it misses it, where it passes the region's outline.

    Args:
      edges: `[edges, end, xy]`, m.
      arc_length: `[nodes]`, m.
      path: `[nodes, 2]`, m.
    """
    inside = arc_length[polyline.contains(edges, path)]
    along = inside if len(inside) else polyline.project(path, edges[:, 0])[0]
    return float(along.min()), float(along.max())
