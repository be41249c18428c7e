"""Routes, roads, tracks and goals as the arrays that the planner reads, without padding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax import Array

import jaxfrenet as jf
from scenarios import goals, lane_pieces, lanes, obstacles, road
from scenarios.batching import device_array
from scenarios.goals import GoalState
from scenarios.lanelets import Network
from scenarios.obstacles import Track
from scenarios.route_path import RoutePath


def float_array(values: Any) -> Array:
    """The values as float32 on the default device."""
    return device_array(np.asarray(values, np.float32))


def path_arrays(path: RoutePath) -> jf.ReferencePath:
    """The reference path."""
    return jf.ReferencePath(
        arc_length=float_array(path.arc_length),
        x=float_array(path.x),
        y=float_array(path.y),
        heading=float_array(path.heading),
        curvature=float_array(path.curvature),
        curvature_derivative=float_array(path.curvature_derivative),
        length=float_array(path.arc_length[-1]),
    )


def lane_arrays(network: Network, lanelets: list[int], path: RoutePath) -> jf.Lanes:
    """The lanes along the path; `lanelets` are those that it follows."""
    center, width, direction = lanes.lane_tables(network, lanelets, path)
    return jf.Lanes(center=float_array(center), width=float_array(width), direction=device_array(direction))


def lane_map_arrays(network: Network) -> jf.LaneMap:
    """All lanes of the map."""
    pieces = lane_pieces.cut(network)
    return jf.LaneMap(
        center=float_array(pieces.center),
        length=float_array(pieces.length),
        successors=device_array(pieces.successors),
        valid=device_array(np.ones(len(pieces.length), bool)),
    )


def road_arrays(network: Network, path: RoutePath) -> jf.Road:
    """The road surface's edge."""
    segments = road.surface_edge(network)
    nearby = road.nearby_segments(path.arc_length, path.points, segments)
    return jf.Road(
        segments=float_array(segments), valid=device_array(np.ones(len(segments), bool)), nearby=device_array(nearby)
    )


def obstacle_arrays(tracks: Sequence[Track], file_dt: float, start_step: int, at_least: int) -> jf.Obstacles:
    """Obstacles from step 0 to the last recorded one; one that never exists if there is none, so no axis is empty.

    Args:
      tracks: in the local frame, over the file's steps.
      file_dt: duration of those [s].
      start_step: the file's step that becomes step 0.
      at_least: the least number of steps.
    """
    steps = max([at_least, *(obstacles.last_step(track, file_dt, start_step) + 1 for track in tracks)])
    count = max(len(tracks), 1)
    states, valid = np.zeros((count, steps, 4)), np.zeros((count, steps), bool)
    for index, track in enumerate(tracks):
        states[index], valid[index] = obstacles.resampled(track, file_dt, start_step, steps)
    return jf.Obstacles(
        position=float_array(states[..., :2]),
        heading=float_array(states[..., 2]),
        speed=float_array(states[..., 3]),
        valid=device_array(valid),
        length=float_array([track.length for track in tracks] or [1.0]),
        width=float_array([track.width for track in tracks] or [1.0]),
        kind=device_array(np.array([track.kind for track in tracks] or [jf.ObstacleKind.UNKNOWN], np.int32)),
        static=device_array([track.static for track in tracks] or [False]),
    )


def goal_arrays(goal_states: Sequence[GoalState], path: RoutePath) -> jf.Goal:
    """The goal, with what the reference path has to do with it."""
    count = max(1, *(len(goal.edges) for goal in goal_states))
    edges = np.zeros((len(goal_states), count, 2, 2))
    for index, goal in enumerate(goal_states):
        edges[index, : len(goal.edges)] = goal.edges
    return jf.Goal(
        edges=float_array(edges),
        edge_valid=device_array([[edge < len(goal.edges) for edge in range(count)] for goal in goal_states]),
        has_position=device_array([goal.has_position for goal in goal_states]),
        steps=device_array(np.array([goal.steps for goal in goal_states], np.int32)),
        speed=float_array([goal.speed or goals.ANY_SPEED for goal in goal_states]),
        has_speed=device_array([goal.speed is not None for goal in goal_states]),
        heading=float_array([goal.heading for goal in goal_states]),
        arc_length=float_array([_arc_lengths(goal, path) for goal in goal_states]),
        valid=device_array(np.ones(len(goal_states), bool)),
    )


def _arc_lengths(goal: GoalState, path: RoutePath) -> tuple[float, float]:
    """Where the path enters and leaves the goal's region [m]; all of it if there is none."""
    if not goal.has_position:
        return 0.0, float(path.arc_length[-1])
    return goals.arc_length_range(goal.edges, path.arc_length, path.points)
