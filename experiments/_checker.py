"""CommonRoad's own verdict on one solution file; for processes of its own, as the checker litters stderr at exit."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Verdict:
    """What commonroad-io and the drivability checker say of a solution."""

    obstacle_collision: bool
    road_collision: bool
    goal_reached: bool
    states: int
    feasible: bool | None = None
    """Whether a kinematic single-track car can drive every transition; None if not asked."""


def quieten() -> None:
    """Send this process's stderr nowhere: the checker prints pages of harmless notices at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")


def check_solution(scenario_text: bytes, solution: Path, feasibility: bool) -> Verdict:
    """Check a solution file against its scenario.

    Args:
      scenario_text: the CommonRoad file.
      solution: the solution file.
      feasibility: whether to check every transition too, which takes seconds.
    """
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.common.solution import CommonRoadSolutionReader
    from commonroad.common.util import FileFormat
    from commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch import create_collision_checker
    from commonroad_dc.feasibility.vehicle_dynamics import VehicleDynamics

    scenario, problems = CommonRoadFileReader(scenario_text, FileFormat.XML).open()
    driven = CommonRoadSolutionReader.open(str(solution)).planning_problem_solutions[0]
    trajectory, dynamics = driven.trajectory, VehicleDynamics.from_model(driven.vehicle_model, driven.vehicle_type)
    ego = _occupancy(trajectory, dynamics.shape)
    return Verdict(
        obstacle_collision=create_collision_checker(scenario).collide(ego),
        road_collision=_road_edge(scenario).collide(ego),
        goal_reached=bool(problems.planning_problem_dict[driven.planning_problem_id].goal_reached(trajectory)[0]),
        states=len(trajectory.state_list),
        feasible=_is_feasible(trajectory, dynamics, scenario.dt) if feasibility else None,
    )


def _is_feasible(trajectory: Any, dynamics: Any, dt: float) -> bool:
    """Whether every transition can be driven; a trajectory of one state has none."""
    from commonroad_dc.feasibility.feasibility_checker import trajectory_feasibility

    return len(trajectory.state_list) < 2 or bool(trajectory_feasibility(trajectory, dynamics, dt)[0])


def _occupancy(trajectory: Any, shape: Any) -> Any:
    """The ego's boxes over time, as the checker's solution check builds them."""
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch import create_collision_object

    return create_collision_object(TrajectoryPrediction(trajectory=trajectory, shape=shape))


def _road_edge(scenario: Any) -> Any:
    from commonroad_dc.boundary import boundary
    from commonroad_dc.pycrcc import CollisionChecker

    outside: Any = boundary.create_road_boundary_obstacle(
        scenario, method="aligned_triangulation", axis=2, return_scenario_obstacle=False
    )
    edge = CollisionChecker()
    edge.add_collision_object(outside)
    return edge
