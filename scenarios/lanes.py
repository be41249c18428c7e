"""The ego's lane and its neighbours along the reference path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios import polyline
from scenarios.lanelets import Lanelet, Network
from scenarios.polyline import Points
from scenarios.route_path import RoutePath


def lane_tables(
    network: Network, route: list[int], path: RoutePath
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Centre offset [m], width [m] and direction of the own, left and right lane: each `[nodes, 3]`.

    Args:
      network: the lanelets.
      route: ids of the lanelets along the path, also beyond the goal.
      path: the reference path.
    """
    shape = (len(path.x), 3)
    center, width, direction = np.zeros(shape), np.zeros(shape), np.zeros(shape, np.int32)
    own = np.asarray(route)[_nearest_lanelet([network[id_] for id_ in route], path.points)]
    for id_ in set(route):
        nodes = np.flatnonzero(own == id_)
        if not len(nodes):
            continue
        lanelet = network[id_]
        sides = [(lanelet, 1)] + [
            (network[side.id], 1 if side.same_direction else -1) if side else (None, 0)
            for side in (lanelet.left, lanelet.right)
        ]
        for column, (lane, sign) in enumerate(sides):
            if lane is not None:
                center[nodes, column], width[nodes, column] = _offset_and_width(lane, path, nodes)
                direction[nodes, column] = sign
    return center, width, direction


def _nearest_lanelet(lanelets: list[Lanelet], points: Points) -> NDArray[np.intp]:
    """Index of the lanelet whose centre line is nearest to each point."""
    distances = [np.linalg.norm(polyline.project(lane.center_line, points)[1] - points, axis=1) for lane in lanelets]
    return np.argmin(distances, axis=0)


def _offset_and_width(lane: Lanelet, path: RoutePath, nodes: NDArray[np.intp]) -> tuple[NDArray, NDArray]:
    """Offset of the lane's centre from the path along its left normal, and the lane's width there [m]; `[nodes]`."""
    _, center = polyline.project(lane.center_line, path.points[nodes])
    heading = path.heading[nodes]
    away = center - path.points[nodes]
    offset = away[:, 1] * np.cos(heading) - away[:, 0] * np.sin(heading)
    sides = [polyline.project(bound, center)[1] - center for bound in (lane.left_bound, lane.right_bound)]
    return offset, np.linalg.norm(sides[0], axis=1) + np.linalg.norm(sides[1], axis=1)
