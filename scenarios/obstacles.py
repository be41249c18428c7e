"""CommonRoad obstacles as oriented boxes over time."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxfrenet import DT, ObstacleKind
from scenarios.polyline import Points

KINDS = {
    "car": ObstacleKind.CAR,
    "taxi": ObstacleKind.CAR,
    "priorityVehicle": ObstacleKind.CAR,
    "truck": ObstacleKind.TRUCK,
    "bus": ObstacleKind.BUS,
    "motorcycle": ObstacleKind.MOTORCYCLE,
    "bicycle": ObstacleKind.BICYCLE,
    "pedestrian": ObstacleKind.PEDESTRIAN,
    "train": ObstacleKind.TRAIN,
    "parkedVehicle": ObstacleKind.PARKED_VEHICLE,
    "constructionZone": ObstacleKind.STRUCTURE,
    "roadBoundary": ObstacleKind.STRUCTURE,
    "building": ObstacleKind.STRUCTURE,
    "pillar": ObstacleKind.STRUCTURE,
    "median_strip": ObstacleKind.STRUCTURE,
}
"""CommonRoad's obstacle types; the rest is `UNKNOWN`."""


@dataclass(frozen=True)
class Track:
    """One obstacle as a box over the file's own time steps, float64."""

    first_step: int
    states: NDArray[np.float64]
    """`[steps, 4]`, centre x, y [m], heading [rad], speed [m/s]; NaN where there is no record."""
    length: float
    width: float
    kind: ObstacleKind
    static: bool

    def moved(self, offset: Points) -> Track:
        """The same track with `offset` `[2]` [m] added to its positions."""
        return dataclasses.replace(self, states=self.states + np.array([*offset, 0.0, 0.0]))


def track(obstacle: Any, file_dt: float, speed_is_missing: bool) -> Track | None:
    """The box of a CommonRoad obstacle; None if it occupies nothing.

    Args:
      obstacle: a static, dynamic, environment or phantom obstacle of commonroad-io.
      file_dt: duration of the file's time steps [s].
      speed_is_missing: whether the file leaves out the initial speed, which commonroad-io sets to 0.
    """
    role = obstacle.obstacle_role.value
    kind = ObstacleKind.UNKNOWN
    if role != "phantom" and obstacle.obstacle_type is not None:
        kind = KINDS.get(obstacle.obstacle_type.value, ObstacleKind.UNKNOWN)
    if role == "environment":
        return _standing(outline(obstacle.obstacle_shape), kind, None)
    if role == "static":
        state = obstacle.initial_state
        return _standing(outline(obstacle.occupancy_at_time(state.time_step).shape), kind, state.orientation)
    states = _exact_states(obstacle)
    if states is not None:
        return _moving(obstacle, states, kind, file_dt, speed_is_missing)
    return _occupying(obstacle, kind, file_dt)


def outline(shape: Any) -> Points:
    """Corners `[points, 2]`, m, whose convex hull contains a CommonRoad shape."""
    if hasattr(shape, "shapes"):
        return np.concatenate([outline(part) for part in shape.shapes])
    if hasattr(shape, "radius"):
        return np.asarray(shape.center) + shape.radius * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return np.asarray(shape.vertices, float)[:, :2]


def _rotation(angle: float) -> NDArray[np.float64]:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _bounds(points: Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre and extent `[2]` of the axis-aligned box around points."""
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), np.maximum(high - low, 1e-3)


def smallest_box(points: Points) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Centre `[2]`, heading [rad] and extent `[2]` (the longer first) of the smallest box around points."""
    import shapely

    hull = shapely.MultiPoint(points).convex_hull
    ring = np.asarray(shapely.get_coordinates(hull))
    edges = np.diff(ring, axis=0)
    best = None
    for angle in np.arctan2(edges[:, 1], edges[:, 0]):
        center, extent = _bounds(points @ _rotation(angle))
        if best is None or np.prod(extent) < np.prod(best[2]):
            best = _rotation(angle) @ center, float(angle), extent
    assert best is not None
    center, heading, extent = best
    if extent[1] > extent[0]:
        heading, extent = heading + 0.5 * np.pi, extent[::-1]
    return center, heading, extent


def _standing(corners: Points, kind: ObstacleKind, heading: float | None) -> Track:
    """An obstacle that never moves, in its smallest box, turned as near to its heading as the box allows."""
    center, box_heading, extent = smallest_box(corners)
    if heading is not None:
        quarter_turns = round((heading - box_heading) / (0.5 * np.pi))
        box_heading += quarter_turns * 0.5 * np.pi
        extent = extent[::-1] if quarter_turns % 2 else extent
    states = np.array([[*center, box_heading, 0.0]])
    return Track(0, states, float(extent[0]), float(extent[1]), kind, static=True)


def _exact_states(obstacle: Any) -> dict[int, Any] | None:
    """The recorded states by time step; None where there are only occupancies: uncertain states, several shapes."""
    states = [obstacle.initial_state] if obstacle.obstacle_role.value == "dynamic" else []
    if obstacle.prediction is not None:
        if not hasattr(obstacle.prediction, "trajectory"):
            return None
        states += obstacle.prediction.trajectory.state_list
    exact = all(isinstance(state.position, np.ndarray) and isinstance(state.time_step, int) for state in states)
    exact = exact and not hasattr(obstacle.obstacle_shape, "shapes")
    return {state.time_step: state for state in states} if states and exact else None


def _moving(obstacle: Any, states: dict[int, Any], kind: ObstacleKind, file_dt: float, speed_is_missing: bool) -> Track:
    """The box, along the heading, that contains the shape of an obstacle with a recorded trajectory.

    As in commonroad-io, a shape turns about its own centre, wherever that lies relative to the recorded position.
    """
    pivot = np.asarray(obstacle.obstacle_shape.center, float)[:2]
    center, extent = _bounds(outline(obstacle.obstacle_shape) - pivot)
    first = min(states)
    table = np.full((max(states) - first + 1, 4), np.nan)
    for step, state in states.items():
        table[step - first] = [*np.asarray(state.position, float)[:2], *_heading_and_speed(state)]
    if speed_is_missing:
        table[obstacle.initial_state.time_step - first, 3] = np.nan
    _fill_gaps(table, file_dt)
    cos, sin = np.cos(table[:, 2]), np.sin(table[:, 2])
    table[:, 0] += pivot[0] + center[0] * cos - center[1] * sin
    table[:, 1] += pivot[1] + center[0] * sin + center[1] * cos
    return Track(first, table, float(extent[0]), float(extent[1]), kind, static=False)


def _heading_and_speed(state: Any) -> tuple[float, float]:
    """Heading [rad] and speed [m/s] of a recorded state, NaN where it has none; intervals count by their middle."""
    speed, across = (_middle(getattr(state, name, None)) for name in ("velocity", "velocity_y"))
    if "orientation" in state.used_attributes:
        return _middle(state.orientation), speed
    # A point mass: its velocity is given along x and y.
    return float(np.arctan2(across, speed)), float(np.hypot(across, speed))


def _middle(value: Any) -> float:
    if value is None:
        return float("nan")
    return 0.5 * (value.start + value.end) if hasattr(value, "start") else float(value)


def _fill_gaps(table: NDArray[np.float64], file_dt: float) -> None:
    """Take missing headings and speeds `[steps, 4]` from the positions, where those are recorded."""
    recorded = np.flatnonzero(np.isfinite(table[:, 0]))
    motion = np.zeros((len(recorded), 2))
    if len(recorded) > 1:
        motion = np.gradient(table[recorded, :2], recorded * file_dt, axis=0)
    headings, speeds = table[recorded, 2], table[recorded, 3]
    headings = np.where(np.isnan(headings), np.arctan2(motion[:, 1], motion[:, 0]), headings)
    along = motion[:, 0] * np.cos(headings) + motion[:, 1] * np.sin(headings)
    table[recorded, 2], table[recorded, 3] = headings, np.where(np.isnan(speeds), along, speeds)


def _occupying(obstacle: Any, kind: ObstacleKind, file_dt: float) -> Track | None:
    """Boxes around a set of occupancies, all of the largest one's size."""
    boxes: dict[int, tuple[NDArray[np.float64], float, NDArray[np.float64]]] = {}
    for occupancy in obstacle.prediction.occupancy_set if obstacle.prediction is not None else []:
        for step in _steps(occupancy.time_step):
            boxes[step] = smallest_box(outline(occupancy.shape))
    if obstacle.obstacle_role.value == "dynamic":
        initial = obstacle.occupancy_at_time(obstacle.initial_state.time_step)
        boxes.setdefault(obstacle.initial_state.time_step, smallest_box(outline(initial.shape)))
    if not boxes:
        return None
    first = min(boxes)
    table = np.full((max(boxes) - first + 1, 4), np.nan)
    previous = 0.0
    for step in sorted(boxes):
        center, heading, _ = boxes[step]
        previous = heading + np.pi * round((previous - heading) / np.pi)
        table[step - first, :3] = [*center, previous]
    _fill_gaps(table, file_dt)
    length, width = np.max([extent for _, _, extent in boxes.values()], axis=0)
    return Track(first, table, float(length), float(width), kind, static=False)


def _steps(time_step: Any) -> range:
    """The time steps that a step or an interval of steps covers."""
    if hasattr(time_step, "start"):
        return range(int(time_step.start), int(time_step.end) + 1)
    return range(int(time_step), int(time_step) + 1)


def resampled(
    track: Track, file_dt: float, start_step: int, steps: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """States `[steps, 4]` and validity `[steps]` of a track at the closed loop's steps of 0.1 s.

    Linear between records; a step is valid if it coincides with a record or lies between two consecutive ones.

    Args:
      track: over the file's steps.
      file_dt: duration of those [s].
      start_step: the file's step at which the closed loop starts.
      steps: how many steps of the closed loop.
    """
    if track.static:
        return np.repeat(track.states, steps, axis=0), np.ones(steps, bool)
    at = np.arange(steps) * (DT / file_dt) + start_step - track.first_step
    before = np.floor(at + 1e-6).astype(int)
    weight = np.where(np.abs(at - before) < 1e-6, 0.0, at - before)[:, None]
    last = len(track.states) - 1
    inside = (before >= 0) & (before + (weight[:, 0] > 0.0) <= last)
    lower, upper = np.clip(before, 0, last), np.clip(before + 1, 0, last)
    upper = np.where(weight[:, 0] > 0.0, upper, lower)
    step = track.states[upper] - track.states[lower]
    step[:, 2] = (step[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    states = track.states[lower] + weight * step
    valid = inside & np.isfinite(states).all(axis=1)
    return np.where(valid[:, None], states, 0.0), valid


def last_step(track: Track, file_dt: float, start_step: int) -> int:
    """The last step of the closed loop at which a track is recorded; 0 for one that never moves."""
    if track.static:
        return 0
    end = track.first_step + len(track.states) - 1 - start_step
    return max(int(np.floor(end * file_dt / DT + 1e-6)), 0)
