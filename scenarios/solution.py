"""Driven trajectories as CommonRoad solution files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray

import jaxfrenet as jf
from scenarios.commonroad import ScenarioInfo
from scenarios.errors import ScenarioError
from scenarios.files import written_whole


def write_solution(
    path: str | Path,
    info: ScenarioInfo,
    scenario: jf.Scenario,
    vehicle: jf.Vehicle,
    *,
    x: ArrayLike,
    y: ArrayLike,
    heading: ArrayLike,
    speed: ArrayLike,
    curvature: ArrayLike,
    cost_function: str = "JB1",
) -> None:
    """Write what the ego drove as a solution of the kinematic single-track model (KS), at the file's time steps.

    Args:
      path: the file to write; replaced as a whole.
      info: of the scenario.
      scenario: the scenario, not a batch; its origin leads back to the file's coordinates.
      vehicle: the ego.
      x: `[steps]`, m, of the rear axle in the local frame at steps 0, 1, ... of 0.1 s.
      y: `[steps]`, m, likewise.
      heading: `[steps]`, rad.
      speed: `[steps]`, m/s.
      curvature: `[steps]`, 1/m, of the rear axle's path; the steering angle is atan(wheelbase * curvature).
      cost_function: CommonRoad's name for it.

    Raises:
      ScenarioError: the states are not all finite, or commonroad-io is not installed.
    """
    states = np.stack([np.asarray(values, float) for values in (x, y, heading, speed, curvature)], axis=1)
    states[:, 2] = np.unwrap(states[:, 2])
    if not np.isfinite(states).all():
        raise ScenarioError(f"{path}: the driven states are not all finite; no solution written")
    states[:, 2] += 2.0 * np.pi * np.round((info.initial_heading - states[0, 2]) / (2.0 * np.pi))
    states[:, :2] += np.asarray(scenario.origin, float)
    states[:, 0] += vehicle.rear_axle_to_center * np.cos(states[:, 2])
    states[:, 1] += vehicle.rear_axle_to_center * np.sin(states[:, 2])
    states[:, 4] = np.arctan(vehicle.wheelbase * states[:, 4])
    text = _document(info, vehicle, at_file_steps(states, info.file_dt), cost_function)
    with written_whole(path) as file:
        file.write(text.encode())


def at_file_steps(states: NDArray[np.float64], file_dt: float) -> NDArray[np.float64]:
    """States `[steps, ...]` of every 0.1 s at the file's steps of `file_dt` [s], linear between them."""
    ratio = file_dt / jf.DT
    at = np.arange(int(np.floor((len(states) - 1) / ratio + 1e-6)) + 1) * ratio
    before = np.clip(np.floor(at + 1e-6).astype(int), 0, len(states) - 1)
    weight = np.where(np.abs(at - before) < 1e-6, 0.0, at - before)[:, None]
    after = np.minimum(before + 1, len(states) - 1)
    return states[before] + weight * (states[after] - states[before])


def _document(info: ScenarioInfo, vehicle: jf.Vehicle, states: NDArray[np.float64], cost_function: str) -> str:
    """The solution file's text for centre x, y, heading, speed and steering angle `[steps, 5]`."""
    try:
        from commonroad.common.solution import (
            CommonRoadSolutionWriter,
            CostFunction,
            PlanningProblemSolution,
            Solution,
            VehicleModel,
            VehicleType,
        )
        from commonroad.scenario.scenario import ScenarioID
        from commonroad.scenario.state import KSState
        from commonroad.scenario.trajectory import Trajectory
    except ImportError as error:
        raise ScenarioError(f"writing solutions needs commonroad-io ({error}); install jaxfrenet[commonroad]") from None
    driven: list[Any] = [
        KSState(
            time_step=info.initial_time_step + step,
            position=np.array(state[:2]),
            orientation=float(state[2]),
            velocity=float(state[3]),
            steering_angle=float(state[4]),
        )
        for step, state in enumerate(states)
    ]
    problem = PlanningProblemSolution(
        planning_problem_id=info.planning_problem_id,
        vehicle_model=VehicleModel.KS,
        vehicle_type=VehicleType[vehicle.commonroad_name],
        cost_function=CostFunction[cost_function],
        trajectory=Trajectory(info.initial_time_step, driven),
    )
    scenario_id = ScenarioID.from_benchmark_id(info.benchmark_id, info.commonroad_version)
    return CommonRoadSolutionWriter(Solution(scenario_id, [problem])).dump()
