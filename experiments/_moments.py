"""What is to be seen at one step of a recording: traffic, predicted ellipses, sampled trajectories, ego, camera."""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np

import jaxfrenet as jf
from experiments._recording import Recording

PREDICTED_EVERY = 5
"""Planning steps between the prediction's ellipses that are drawn."""
LONGEST_STEP = 10.0
"""No vehicle drives farther than this [m] in one step: trajectories that do leap."""
LOOK_AHEAD, CAMERA_STEPS = 10.0, 10
"""How far ahead of the ego the camera aims [m], and the steps before and after that its place is averaged over."""

_bundle = jax.jit(lambda cycle: cycle.bundle)


class Ellipses(NamedTuple):
    """Where obstacles will be, two standard deviations around."""

    center: np.ndarray
    """`[ellipses, xy]`, m."""
    diameter: np.ndarray
    """`[ellipses, 2]`, m, along the long axis and across."""
    angle: np.ndarray
    """`[ellipses]`, rad, of the long axis."""
    obstacle: np.ndarray
    """`[ellipses]`, whose they are."""
    lead: np.ndarray
    """`[ellipses]`, how far ahead they look, as a share of the horizon."""


def predicted_ellipses(prediction: jf.Prediction) -> Ellipses:
    """The ellipses of every `PREDICTED_EVERY`th step of a prediction."""
    obstacle, time = np.nonzero(prediction.valid)
    drawn = (time + 1) % PREDICTED_EVERY == 0
    obstacle, time = obstacle[drawn], time[drawn]
    variance, axes = np.linalg.eigh(prediction.covariance[obstacle, time])
    return Ellipses(
        center=np.asarray(prediction.mean[obstacle, time]),
        diameter=4.0 * np.sqrt(np.maximum(variance[:, ::-1], 0.0)),
        angle=np.arctan2(axes[:, 1, 1], axes[:, 0, 1]),
        obstacle=obstacle,
        lead=time / prediction.valid.shape[-1],
    )


def present_obstacles(scenario: jf.Scenario, step: int) -> tuple[np.ndarray, int]:
    """Indices of the obstacles that are there at a step, and the entry of the record that says where they are."""
    obstacles = scenario.obstacles
    last = obstacles.valid.shape[-1] - 1
    now = min(step, last)
    return np.flatnonzero(obstacles.valid[:, now] & (step <= last) | obstacles.static), now


def sampled_lines(cycle: jf.PlanningCycle) -> tuple[np.ndarray, np.ndarray]:
    """All sampled trajectories `[trajectories, points, xy]` [m], and which of them can be drawn `[trajectories]`."""
    bundle = jax.device_get(_bundle(cycle))
    lines = np.stack([bundle.motion.x, bundle.motion.y], axis=-1)
    longest = np.linalg.norm(np.diff(lines, axis=1), axis=-1).max(axis=1)
    return lines, bundle.valid & (longest < LONGEST_STEP)


def found_colliding(cycle: jf.PlanningCycle) -> np.ndarray:
    """Which trajectories were found to collide `[trajectories]`: those that are cheaper than the first free one.

    Dearer ones were not looked at. Without a free one, all feasible trajectories collide.
    """
    order = np.argsort(np.where(cycle.feasibility.feasible, cycle.cost, np.inf), kind="stable")
    free = int(cycle.mode == jf.PlanMode.NORMAL)
    colliding = np.zeros(len(order), bool)
    colliding[order[: int(cycle.collision_checked) - free]] = True
    return colliding


def ego_centers(recording: Recording, vehicle: jf.Vehicle) -> np.ndarray:
    """Where the middle of the ego is at each step `[steps + 1, xy]`, m."""
    return _ahead_of_ego(recording, vehicle.rear_axle_to_center)


def camera_track(recording: Recording) -> np.ndarray:
    """Where the view's middle is at each step `[steps + 1, xy]`, m: a little ahead of the ego, averaged over 2 s."""
    aim, window = _ahead_of_ego(recording, LOOK_AHEAD), 2 * CAMERA_STEPS + 1
    padded = np.pad(aim, ((CAMERA_STEPS, CAMERA_STEPS), (0, 0)), mode="edge")
    return np.stack([np.convolve(axis, np.full(window, 1 / window), mode="valid") for axis in padded.T], axis=-1)


def _ahead_of_ego(recording: Recording, distance: float) -> np.ndarray:
    ego = [state.ego for state in recording.states]
    return np.array([(e.x + distance * np.cos(e.heading), e.y + distance * np.sin(e.heading)) for e in ego])
