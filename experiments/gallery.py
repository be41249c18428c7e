"""Show scenarios side by side: road, reference path and goal, the ego, traffic and where it drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import Affine2D, Transform
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from PIL import Image
from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._scene import (
    EGO,
    box_corners,
    draw_surroundings,
    kind_color,
    kind_handles,
    kinds_in,
    surroundings_handles,
)
from experiments._sources import SourceOptions, load_scenarios
from scenarios.command_line import prepare_folder, run_command
from scenarios.files import written_whole

MOST = 16
"""Scenarios in one picture."""
MARGIN = 16.0
"""Road [m] around what a scene is about."""
BEYOND = 12.0
"""A scene reaches this far [m] beyond the goal's start."""
SMALLEST = 60.0
"""No scene is less wide than this [m]."""
SCALE = 20.0
"""Length of the scale's bar [m]."""
STEPS_PER_SHADE = 4
"""Recorded steps of a track that are drawn in one shade."""
PAGE = 10.4
"""Width of four columns, or two of long scenes [inch]."""
PAD = 0.06
"""Space around each scene [inch]."""


@dataclass(frozen=True)
class GalleryOptions(SourceOptions):
    """Draw up to 16 scenarios side by side, as gallery.png."""

    out: Path = Path("runs/gallery")
    """Folder for the picture."""


def gallery(options: GalleryOptions) -> None:
    """Draw the first scenarios that the options ask for, and print where the picture is."""
    found = load_scenarios(options)
    folder = prepare_folder(options.out)
    picture = draw_gallery(found.scenarios[:MOST], found.infos[:MOST])
    with written_whole(folder / "gallery.png") as file:
        picture.quantize(256, kmeans=1, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    print(f"picture    {folder / 'gallery.png'}")


def draw_gallery(found: Sequence[jf.Scenario], infos: Sequence[scenarios.ScenarioInfo]) -> Image.Image:
    """A picture of at least one scenario, in rows of four, or of two if they are long."""
    sizes = np.array([high - low for low, high in map(_extent, found)])
    shape = float(np.clip(np.median(sizes[:, 1] / sizes[:, 0]), 0.15, 1.0))
    most = 4 if shape > 0.4 else 2
    columns = min(most, len(found))
    rows, width = -(-len(found) // columns), PAGE / most
    with matplotlib.rc_context({"font.size": 8, "axes.edgecolor": "#c6cbd0", "axes.linewidth": 0.8}):
        size = (width * columns, (width * shape + 0.4) * rows + 0.3)
        layout = ConstrainedLayoutEngine(w_pad=PAD, h_pad=PAD)
        figure = Figure(figsize=size, dpi=120, layout=layout, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        places = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in places[len(found) :]:
            axes.axis("off")
        scenes = zip(places, found, infos, strict=False)
        for axes, scenario, info in tqdm(scenes, "drawing", len(found), unit=" scenes", delay=5.0):
            _draw_scene(axes, scenario, info.name, shape)
        legend = {"loc": "outside lower center", "ncols": 8 * columns // most, "frameon": False, "fontsize": 9}
        figure.legend(handles=_handles(found), **legend)
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _handles(found: Sequence[jf.Scenario]) -> list[Patch | Line2D]:
    kinds = set[jf.ObstacleKind]().union(*(kinds_in(scenario.obstacles) for scenario in found))
    return [Patch(color=EGO, label="ego"), *surroundings_handles(), *kind_handles(kinds)]


def _draw_scene(axes: Axes, scenario: jf.Scenario, name: str, shape: float) -> None:
    """One scenario at its first step, with the tracks that its traffic will drive, turned so that the ego heads right.

    Args:
      axes: what is drawn into.
      scenario: one scenario, without a batch axis.
      name: the scenario's name.
      shape: height of the picture divided by its width.
    """
    transform = Affine2D().rotate(-float(scenario.initial_state.heading)) + axes.transData
    draw_surroundings(axes, scenario, transform)
    _draw_traffic(axes, scenario.obstacles, transform)
    start, vehicle = scenario.initial_state, jf.PlannerConfig().vehicle
    ego = box_corners(start.position, start.heading, vehicle.length, vehicle.width)
    _draw_box(axes, ego, EGO, transform)
    low, high = _extent(scenario)
    half = 0.5 * max(SMALLEST, high[0] - low[0], (high[1] - low[1]) / shape) * np.array([1.0, shape])
    (left, bottom), (right, top) = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
    _draw_scale(axes, 0.006 * (right - left))
    axes.set_title(name, loc="left", fontsize=8.5, fontweight="bold", pad=15)
    axes.annotate(
        scene_summary(scenario), (0, 1), (0, 4), "axes fraction", "offset points", fontsize=8.5, color="#5b6570"
    )


def _draw_scale(axes: Axes, thickness: float) -> None:
    look = {"color": "#3f4750", "size_vertical": thickness, "fontproperties": FontProperties(size=7)}
    bar = AnchoredSizeBar(axes.transData, SCALE, f"{SCALE:.0f} m", "lower left", pad=0.3, borderpad=0.2, sep=2, **look)
    bar.patch.set(alpha=0.7, linewidth=0.0)
    axes.add_artist(bar)


def _draw_traffic(axes: Axes, obstacles: jf.Obstacles, transform: Transform) -> None:
    """Boxes where the obstacles are first recorded, and tracks that fade with time."""
    position, heading, valid = (np.asarray(leaf) for leaf in (obstacles.position, obstacles.heading, obstacles.valid))
    for obstacle in np.flatnonzero(valid.any(axis=1)):
        color, steps = kind_color(obstacles.kind[obstacle]), np.flatnonzero(valid[obstacle])
        track, first = position[obstacle, steps], steps[0]
        pieces = [track[start : start + STEPS_PER_SHADE + 1] for start in range(0, len(track) - 1, STEPS_PER_SHADE)]
        shades = [to_rgba(color, 0.75 * (1.0 - index / len(pieces))) for index in range(len(pieces))]
        lines = LineCollection(pieces, colors=shades, linewidths=2.0, capstyle="butt", zorder=4, transform=transform)
        axes.add_collection(lines, autolim=False)
        size = obstacles.length[obstacle], obstacles.width[obstacle]
        _draw_box(axes, box_corners(track[0], heading[obstacle, first], *size), color, transform)


def _draw_box(axes: Axes, corners: np.ndarray, color: str, transform: Transform) -> None:
    look = {"facecolors": color, "edgecolors": "white", "linewidths": 0.6, "zorder": 5, "transform": transform}
    axes.add_collection(PolyCollection([corners], **look), autolim=False)


def _extent(scenario: jf.Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner `[2]` [m] of the ego's way to the goal with a margin, in the turned scene."""
    path, start = scenario.path, scenario.initial_state
    arc_length, nodes = np.asarray(path.arc_length), np.stack([path.x, path.y], axis=-1)
    first = arc_length[np.argmin(np.linalg.norm(nodes - np.asarray(start.position), axis=1))]
    last = min(max(float(scenario.goal.arc_length[0, 0]), first) + BEYOND, float(path.length))
    way = np.concatenate([np.asarray(start.position)[None], nodes[(arc_length >= first) & (arc_length <= last)]])
    turned = Affine2D().rotate(-float(start.heading)).transform(way)
    return turned.min(axis=0) - MARGIN, turned.max(axis=0) + MARGIN


def scene_summary(scenario: jf.Scenario) -> str:
    """The ego's turn and start speed, and how much traffic there is."""
    path = scenario.path
    turn = float(np.interp(float(path.length), path.arc_length, path.heading)) - float(path.heading[0])
    way = "straight on" if abs(turn) < np.pi / 4 else "left turn" if turn > 0.0 else "right turn"
    traffic = int(np.asarray(scenario.obstacles.valid).any(axis=1).sum())
    return f"{way}, {float(scenario.initial_state.speed):.1f} m/s, traffic: {traffic}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(GalleryOptions, gallery, "experiments.gallery", arguments)


if __name__ == "__main__":
    main()
