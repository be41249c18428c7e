"""The road seen from above: surface, goal, traffic with predictions, sampled bundle, chosen trajectory, ego."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import Collection, EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import jaxfrenet as jf
from experiments._moments import (
    camera_track,
    ego_centers,
    predicted_ellipses,
    present_obstacles,
    sampled_lines,
)
from experiments._recording import Recording
from experiments._scene import (
    EGO,
    OTHER_EGO,
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


class RoadView:
    """Draws one planning cycle of a recording after the other into an axes."""

    def __init__(self, axes: Axes, recordings: Sequence[Recording], vehicle: jf.Vehicle) -> None:
        """Draw what stays as it is; all is shown of the first recording, only car and drive of a second one."""
        recording = recordings[0]
        self._axes, self._recordings, self._recording, self._vehicle = axes, recordings, recording, vehicle
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
        self._egos = [
            _add(axes, PolyCollection([], facecolors=color, edgecolors="white", linewidths=1.0, zorder=order))
            for color, order in zip((EGO, OTHER_EGO), (6.5, 6.4), strict=True)
        ]
        (self._other_drive,) = axes.plot([], [], color=OTHER_EGO, linewidth=1.6, zorder=5.5)
        self._ego_centers = [ego_centers(one, vehicle) for one in recordings]
        self._center = camera_track(recording)
        self._draw_legend()

    def _draw_legend(self) -> None:
        kinds = kinds_in(self._recording.scenario.obstacles)
        called = [f"ego, {one.planner}" for one in self._recordings] if len(self._recordings) > 1 else ["ego"]
        handles = [
            *(Patch(color=color, label=label) for color, label in zip((EGO, OTHER_EGO), called, strict=False)),
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
        """Draw what was planned at a step, or what was planned last once there is none left; cars stay at the end."""
        cycle = self._recording.cycles[min(step, len(self._recording.cycles) - 1)]
        self._show_bundle(cycle)
        self._show_traffic(step, cycle)
        self._show_egos(step)
        (x, y), (width, height) = self._center[min(step, len(self._center) - 1)], VIEW
        self._axes.set_xlim(x - width / 2, x + width / 2)
        self._axes.set_ylim(y - height / 2, y + height / 2)

    def _show_bundle(self, cycle: jf.PlanningCycle) -> None:
        lines, drawable = sampled_lines(cycle)
        feasible = cycle.feasibility.feasible
        self._infeasible.set_segments(list(lines[drawable & ~feasible]))
        dearest_first = np.argsort(-cycle.cost[feasible])
        self._feasible.set_segments(list(lines[feasible][dearest_first]))
        self._feasible.set_color(list(COSTS(np.linspace(1.0, 0.0, len(dearest_first)))))
        for line in (self._chosen_rim, self._chosen):
            line.set_data(cycle.trajectory.x, cycle.trajectory.y)

    def _show_traffic(self, step: int, cycle: jf.PlanningCycle) -> None:
        obstacles = self._recording.scenario.obstacles
        seen, now = present_obstacles(self._recording.scenario, step)
        center, heading = obstacles.position[seen, now], obstacles.heading[seen, now]
        boxes = box_corners(center, heading, obstacles.length[seen], obstacles.width[seen])
        self._traffic.set_verts(list(boxes))
        self._traffic.set_facecolor([kind_color(self._kinds[obstacle]) for obstacle in seen])
        self._show_prediction(cycle.prediction)

    def _show_prediction(self, prediction: jf.Prediction) -> None:
        seen = predicted_ellipses(prediction)
        long, across = seen.diameter.T
        self._ellipses.set(widths=long, heights=across, angles=np.degrees(seen.angle))
        self._ellipses.set_offsets(seen.center)
        shades = zip(seen.obstacle, 0.3 * (1.0 - seen.lead), strict=True)
        self._ellipses.set_facecolor([to_rgba(kind_color(self._kinds[whose]), alpha) for whose, alpha in shades])

    def _show_egos(self, step: int) -> None:
        size = self._vehicle.length, self._vehicle.width
        for box, one, centers in zip(self._egos, self._recordings, self._ego_centers, strict=False):
            now = min(step, len(centers) - 1)
            box.set_verts([box_corners(centers[now], one.states[now].ego.heading, *size)])
        for centers in self._ego_centers[1:]:
            self._other_drive.set_data(*centers[: step + 1].T)


def _add(axes: Axes, collection: Drawn) -> Drawn:
    axes.add_collection(collection, autolim=False)
    return collection


def _no_ellipses(axes: Axes) -> EllipseCollection:
    offsets = {"offsets": np.zeros((0, 2)), "offset_transform": axes.transData}
    return EllipseCollection([], [], [], units="xy", zorder=5, **offsets)
