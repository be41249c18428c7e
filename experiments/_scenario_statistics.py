"""What a scenario asks of the ego, in a few numbers that can be compared between sources of scenarios."""

from __future__ import annotations

import numpy as np

import jaxfrenet as jf
from scenarios.polyline import project

CROSSING_DISTANCE = 2.0
"""Traffic that comes this near [m] to the reference path can be in the ego's way."""
CROSSING_ANGLE = np.radians(30.0)
"""Traffic whose heading differs by more than this from the path's crosses it instead of driving along."""
QUANTITIES = {
    "start_speed": ("start speed", "m/s"),
    "goal_start": ("distance to the goal's start", "m"),
    "goal_middle": ("distance to the goal's middle", "m"),
    "traffic_speed": ("mean speed of traffic", "m/s"),
    "time_gap": ("time gap to crossing traffic", "s"),
}
"""Title and unit of each quantity."""
QUANTILES = (0, 5, 25, 50, 75, 95, 100)
"""%."""


def scenario_statistics(scenario: jf.Scenario) -> dict[str, np.ndarray]:
    """Values of each of `QUANTITIES` in one scenario, 1-D arrays.

    There is one start speed, one distance along the reference path per goal state with a region, one mean speed per
    moving obstacle, and one time gap per obstacle that crosses the path ahead of the ego's start.
    """
    start = _on_path(scenario.path, np.asarray(scenario.initial_state.position)[None])[0][0]
    goal = np.asarray(scenario.goal.arc_length)[np.asarray(scenario.goal.valid & scenario.goal.has_position)]
    return {
        "start_speed": np.atleast_1d(scenario.initial_state.speed),
        "goal_start": goal[:, 0] - start,
        "goal_middle": goal.mean(axis=1) - start,
        "traffic_speed": _mean_speeds(scenario.obstacles),
        "time_gap": _time_gaps(scenario, start),
    }


def _mean_speeds(obstacles: jf.Obstacles) -> np.ndarray:
    """Mean recorded speed [m/s] of each obstacle that can move."""
    recorded = np.asarray(obstacles.valid)
    moving = recorded.any(axis=1) & ~np.asarray(obstacles.static)
    speed, recorded = np.asarray(obstacles.speed)[moving], recorded[moving]
    return np.sum(np.where(recorded, speed, 0.0), axis=1) / np.sum(recorded, axis=1)


def _time_gaps(scenario: jf.Scenario, start: float) -> np.ndarray:
    """How much later than the ego [s] each obstacle that crosses its path is at the place where it is nearest to it.

    The ego would drive from `start` [m] at its initial speed; one that stands still never arrives.
    """
    speed, obstacles, gaps = float(scenario.initial_state.speed), scenario.obstacles, []
    for position, heading, valid in zip(obstacles.position, obstacles.heading, obstacles.valid, strict=True):
        steps = np.flatnonzero(valid)
        along, distance, path_heading = _on_path(scenario.path, np.asarray(position)[steps])
        angle = np.abs((np.asarray(heading)[steps] - path_heading + np.pi) % (2.0 * np.pi) - np.pi)
        crossing = (distance < CROSSING_DISTANCE) & (along > start) & (angle > CROSSING_ANGLE)
        if crossing.any() and speed > 0.0:
            nearest = np.argmin(np.where(crossing, distance, np.inf))
            gaps.append(jf.DT * steps[nearest] - (along[nearest] - start) / speed)
    return np.array(gaps)


def _on_path(path: jf.ReferencePath, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arc length [m], distance [m] and the path's heading [rad] where it is nearest to positions `[points, 2]`."""
    exists = np.asarray(path.arc_length) <= float(path.length)
    nodes = np.stack([path.x, path.y], axis=-1)[exists].astype(float)
    first, arc_length = float(path.arc_length[0]), np.asarray(path.arc_length)
    along, nearest = project(nodes, positions.astype(float))
    distance = np.linalg.norm(positions - nearest, axis=1)
    return first + along, distance, np.interp(first + along, arc_length, np.asarray(path.heading))


def ks_distance(first: np.ndarray, second: np.ndarray) -> float | None:
    """Largest difference between two samples' cumulative distributions (Kolmogorov-Smirnov); None if one is empty."""
    if not len(first) or not len(second):
        return None
    both = np.concatenate([first, second])
    below = [np.searchsorted(np.sort(sample), both, side="right") / len(sample) for sample in (first, second)]
    return float(np.max(np.abs(below[0] - below[1])))
