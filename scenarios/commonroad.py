"""CommonRoad files become scenarios: the one way from a file's content to arrays."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import jaxfrenet as jf
from scenarios import arrays, goals, obstacles, route, route_path
from scenarios.commonroad_file import CommonRoadFile, network_of, parse
from scenarios.errors import ScenarioError
from scenarios.goals import GoalState
from scenarios.lanelets import Network
from scenarios.polyline import Points
from scenarios.route_path import RoutePath

BROKEN_CONTENT = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)
"""What lanelets without length, references to nothing and the like end in, here or in commonroad-io."""
ORIGIN_GRID = 100.0
"""Distance [m] of the points that a local frame's origin is chosen from: files of one map in which the ego starts near
the same point get the same frame, and with it identical map arrays."""
IMPORTER_VERSION = 2
"""Must be raised when the import changes: scenarios that an earlier one has left in the cache are then read anew."""


@dataclass(frozen=True)
class ScenarioInfo:
    """What identifies a scenario and leads from its arrays back to the file."""

    name: str
    """The file's name without its ending."""
    benchmark_id: str
    commonroad_version: str
    planning_problem_id: int
    initial_time_step: int
    """The file's time step at the scenario's step 0."""
    initial_heading: float
    """As the file gives it [rad]; the scenario's may differ by whole turns."""
    file_dt: float
    """Duration of the file's time steps [s]."""


def load(path: str | Path, planning_problem: int | None = None) -> jf.Scenario:
    """Read one CommonRoad XML file as a scenario without padding.

    Args:
      path: the file.
      planning_problem: id of the planning problem, by default the first in the file.

    Raises:
      ScenarioError: the file is missing or cannot be used; the message says why in one line.
    """
    return load_with_info(path, planning_problem)[0]


def load_with_info(path: str | Path, planning_problem: int | None = None) -> tuple[jf.Scenario, ScenarioInfo]:
    """Like `load`, with what identifies the scenario."""
    path = Path(path)
    if not path.is_file():
        raise ScenarioError(f"{path}: no such file; give a CommonRoad XML file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    return from_bytes(data, str(path), planning_problem)


def from_bytes(data: bytes, source: str, planning_problem: int | None = None) -> tuple[jf.Scenario, ScenarioInfo]:
    """Read the content of a CommonRoad XML file; `source` is its path or name in an archive.

    Raises:
      ScenarioError: it cannot be used; the message begins with `source`.
    """
    try:
        with _collector_paused():
            file = parse(data, planning_problem)
            return _scenario(file), _info(file, Path(source).stem)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from None
    except BROKEN_CONTENT as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        raise ScenarioError(f"{source}: its content is not consistent ({reason}); check the file") from error


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Pause Python's garbage collector: with a file's many small XML nodes alive it takes half of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _info(file: CommonRoadFile, name: str) -> ScenarioInfo:
    state = file.problem.initial_state
    return ScenarioInfo(
        name=name,
        benchmark_id=str(file.scenario.scenario_id),
        commonroad_version=str(file.scenario.scenario_id.scenario_version),
        planning_problem_id=int(file.problem.planning_problem_id),
        initial_time_step=int(state.time_step),
        initial_heading=float(state.orientation),
        file_dt=float(file.scenario.dt),
    )


def _scenario(file: CommonRoadFile) -> jf.Scenario:
    state = file.problem.initial_state
    center = np.asarray(state.position, np.float64)[:2]
    origin = local_origin(center)
    network = network_of(file.scenario, origin)
    goal_states = goals.read_goal(file.problem.goal, network, origin, file.scenario.dt, state.time_step)
    path, lanelets = _route_and_path(network, state, center - origin, goal_states)
    everything = [*file.scenario.obstacles, *file.scenario.phantom_obstacle]
    tracks = [obstacles.track(one, file.scenario.dt, one.obstacle_id in file.without_speed) for one in everything]
    return jf.Scenario(
        path=arrays.path_arrays(path),
        lanes=arrays.lane_arrays(network, lanelets, path),
        lane_map=arrays.lane_map_arrays(network),
        road=arrays.road_arrays(network, path),
        obstacles=arrays.obstacle_arrays(
            [track.moved(-origin) for track in tracks if track is not None],
            file.scenario.dt,
            state.time_step,
            at_least=max(goal.steps[1] for goal in goal_states) + 1,
        ),
        goal=arrays.goal_arrays(goal_states, path),
        initial_state=_initial_state(file, center - origin, path),
        origin=arrays.float_array(origin),
    )


def local_origin(position: Points) -> Points:
    """The point `[2]` [m] of the origins' grid that is nearest to `position` `[2]` [m]."""
    return ORIGIN_GRID * np.round(position / ORIGIN_GRID) + 0.0  # no negative zeros: equal origins have equal bytes


def _route_and_path(
    network: Network, state: Any, position: Points, goal_states: list[GoalState]
) -> tuple[RoutePath, list[int]]:
    """The reference path, and the lanelets that it follows also beyond the goal."""
    starts = route.start_lanelets(network, position, state.orientation)
    duration = jf.DT * max(1, *(goal.steps[1] for goal in goal_states))
    if not all(goal.has_position for goal in goal_states):
        distance = max(state.velocity, 10.0) * duration + 10.0
        lanelets = route.furthest(network, starts, position, state.velocity, distance)
        line = route_path.center_line(network, lanelets, position, state.velocity)
        line, lanelets = route_path.continued(line, network, lanelets, line.start + distance + 50.0)
        end = min(line.start + distance + 50.0, line.length + route_path.EXTENSION)
        return route_path.reference_path(line, end), lanelets
    targets = sorted({id_ for goal in goal_states for id_ in goal.lanelets})
    lanelets = route.shortest(network, starts, position, state.velocity, targets)
    line = route_path.center_line(network, lanelets, position, state.velocity)
    reached = np.concatenate([goal.edges for goal in goal_states if lanelets[-1] in goal.lanelets])
    goal_end = route_path.passes(line, reached)
    speed = max(state.velocity, (goal_end - line.start) / duration)
    end = goal_end + max(route_path.EXTENSION, 3.0 * speed)
    line, lanelets = route_path.continued(line, network, lanelets, end)
    return route_path.reference_path(line, end), lanelets


def _initial_state(file: CommonRoadFile, position: Points, path: RoutePath) -> jf.InitialState:
    """The ego's start; its heading is turned by whole turns to lie near the path's."""
    state = file.problem.initial_state
    node = np.argmin(np.linalg.norm(path.points - position, axis=1))
    turns = np.round((path.heading[node] - state.orientation) / (2.0 * np.pi))
    return jf.InitialState(
        position=arrays.float_array(position),
        heading=arrays.float_array(state.orientation + turns * 2.0 * np.pi),
        speed=arrays.float_array(state.velocity),
        acceleration=arrays.float_array(file.acceleration),
        yaw_rate=arrays.float_array(file.yaw_rate),
    )
