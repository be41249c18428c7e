"""Generated scenarios as CommonRoad 2020a files, which read back to the same arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxfrenet as jf
from scenarios.document import document
from scenarios.errors import ScenarioError
from scenarios.lanelet_map import LaneletLinks, LaneletMap

DECIMALS = 7
"""Digits after the point: more than float32 coordinates have."""
PROBLEM_ID = 100000
FIRST_OBSTACLE_ID = 1000
TYPES = {
    jf.ObstacleKind.CAR: "car",
    jf.ObstacleKind.TRUCK: "truck",
    jf.ObstacleKind.BUS: "bus",
    jf.ObstacleKind.MOTORCYCLE: "motorcycle",
    jf.ObstacleKind.BICYCLE: "bicycle",
    jf.ObstacleKind.PEDESTRIAN: "pedestrian",
}
"""CommonRoad's names of what drives and walks in generated traffic."""


def commonroad_document(
    scenario: jf.Scenario, lanelet_map: LaneletMap, links: Sequence[LaneletLinks], benchmark_id: str
) -> bytes:
    """A generated scenario as the content of a CommonRoad file.

    Args:
      scenario: one scenario, not a batch.
      lanelet_map: of the same scenario.
      links: of the scenario's family.
      benchmark_id: the scenario's name by CommonRoad's rules, for example `ZAM_GenTjunction-1_1_T-1`.

    Raises:
      ScenarioError: commonroad-io is not installed.
    """
    about = {"source": "generated", "tag": "simulated", "decimals": DECIMALS}
    try:
        lanelets = [_lanelet(index, lanelet_map, links) for index in range(len(links))]
        obstacles, problem = _obstacles(scenario.obstacles), _problem(scenario, lanelet_map, lanelets)
        return document(benchmark_id, lanelets, obstacles, problem, **about)
    except ImportError:
        raise ScenarioError("writing CommonRoad files needs commonroad-io; install jaxfrenet[commonroad]") from None


def _lanelet(index: int, lanelet_map: LaneletMap, links: Sequence[LaneletLinks]) -> Any:
    from commonroad.scenario.lanelet import Lanelet

    left, right = (np.asarray(border[index], float) for border in (lanelet_map.left, lanelet_map.right))
    link = links[index]
    return Lanelet(
        left,
        0.5 * (left + right),
        right,
        index + 1,
        predecessor=[before + 1 for before, other in enumerate(links) if index in other.successors],
        successor=[after + 1 for after in link.successors],
        adjacent_left=None if link.left is None else link.left + 1,
        adjacent_left_same_direction=None if link.left is None else link.left_same_direction,
        adjacent_right=None if link.right is None else link.right + 1,
        adjacent_right_same_direction=None if link.right is None else True,
    )


def _obstacles(obstacles: jf.Obstacles) -> list[Any]:
    from commonroad.geometry.shape import Rectangle
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
    from commonroad.scenario.state import CustomState, InitialState
    from commonroad.scenario.trajectory import Trajectory

    found = []
    for index in np.flatnonzero(np.asarray(obstacles.valid).any(axis=1)):
        present = np.flatnonzero(np.asarray(obstacles.valid[index]))
        states = [
            {
                "time_step": int(step),
                "position": np.asarray(obstacles.position[index, step], float),
                "orientation": float(obstacles.heading[index, step]),
                "velocity": float(obstacles.speed[index, step]),
            }
            for step in present
        ]
        shape = Rectangle(float(obstacles.length[index]), float(obstacles.width[index]))
        initial = InitialState(**states[0], acceleration=0.0, yaw_rate=0.0, slip_angle=0.0)
        later: list[Any] = [CustomState(**state) for state in states[1:]]
        path = TrajectoryPrediction(Trajectory(later[0].time_step, later), shape) if later else None
        kind = ObstacleType(TYPES[jf.ObstacleKind(int(obstacles.kind[index]))])
        found.append(DynamicObstacle(FIRST_OBSTACLE_ID + int(index), kind, shape, initial, path))
    return found


def _problem(scenario: jf.Scenario, lanelet_map: LaneletMap, lanelets: list[Any]) -> Any:
    from commonroad.common.util import Interval
    from commonroad.geometry.shape import ShapeGroup
    from commonroad.planning.goal import GoalRegion
    from commonroad.planning.planning_problem import PlanningProblem
    from commonroad.scenario.state import CustomState, InitialState

    start, goal = scenario.initial_state, scenario.goal
    initial = InitialState(
        time_step=0,
        position=np.asarray(start.position, float),
        velocity=float(start.speed),
        orientation=float(start.heading),
        acceleration=float(start.acceleration),
        yaw_rate=float(start.yaw_rate),
        slip_angle=0.0,
    )
    where = [int(index) for index in np.flatnonzero(lanelet_map.is_goal)]
    first, last = (int(step) for step in goal.steps[0])
    wanted = CustomState(
        time_step=Interval(first, last),
        position=ShapeGroup([lanelets[index].polygon for index in where]),
        velocity=Interval(*(float(speed) for speed in goal.speed[0])),
    )
    return PlanningProblem(PROBLEM_ID, initial, GoalRegion([wanted], {0: [index + 1 for index in where]}))
