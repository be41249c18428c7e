"""The road seen from above: surface, goal, traffic with predictions, sampled bundle, chosen trajectory, ego."""

from __future__ import annotations

from typing import TypeVar

import jax
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import Collection, EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import jaxfrenet as jf
from experiments._recording import Recording
from experiments._scene import (
    EGO,
    box_corners,
    draw_surroundings,
    kind_color,
    kind_handles,
    kinds_in,
    surroundings_handles,
)

Drawn = TypeVar("Drawn", bound=Collection)
VIEW = (70.0, 50.0)
"""Width and height [m] of the stretch of road that is shown."""
CHOSEN, INFEASIBLE = EGO, "#8d96a0"
COSTS = colormaps["viridis_r"]
PREDICTED_EVERY = 5
"""Planning steps between the prediction's ellipses that are drawn."""


class RoadView:
    """Draws one planning cycle of a recording after the other into an axes."""

    def __init__(self, axes: Axes, recording: Recording, vehicle: jf.Vehicle) -> None:
        self._axes, self._recording, self._vehicle = axes, recording, vehicle
        self._kinds = recording.scenario.obstacles.kind
        draw_surroundings(axes, recording.scenario)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        self._infeasible = _add(axes, LineCollection([], colors=INFEASIBLE, linewidths=0.4, alpha=0.25, zorder=3))
        self._feasible = _add(axes, LineCollection([], linewidths=0.8, alpha=0.7, zorder=4))
        self._ellipses = _add(axes, _no_ellipses(axes))
        self._traffic = _add(axes, PolyCollection([], linewidths=0.8, edgecolors="white", zorder=6))
        (self._chosen_rim,) = axes.plot([], [], color="white", linewidth=4.0, zorder=7)
        (self._chosen,) = axes.plot([], [], color=CHOSEN, linewidth=2.2, zorder=8)
        self._ego = _add(axes, PolyCollection([], facecolors=EGO, edgecolors="white", linewidths=1.0, zorder=6.5))
        self._center = _smooth_camera(recording)
        self._draw_legend()

    def _draw_legend(self) -> None:
        kinds = kinds_in(self._recording.scenario.obstacles)
        handles = [
            Patch(color=EGO, label="ego"),
            Line2D([], [], color=CHOSEN, linewidth=2.2, label="chosen trajectory"),
            Line2D([], [], color=COSTS(0.35), label="feasible (bright: cheap)"),
            Line2D([], [], color=INFEASIBLE, linewidth=0.8, label="infeasible"),
            *surroundings_handles(),
            *kind_handles(kinds),
        ]
        if kinds:
            handles.append(Patch(color=to_rgba(kind_color(min(kinds)), 0.25), label="predicted, 2σ"))
        self._axes.legend(handles=handles, loc="lower left", fontsize=7, framealpha=0.9, ncols=2, borderpad=0.6)

    def show(self, step: int) -> None:
        """Draw the cycle that was planned at a step, or the last one's traffic and ego once there is none left."""
        cycle = self._recording.cycles[min(step, len(self._recording.cycles) - 1)]
        self._show_bundle(cycle)
        self._show_traffic(self._recording.states[step], cycle)
        self._show_ego(self._recording.states[step].ego)
        (x, y), (width, height) = self._center[step], VIEW
        self._axes.set_xlim(x - width / 2, x + width / 2)
        self._axes.set_ylim(y - height / 2, y + height / 2)

    def _show_bundle(self, cycle: jf.PlanningCycle) -> None:
        bundle = jax.device_get(cycle.bundle)
        lines, feasible = np.stack([bundle.motion.x, bundle.motion.y], axis=-1), cycle.feasibility.feasible
        self._infeasible.set_segments(list(lines[bundle.valid & ~feasible & _is_drawable(lines)]))
        dearest_first = np.argsort(-cycle.cost[feasible])
        self._feasible.set_segments(list(lines[feasible][dearest_first]))
        self._feasible.set_color(list(COSTS(np.linspace(1.0, 0.0, len(dearest_first)))))
        for line in (self._chosen_rim, self._chosen):
            line.set_data(cycle.trajectory.x, cycle.trajectory.y)

    def _show_traffic(self, state: jf.SimulationState, cycle: jf.PlanningCycle) -> None:
        obstacles = self._recording.scenario.obstacles
        last = obstacles.valid.shape[-1] - 1
        now = min(int(state.step), last)
        seen = np.flatnonzero(obstacles.valid[:, now] & (state.step <= last) | obstacles.static)
        center, heading = obstacles.position[seen, now], obstacles.heading[seen, now]
        boxes = box_corners(center, heading, obstacles.length[seen], obstacles.width[seen])
        self._traffic.set_verts(list(boxes))
        self._traffic.set_facecolor([kind_color(self._kinds[obstacle]) for obstacle in seen])
        self._show_prediction(cycle.prediction)

    def _show_prediction(self, prediction: jf.Prediction) -> None:
        obstacle, time = np.nonzero(prediction.valid)
        drawn = (time + 1) % PREDICTED_EVERY == 0
        obstacle, time = obstacle[drawn], time[drawn]
        variance, axes = np.linalg.eigh(prediction.covariance[obstacle, time])
        diameter = 4.0 * np.sqrt(np.maximum(variance, 0.0))
        angle = np.degrees(np.arctan2(axes[:, 1, 1], axes[:, 0, 1]))
        self._ellipses.set(widths=diameter[:, 1], heights=diameter[:, 0], angles=angle)
        self._ellipses.set_offsets(prediction.mean[obstacle, time])
        fading = 0.3 * (1.0 - time / prediction.valid.shape[-1])
        self._ellipses.set_facecolor(
            [to_rgba(kind_color(self._kinds[o]), a) for o, a in zip(obstacle, fading, strict=True)]
        )

    def _show_ego(self, ego: jf.EgoState) -> None:
        ahead = self._vehicle.rear_axle_to_center
        center = np.array([ego.x + ahead * np.cos(ego.heading), ego.y + ahead * np.sin(ego.heading)])
        self._ego.set_verts([box_corners(center, ego.heading, self._vehicle.length, self._vehicle.width)])


def _add(axes: Axes, collection: Drawn) -> Drawn:
    axes.add_collection(collection, autolim=False)
    return collection


def _no_ellipses(axes: Axes) -> EllipseCollection:
    offsets = {"offsets": np.zeros((0, 2)), "offset_transform": axes.transData}
    return EllipseCollection([], [], [], units="xy", zorder=5, **offsets)


def _is_drawable(lines: np.ndarray) -> np.ndarray:
    """Which of the lines `[lines, points, xy]` do not leap: no vehicle drives 10 m in one step."""
    return np.linalg.norm(np.diff(lines, axis=1), axis=-1).max(axis=1) < 10.0


def _smooth_camera(recording: Recording) -> np.ndarray:
    """Where the view's centre is at each step `[steps + 1, xy]`: a little ahead of the ego, averaged over 2 s."""
    ego = [state.ego for state in recording.states]
    ahead = 10.0
    aim = np.array([(e.x + ahead * np.cos(e.heading), e.y + ahead * np.sin(e.heading)) for e in ego])
    padded = np.pad(aim, ((10, 10), (0, 0)), mode="edge")
    return np.stack([np.convolve(axis, np.full(21, 1 / 21), mode="valid") for axis in padded.T], axis=-1)
