"""The reference path of a route: the lanelets' centre lines, joined, prolonged and smoothed, as tables over arc length.

Smoothing minimises the squared deviation from the centre line plus a multiple of the squared third differences
(Whittaker 1923; Eilers 2003): the third derivative of the position is what makes curvature change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios import polyline
from scenarios.lanelets import Lanelet, Network
from scenarios.polyline import Points
from scenarios.route import end_heading, lane_change_length, straight_on

EXTENSION = 30.0
"""How far the path reaches beyond the ego's start and beyond the goal [m]."""
SPACING = 0.25
"""Distance between nodes [m]."""
SMOOTHING_SPACING = 0.5
SMOOTHING_MARGIN = 15.0
"""What is smoothed and then cut off at both ends [m], where smoothing has support on one side only."""
MAX_DEVIATIONS = (0.25, 0.35, 0.5)
"""How far smoothing may leave the centre line [m]; the next one is for paths that stay too sharp."""
COMFORTABLE_CURVATURE = 0.2
"""Above this the path is too sharp [1/m]; the vehicles turn at up to 0.7."""
HARDLY_ROUGH = 0.005
"""A centre line whose curvature never changes faster than this [1/m²] is kept."""
HARD_TO_STEER = 0.12
"""A centre line whose curvature changes faster than this somewhere [1/m²] is smoothed in any case."""
NOT_MUCH_ROUGHER = 6.0
"""A centre line whose curvature changes at most this many times as fast as the smoothed path's is kept."""


@dataclass(frozen=True)
class RoutePath:
    """Tables over arc length, float64, see `jaxfrenet.reference_path.ReferencePath`; all `[nodes]`."""

    arc_length: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    heading: NDArray[np.float64]
    curvature: NDArray[np.float64]
    curvature_derivative: NDArray[np.float64]

    @property
    def points(self) -> Points:
        """`[nodes, 2]`, m."""
        return np.stack([self.x, self.y], axis=1)


@dataclass(frozen=True)
class CenterLine:
    """The route's centre line before smoothing."""

    points: Points
    """`[points, 2]`, m."""
    start: float
    """Arc length [m] of the ego's start."""

    @property
    def length(self) -> float:
        """Arc length [m] of the last point."""
        return float(polyline.arc_lengths(self.points)[-1])


def center_line(network: Network, route: list[int], position: Points, speed: float) -> CenterLine:
    """Join the centre lines of a route and blend them where it changes lanes.

    Args:
      network: the lanelets.
      route: ids of lanelets, each a successor or a neighbour of the one before.
      position: `[2]`, m, of the ego at its start.
      speed: of the ego at its start [m/s].
    """
    pieces = []
    for index, side_by_side in enumerate(_stages(network, route)):
        lanelets = [network[id_] for id_ in side_by_side]
        along = polyline.project(lanelets[0].center_line, position[None])[0][0] if index == 0 else 0.0
        pieces.append(_blended(lanelets, float(along), lane_change_length(speed)))
    before = _predecessors(network, network[route[0]])
    points = polyline.without_repeats(np.concatenate([before, *pieces]), 1e-3)
    joint = polyline.arc_lengths(np.concatenate([before, pieces[0][:1]]))[-1]
    start = joint + polyline.project(pieces[0], position[None])[0][0]
    return CenterLine(points, float(start))


def _stages(network: Network, route: list[int]) -> list[list[int]]:
    """Group the route into runs of neighbouring lanelets; a run of one has no lane change."""
    stages = [[route[0]]]
    for before, after in zip(route, route[1:], strict=False):
        if after in network[before].successors:
            stages.append([after])
        else:
            stages[-1].append(after)
    return stages


def _blended(lanelets: list[Lanelet], start: float, length: float) -> Points:
    """Centre line that moves over from the first lanelet to the last, beginning at `start` [m].

    Neighbours cover the same stretch of road, so points at the same share of their lengths lie side by side.
    """
    if len(lanelets) == 1:
        return lanelets[0].center_line
    changes = len(lanelets) - 1
    total = lanelets[0].length
    end = min(start + changes * length, total)
    along = np.linspace(0.0, total, int(np.ceil(total)) + 1)
    progress = np.clip((along - start) / max(end - start, 1e-6), 0.0, 1.0) * changes
    lines = [polyline.at_arc_lengths(lanelet.center_line, along / total * lanelet.length) for lanelet in lanelets]
    blended = lines[0]
    for index, line in enumerate(lines[1:]):
        share = np.clip(progress - index, 0.0, 1.0)[:, None]
        blended = blended + share**3 * (10.0 - 15.0 * share + 6.0 * share**2) * (line - lines[index])
    return blended


def _predecessors(network: Network, first: Lanelet) -> Points:
    """Centre lines of the straightest predecessors, enough for the path's start; `[0, 2]` if there are none."""
    points, lanelet, missing = np.zeros((0, 2)), first, EXTENSION + SMOOTHING_MARGIN
    while lanelet.predecessors and missing > 0.0:
        heading = polyline.heading_at(lanelet.center_line, lanelet.center_line[0])
        turns = {id_: polyline.angle_between(end_heading(network[id_]), heading) for id_ in lanelet.predecessors}
        lanelet = network[min(turns, key=turns.__getitem__)]
        points = np.concatenate([lanelet.center_line, points])
        missing -= max(lanelet.length, 1.0)
    return points


def passes(line: CenterLine, edges: NDArray[np.float64]) -> float:
    """Arc length [m] at which the centre line has passed a region with that outline `[edges, end, xy]`."""
    inside = polyline.contains(edges, polyline.at_arc_lengths(line.points, along := np.arange(0.0, line.length, 0.5)))
    within = along[inside & (along >= line.start)]
    return float(within[-1]) if len(within) else line.length


def continued(line: CenterLine, network: Network, route: list[int], end: float) -> tuple[CenterLine, list[int]]:
    """Prolong the centre line and its route along the straightest successors to arc length `end` [m], if they reach."""
    missing = end + SMOOTHING_MARGIN - line.length
    more = straight_on(network, route[-1], missing)
    points = np.concatenate([line.points, *(network[id_].center_line for id_ in more)])
    return CenterLine(polyline.without_repeats(points, 1e-3), line.start), route + more


def reference_path(line: CenterLine, end: float) -> RoutePath:
    """Smooth the centre line and tabulate it from 30 m before the ego's start to arc length `end` [m] of `line`.

    Where the centre line is shorter, it is prolonged straight. A line that is smooth already is kept.
    """
    begin = line.start - EXTENSION
    along = np.arange(begin - SMOOTHING_MARGIN, end + SMOOTHING_MARGIN + SMOOTHING_SPACING, SMOOTHING_SPACING)
    points = polyline.at_arc_lengths(line.points, along)
    ends = polyline.at_arc_lengths(line.points, [begin, end])
    for max_deviation in MAX_DEVIATIONS:
        path = _evenly_spaced(smoothed(points, max_deviation), ends)
        if np.max(np.abs(path.curvature)) <= COMFORTABLE_CURVATURE:
            break
    drawn = _as_drawn(line, end)
    return drawn if _is_smooth(drawn, line, than=path) else path


def _as_drawn(line: CenterLine, end: float) -> RoutePath:
    """Tables of the curve through the centre line's own points, prolonged straight where it does not reach."""
    along = polyline.arc_lengths(line.points)
    behind = -np.arange(0.0, EXTENSION - line.start + 2.0)[:0:-1]
    beyond = along[-1] + np.arange(0.0, end - along[-1] + 2.0)[1:]
    curve, length = _by_arc_length(polyline.at_arc_lengths(line.points, np.concatenate([behind, along, beyond])))
    ends = polyline.at_arc_lengths(line.points, [line.start, end])
    start, last = polyline.project(curve(np.arange(0.0, length, SPACING)), ends)[0]
    nodes = np.arange(0.0, min(last, length) - start + EXTENSION, SPACING)
    x, y = curve(start - EXTENSION + nodes).T
    return tabulated(x, y, nodes)


def _is_smooth(path: RoutePath, line: CenterLine, than: RoutePath) -> bool:
    """Whether a path needs no smoothing: never far from the centre line, and not much rougher `than` a smoothed one."""
    away = np.linalg.norm(polyline.project(line.points, path.points)[1] - path.points, axis=1)
    on_line = (path.arc_length > EXTENSION) & (path.arc_length < EXTENSION + line.length - line.start)
    roughness, smoothed_roughness = (np.max(np.abs(one.curvature_derivative)) for one in (path, than))
    return bool(
        np.max(np.abs(path.curvature)) <= COMFORTABLE_CURVATURE
        and roughness <= max(HARDLY_ROUGH, min(HARD_TO_STEER, NOT_MUCH_ROUGHER * smoothed_roughness))
        and np.max(away[on_line], initial=0.0) <= MAX_DEVIATIONS[0]
    )


def _evenly_spaced(points: Points, ends: Points) -> RoutePath:
    """Tables of the smooth curve through `points`, from near the first to near the last of `ends` `[2, 2]`."""
    curve, length = _by_arc_length(points)
    first, last = polyline.project(points, ends)[0]
    nodes = np.arange(0.0, min(last, length) - first, SPACING)
    x, y = curve(first + nodes).T
    return tabulated(x, y, nodes)


def tabulated(x: NDArray[np.float64], y: NDArray[np.float64], arc_length: NDArray[np.float64]) -> RoutePath:
    """Heading, curvature and its derivative by central differences of evenly spaced points; all `[nodes]`."""

    def derivative(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.gradient(values, arc_length, edge_order=2)

    heading = np.unwrap(np.arctan2(derivative(y), derivative(x)))
    curvature = derivative(heading)
    return RoutePath(arc_length, x, y, heading, curvature, derivative(curvature))


def smoothed(points: Points, max_deviation: float) -> Points:
    """The smoothest curve that stays within `max_deviation` [m] of evenly spaced points.

    The penalty on third differences is the largest one that keeps the bound, to a factor of the square root of two.
    """
    normals = _normals(points)
    low, high = -10.0, 45.0
    best = points
    while high - low > 0.5:
        middle = 0.5 * (low + high)
        candidate = whittaker(points, 2.0**middle)
        if np.max(np.abs(np.sum((candidate - points) * normals, axis=1))) <= max_deviation:
            low, best = middle, candidate
        else:
            high = middle
    return best


def whittaker(points: Points, penalty: float) -> Points:
    """Minimise the squared distance to `points` plus `penalty` times the squared third differences."""
    from scipy.linalg import solveh_banded

    count = len(points)
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, count))
    for lag in range(4):
        for first in range(4 - lag):
            bands[lag, first : count - 3 + first] += penalty * stencil[first] * stencil[first + lag]
    bands[0] += 1.0
    return solveh_banded(bands, points, lower=True)


def _normals(points: Points) -> Points:
    tangents = np.gradient(points, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-9)
    return np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)


def _by_arc_length(points: Points) -> tuple[Callable[[NDArray[np.float64]], Points], float]:
    """The spline through `points` as a function of arc length [m], and its length [m]."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(polyline.arc_lengths(points), points)
    parameter = np.linspace(0.0, spline.x[-1], 8 * len(points))
    along = polyline.arc_lengths(spline(parameter))
    return lambda arc_length: spline(np.interp(arc_length, along, parameter)), float(along[-1])
