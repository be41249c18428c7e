"""What the player is given: recordings as values that JSON can hold, and long arrays packed."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import to_hex
from matplotlib.path import Path

import jaxfrenet as jf
from experiments._charts import PLANNER_COLORS, Chart, player_charts
from experiments._moments import (
    camera_track,
    ego_centers,
    found_colliding,
    predicted_ellipses,
    present_obstacles,
    sampled_lines,
)
from experiments._recording import Recording
from experiments._results import six_digits
from experiments._road_view import COSTS, INFEASIBLE
from experiments._scene import (
    EDGE,
    GOAL,
    OFF_ROAD,
    PATH,
    SURFACE,
    goal_area,
    kind_color,
    lane_borders,
    path_line,
    surface_area,
)

UNIT = 0.01
"""Sampled trajectories are kept to this [m]."""
EVERY = 2
"""Every second of their points is kept."""
SHADES = 32
"""Colours between the cheapest and the dearest trajectory."""


class Reason(NamedTuple):
    """Why a trajectory is not driven."""

    label: str
    color: str


REASONS = {
    "collision": Reason("collides", "#7f1d1d"),
    "acceleration": Reason("acceleration", "#c2417c"),
    "curvature": Reason("curvature", "#7b4fa3"),
    "curvature_rate": Reason("curvature rate", "#c77d1e"),
    "yaw_rate": Reason("yaw rate", "#2f6db3"),
    "backwards": Reason("drives backwards", "#4b5563"),
}
"""The place of a reason is its bit. The first one is the collision check's, the others are fields of `Feasibility`."""


def player_data(recordings: Sequence[Recording], vehicle: jf.Vehicle) -> dict[str, Any]:
    """All that the player shows, as JSON can hold it.

    Args:
      recordings: of one scenario, one or two; the first is the one that the view follows.
      vehicle: the ego's size.
    """
    steps = max(len(one.cycles) for one in recordings)
    scenario = recordings[0].scenario
    return {
        "name": recordings[0].name,
        "stepSeconds": jf.DT,
        "steps": steps,
        "ego": {"length": vehicle.length, "width": vehicle.width},
        "surroundings": _surroundings(scenario),
        "obstacles": _obstacles(scenario),
        "tracks": pack({"poses": _tracks(scenario, steps)}),
        "colors": {"offRoad": OFF_ROAD, "surface": SURFACE, "edge": EDGE, "path": PATH, "goal": GOAL},
        "infeasibleColor": INFEASIBLE,
        "costColors": [to_hex(COSTS(share)) for share in np.linspace(0.0, 1.0, SHADES)],
        "reasons": [reason._asdict() for reason in REASONS.values()],
        "episodes": [_episode(one, color, vehicle) for one, color in zip(recordings, PLANNER_COLORS, strict=False)],
        "charts": [_chart(chart) for chart in player_charts(recordings)],
    }


def pack(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Arrays as JSON can hold them: compressed bytes in base64, and where in them which array begins.

    Each begins at a multiple of four bytes; numbers are little-endian.
    """
    parts, places, start = [], [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        padding = -len(data) % 4
        places.append({"name": name, "type": array.dtype.name, "start": start, "length": array.size})
        parts += [data, bytes(padding)]
        start += len(data) + padding
    packed = gzip.compress(b"".join(parts), compresslevel=6, mtime=0)
    return {"arrays": places, "bytes": base64.b64encode(packed).decode()}


def _surroundings(scenario: jf.Scenario) -> dict[str, Any]:
    """Rings and lines of points, m; an area is inside an odd number of its rings."""
    return {
        "surface": _rings(surface_area(scenario)),
        "goal": _rings(goal_area(scenario)),
        "borders": [_points(piece) for border in lane_borders(scenario) for piece in _pieces(border)],
        "path": _points(path_line(scenario)),
    }


def _rings(area: Path | None) -> list[list[list[float]]]:
    return [] if area is None else [_points(np.asarray(ring)) for ring in area.to_polygons()]


def _points(line: np.ndarray) -> list[list[float]]:
    return np.round(line.astype(float), 3).tolist()


def _pieces(line: np.ndarray) -> list[np.ndarray]:
    """The stretches of a line `[nodes, xy]` whose points are numbers, of two or more."""
    gaps = np.flatnonzero(np.isnan(line).any(axis=1))
    pieces = np.split(line, np.unique(np.concatenate([gaps, gaps + 1])))
    return [piece for piece in pieces if len(piece) > 1]


def _obstacles(scenario: jf.Scenario) -> list[dict[str, Any]]:
    obstacles = scenario.obstacles
    return [
        {
            "kind": jf.ObstacleKind(int(kind)).name.lower().replace("_", " "),
            "color": kind_color(kind),
            "length": round(float(length), 3),
            "width": round(float(width), 3),
            "isSeen": bool(seen),
        }
        for kind, length, width, seen in zip(
            obstacles.kind, obstacles.length, obstacles.width, obstacles.valid.any(axis=-1), strict=True
        )
    ]


def _tracks(scenario: jf.Scenario, steps: int) -> np.ndarray:
    """Where obstacles are: `[steps + 1, obstacles, (x, y, heading, speed)]`, not a number where they are not there."""
    obstacles = scenario.obstacles
    tracks = np.full((steps + 1, len(obstacles.kind), 4), np.nan, np.float32)
    for step in range(steps + 1):
        seen, now = present_obstacles(scenario, step)
        poses = obstacles.position[seen, now], obstacles.heading[seen, now, None], obstacles.speed[seen, now, None]
        tracks[step, seen] = np.concatenate(poses, axis=-1)
    return tracks


def _episode(recording: Recording, color: str, vehicle: jf.Vehicle) -> dict[str, Any]:
    bundle = _bundle(recording)
    ego = [state.ego for state in recording.states]
    motion = np.array([(one.heading, one.speed) for one in ego])
    ellipses = [_ellipses(cycle.prediction) for cycle in recording.cycles]
    arrays = {
        "poses": np.concatenate([ego_centers(recording, vehicle), motion], axis=-1).astype(np.float32),
        "camera": camera_track(recording).astype(np.float32),
        "chosen": np.stack([_xy(cycle.trajectory) for cycle in recording.cycles]).astype(np.float32),
        "ellipses": np.concatenate(ellipses).astype(np.float32),
        "ellipseStarts": _starts(ellipses),
    }
    return {
        "planner": recording.planner,
        "color": color,
        "outcome": recording.outcome.name.lower().replace("_", " "),
        "steps": len(recording.cycles),
        "modes": [jf.PlanMode(int(cycle.mode)).name.lower() for cycle in recording.cycles],
        "sampled": len(recording.cycles[0].cost),
        "pointsKept": recording.cycles[0].trajectory.x[::EVERY].size,
        "unit": UNIT,
        "arrays": pack(arrays | bundle),
    }


def _bundle(recording: Recording) -> dict[str, np.ndarray]:
    """The sampled trajectories that can be drawn, of all cycles after each other.

    `bundlePoints` are second differences along a trajectory, `[points, xy, trajectories]`, in `UNIT`s from where the
    rear axle is: smooth lines have small ones, which compress well. `bundleFailures` has a bit for each of `REASONS`.
    """
    points, costs, failures = [], [], []
    for cycle, state in zip(recording.cycles, recording.states, strict=False):
        lines, drawable = sampled_lines(cycle)
        here = lines[drawable, ::EVERY] - np.array([state.ego.x, state.ego.y])
        points.append(np.moveaxis(np.round(here / UNIT).astype(np.int16), 0, -1))
        costs.append(cycle.cost[drawable].astype(np.float32))
        failures.append(_failures(cycle)[drawable])
    whole = np.concatenate(points, axis=-1)
    zero = np.int16(0)
    return {
        "bundlePoints": np.diff(np.diff(whole, axis=0, prepend=zero), axis=0, prepend=zero),
        "bundleCosts": np.concatenate(costs),
        "bundleFailures": np.concatenate(failures),
        "bundleStarts": _starts(costs),
    }


def _failures(cycle: jf.PlanningCycle) -> np.ndarray:
    """A byte per trajectory, with a bit for each reason."""
    collision, *checks = REASONS
    found = {collision: found_colliding(cycle)} | {check: getattr(cycle.feasibility, check) for check in checks}
    return np.packbits(list(found.values()), axis=0, bitorder="little")[0]


def _ellipses(prediction: jf.Prediction) -> np.ndarray:
    """`[ellipses, (x, y, half the long and the short axis, angle, obstacle, lead)]`."""
    seen = predicted_ellipses(prediction)
    return np.column_stack([seen.center, seen.diameter / 2, seen.angle, seen.obstacle, seen.lead])


def _xy(trajectory: jf.EgoState) -> np.ndarray:
    return np.stack([trajectory.x, trajectory.y], axis=-1)


def _starts(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Where each part begins when they stand after each other, and where the last one ends."""
    return np.cumsum([0, *map(len, parts)]).astype(np.int32)


def _chart(chart: Chart) -> dict[str, Any]:
    low, high = chart.limits
    lines = [
        {
            "label": line.label,
            "planner": line.planner,
            "color": line.color,
            "dashed": line.dashed,
            "width": line.width,
            "values": [six_digits(value) for value in line.values],
        }
        for line in chart.lines
    ]
    limits = [six_digits(low), six_digits(high)]
    return {"title": chart.title, "unit": chart.unit, "log": chart.logarithmic, "limits": limits, "lines": lines}
