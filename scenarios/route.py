"""Which lanelets lead from the ego's start to its goal."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from scenarios import polyline
from scenarios.errors import ScenarioError
from scenarios.lanelets import Lanelet, Neighbor, Network
from scenarios.polyline import Points

LANE_CHANGE_COST = 20.0
"""Detour [m] that is as good as one lane change."""
SHORT_LANE_CHANGE_COST = 5.0
"""Detour [m] that is as good as one metre more for a lane change."""
MISALIGNMENT_COST = 30.0
"""Detour [m] that is as good as starting on a lanelet that is better aligned by one radian."""
OFFSET_COST = 6.0
"""Detour [m] that is as good as starting one metre nearer to a lanelet's centre line."""


SHORTEST_LANE_CHANGE = 30.0
"""Length of a lane change at low speed [m]."""
LANE_CHANGE_TIME = 3.0
"""Duration of a lane change at higher speed [s]."""


def lane_change_length(speed: float) -> float:
    """Length [m] that a comfortable lane change takes at `speed` [m/s]."""
    return max(SHORTEST_LANE_CHANGE, LANE_CHANGE_TIME * speed)


def start_lanelets(network: Network, position: Points, heading: float) -> dict[int, float]:
    """Lanelets under `position` `[2]`, only aligned ones if there are any, with what starting on each costs [m].

    Raises:
      ScenarioError: the position is outside every lanelet.
    """
    under = [lanelet for lanelet in network.values() if lanelet.contains(position)]
    if not under:
        raise ScenarioError("ego starts outside every lanelet; move it onto the road")
    angles = [polyline.angle_between(heading, polyline.heading_at(one.center_line, position)) for one in under]
    offsets = [np.linalg.norm(polyline.project(one.center_line, position[None])[1][0] - position) for one in under]
    costs = {
        lanelet.id: float(MISALIGNMENT_COST * angle + OFFSET_COST * offset)
        for lanelet, angle, offset in zip(under, angles, offsets, strict=True)
    }
    aligned = {lanelet.id: costs[lanelet.id] for lanelet, angle in zip(under, angles, strict=True) if angle < np.pi / 2}
    return aligned or costs


def shortest(
    network: Network, starts: dict[int, float], position: Points, speed: float, goals: Sequence[int]
) -> list[int]:
    """The cheapest route from any of `starts` to any of `goals`: ids of lanelets in driving order.

    Args:
      network: the lanelets.
      starts: lanelets to start on, and what each costs [m].
      position: `[2]`, where on them.
      speed: at the start [m/s].
      goals: lanelets to reach.

    Returns:
      Lanelets, each a successor or a neighbour of the one before.

    Raises:
      ScenarioError: there is no route.
    """
    import networkx

    graph = _graph(network, starts, position, speed)
    for goal in goals:
        graph.add_edge(goal, "goal", cost=0.0)
    try:
        return networkx.dijkstra_path(graph, "start", "goal", weight="cost")[1:-1]
    except (networkx.NetworkXNoPath, networkx.NodeNotFound):
        raise ScenarioError(
            f"no route from lanelet {_list(starts)} to the goal on lanelet {_list(goals) or '(none)'}; "
            "choose a goal that the road network reaches"
        ) from None


def _list(ids: Iterable[int]) -> str:
    ids = sorted(ids)
    return ", ".join(map(str, ids[:6])) + (", ..." if len(ids) > 6 else "")


def _graph(network: Network, starts: dict[int, float], position: Points, speed: float) -> Any:
    """The lanelet graph with the cost [m] of each step, and an extra node `"start"`."""
    import networkx

    graph = networkx.DiGraph()
    for lanelet in network.values():
        ahead = lanelet.length
        if lanelet.id in starts:
            ahead -= float(polyline.project(lanelet.center_line, position[None])[0][0])
        for successor in lanelet.successors:
            graph.add_edge(lanelet.id, successor, cost=ahead)
        for neighbor in _same_direction(lanelet):
            graph.add_edge(lanelet.id, neighbor.id, cost=_lane_change_cost(speed, ahead))
    for start, cost in starts.items():
        graph.add_edge("start", start, cost=cost)
    return graph


def _lane_change_cost(speed: float, available: float) -> float:
    """What a lane change at `speed` [m/s] costs [m] if `available` metres are left for it."""
    return LANE_CHANGE_COST + SHORT_LANE_CHANGE_COST * max(0.0, lane_change_length(speed) - available)


def _same_direction(lanelet: Lanelet) -> list[Neighbor]:
    return [side for side in (lanelet.left, lanelet.right) if side is not None and side.same_direction]


def furthest(network: Network, starts: dict[int, float], position: Points, speed: float, distance: float) -> list[int]:
    """A route of `distance` [m], as far as the road goes, with few turns and lane changes."""
    options = []
    for start, cost in starts.items():
        lanelet = network[start]
        behind = float(polyline.project(lanelet.center_line, position[None])[0][0])
        change_cost = _lane_change_cost(speed, lanelet.length - behind)
        beside = [(neighbor.id, change_cost) for neighbor in _same_direction(lanelet)]
        for first, change in [(start, 0.0), *beside]:
            missing, turning, route = ahead(network, first, distance + behind)
            rank = missing + MISALIGNMENT_COST * turning + cost + change
            options.append((rank, [start] * (first != start) + route))
    return min(options)[1]


def ahead(network: Network, first: int, distance: float) -> tuple[float, float, list[int]]:
    """Follow successors from the start of `first` for `distance` [m], as far as possible, then as straight as possible.

    Returns:
      The distance that is missing [m], the angle turned between lanelets [rad], and the lanelets including `first`.
    """

    @functools.cache
    def follow(id_: int, remaining: int) -> tuple[int, float, tuple[int, ...]]:
        lanelet = network[id_]
        # Whole metres bound the number of distinct calls; at least one is used up, so a circle ends.
        remaining -= max(round(lanelet.length), 1)
        if remaining <= 0 or not lanelet.successors:
            return max(remaining, 0), 0.0, (id_,)
        options = []
        for successor in lanelet.successors:
            missing, turning, route = follow(successor, remaining)
            turning += polyline.angle_between(end_heading(lanelet), end_heading(network[successor]))
            options.append((missing, turning, (id_, *route)))
        return min(options)

    missing, turning, route = follow(first, math.ceil(distance))
    return float(missing), turning, list(route)


def end_heading(lanelet: Lanelet) -> float:
    """Direction [rad] in which the lanelet ends."""
    return polyline.heading_at(lanelet.center_line, lanelet.center_line[-1])


def straight_on(network: Network, last: int, distance: float) -> list[int]:
    """The straightest successors of `last`, one after the other, for `distance` [m] or to the end of the road."""
    route, lanelet = [], network[last]
    while distance > 0.0 and lanelet.successors:
        heading = end_heading(lanelet)
        turns = {id_: polyline.angle_between(heading, end_heading(network[id_])) for id_ in lanelet.successors}
        lanelet = network[min(turns, key=turns.__getitem__)]
        route.append(lanelet.id)
        distance -= max(lanelet.length, 1.0)
    return route
