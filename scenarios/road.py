"""The edge of the road surface, and which parts of it lie near each stretch of the reference path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxfrenet.road import BIN_LENGTH, CORRIDOR, REACH
from scenarios import polyline
from scenarios.lanelets import Lanelet, Neighbor, Network
from scenarios.polyline import Points

NO_WIDTH = 1e-9
"""Rings that enclose a strip narrower than this [m] are left over from rounding where lanelets share a bound."""


def surface_edge(network: Network) -> NDArray[np.float64]:
    """Outline of the road surface: line segments `[segments, end, xy]`, m, for the even-odd rule.

    The surface is the union of the road's lane sections, so that slivers between neighbouring lanelets belong to it,
    as they do for commonroad-drivability-checker.
    """
    import shapely

    sections = [shapely.make_valid(shapely.Polygon(ring)) for ring in lane_sections(network)]
    return outline_edges(shapely.union_all(sections))


def outline_edges(region: Any) -> NDArray[np.float64]:
    """Edges `[edges, end, xy]`, m, of all rings of a shapely geometry; what has no area is left out.

    Rings around the region run counter-clockwise, those around its holes clockwise, each from its corner with the
    smallest x on: one region has one outline, however it came about.
    """
    import shapely

    parts = [part for part in shapely.get_parts(region).tolist() if part.geom_type == "Polygon"]
    nested = [part for part in shapely.get_parts(region).tolist() if part.geom_type == "MultiPolygon"]
    parts += [polygon for part in nested for polygon in part.geoms]
    parts = [shapely.geometry.polygon.orient(part) for part in parts]
    closed = [ring for part in parts for ring in (part.exterior, *part.interiors)]
    rings = [_from_smallest_x(np.asarray(ring.coords)[:-1, :2]) for ring in closed
             if shapely.Polygon(ring).area > NO_WIDTH * ring.length]  # fmt: skip
    return np.concatenate([polyline.ring_edges(ring) for ring in rings]) if rings else np.zeros((0, 2, 2))


def _from_smallest_x(ring: Points) -> Points:
    return np.roll(ring, -np.argmin(ring[:, 0]), axis=0)


def lane_sections(network: Network) -> list[Points]:
    """Rings `[points, 2]`, m, around all lanelets that lie side by side, seen from each lanelet once."""
    rings, remaining = [], list(network)
    while remaining:
        row = _side_by_side(network, remaining.pop())
        remaining = [id_ for id_ in remaining if id_ not in {lanelet.id for lanelet, _ in row[1:]}]
        rings.append(_ring(row))
    return rings


def _side_by_side(network: Network, first: int) -> list[tuple[Lanelet, bool]]:
    """The lanelets beside `first` from right to left, and whether each has the direction of `first`."""
    rightmost = _outermost(network, network[first], forward=True, leftwards=False)[-1]
    return _outermost(network, *rightmost, leftwards=True)


def _outermost(network: Network, lanelet: Lanelet, forward: bool, leftwards: bool) -> list[tuple[Lanelet, bool]]:
    """Step to the left or right as long as there is a neighbour; stop where the neighbours form a circle."""
    row, seen = [(lanelet, forward)], {lanelet.id}
    while True:
        neighbor = _beside(lanelet, leftwards == forward)
        if neighbor is None or neighbor.id in seen:
            return row
        lanelet = network[neighbor.id]
        forward = forward == neighbor.same_direction
        seen.add(lanelet.id)
        row.append((lanelet, forward))


def _beside(lanelet: Lanelet, left: bool) -> Neighbor | None:
    return lanelet.left if left else lanelet.right


def _ring(row: list[tuple[Lanelet, bool]]) -> Points:
    """Around lanelets side by side, given from right to left: start points, left bound, end points, right bound."""
    bounds = [(one.right_bound, one.left_bound) if ahead else (one.left_bound[::-1], one.right_bound[::-1])
              for one, ahead in row]  # fmt: skip
    right, left = bounds[0][0], bounds[-1][1]
    starts = [right[0], *(left_bound[0] for _, left_bound in bounds)]
    ends = [right[-1], *(left_bound[-1] for _, left_bound in bounds)]
    return np.concatenate([starts, left[1:-1], ends[::-1], right[::-1][1:-1]])


def nearby_segments(
    path_arc_length: NDArray[np.float64], path: Points, segments: NDArray[np.float64]
) -> NDArray[np.int32]:
    """For each stretch of the path, the segments within `CORRIDOR + REACH` of it; see `jaxfrenet.scenario.Road`.

    Args:
      path_arc_length: `[nodes]`, m, from 0.
      path: `[nodes, 2]`, m.
      segments: `[segments, end, xy]`, m.

    Returns:
      `[bins, nearby]`, indices into `segments`, -1 is padding.
    """
    bins = int(path_arc_length[-1] / BIN_LENGTH) + 1
    step = 0.5 * BIN_LENGTH
    samples = polyline.at_arc_lengths(path, np.arange(2 * bins + 1) * step)
    near = _distances(samples, segments) <= CORRIDOR + REACH + 0.5 * step
    near = near[0:-1:2] | near[1::2] | near[2::2]
    count = max(int(np.max(np.sum(near, axis=1), initial=0)), 1)
    order = np.argsort(~near, axis=1, kind="stable")[:, :count].astype(np.int32)
    return np.where(np.take_along_axis(near, order, axis=1), order, -1).astype(np.int32)


def _distances(points: Points, segments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances [m] `[points, segments]`."""
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    relative = points[:, None] - start
    share = np.sum(relative * step, axis=-1) / np.maximum(np.sum(step**2, axis=-1), 1e-12)
    return np.linalg.norm(relative - np.clip(share, 0.0, 1.0)[..., None] * step, axis=-1)
