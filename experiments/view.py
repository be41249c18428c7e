"""Drive one scenario and show it: road, traffic with predictions, sampled bundle, chosen trajectory, speed, cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._driving import DrivingOptions, chosen_planner
from experiments._movies import write_gif, write_mp4
from experiments._recording import Recording, record
from experiments._road_view import RoadView
from experiments._sources import load_scenarios
from experiments._time_plots import TimePlots
from scenarios.command_line import UserError, prepare_folder, run_command
from scenarios.files import written_whole

STEPS_PER_FRAME = 2
SECONDS_PER_FRAME = 0.1
HOLD = 2.0
"""How long an animation stands still at its end [s]."""


@dataclass(frozen=True)
class ViewOptions(DrivingOptions):
    """Drive one scenario and write an animation and a still picture of it."""

    name: str | None = None
    """Name of the scenario to show; the first one where it is not given."""
    format: Literal["gif", "mp4", "png"] = "gif"
    """Kind of animation; `png` writes the still picture alone."""
    out: Path = Path("runs/view")
    """Folder for the results."""


class Film:
    """Frames of a recording, drawn one at a time."""

    def __init__(self, recording: Recording, vehicle: jf.Vehicle) -> None:
        """Lay the figure out."""
        self._recording = recording
        with matplotlib.rc_context({"font.size": 8, "axes.edgecolor": "#8b939c", "axes.linewidth": 0.8}):
            self._figure = Figure(figsize=(10.4, 5.6), dpi=100, layout="constrained", facecolor="white")
            self._canvas = FigureCanvasAgg(self._figure)
            grid = self._figure.add_gridspec(3, 2, width_ratios=(2.6, 1.0))
            self._road = RoadView(self._figure.add_subplot(grid[:, 0]), recording, vehicle)
            self._plots = TimePlots([self._figure.add_subplot(grid[row, 1]) for row in range(3)], recording)
        self._title = self._figure.suptitle(self._headline(0), x=0.01, ha="left", fontsize=10, fontweight="bold")
        self.frame(0)
        self._figure.set_layout_engine("none")

    def frame(self, step: int) -> np.ndarray:
        """The picture at a step: `[height, width, 3]`, uint8."""
        self._road.show(step)
        self._plots.show(step)
        self._title.set_text(self._headline(step))
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _headline(self, step: int) -> str:
        recording = self._recording
        if step == len(recording.cycles):
            state = recording.outcome.name.lower().replace("_", " ")
        else:
            state = f"planning: {jf.PlanMode(int(recording.cycles[step].mode)).name.lower()}"
        return f"{recording.name}    t = {jf.DT * step:4.1f} s    {state}"


def frame_steps(steps: int) -> list[int]:
    """Steps that become frames: every second, and the last."""
    return [*range(0, steps, STEPS_PER_FRAME), steps]


def key_step(recording: Recording) -> int:
    """The step whose picture tells most: the costliest cycle whose chosen trajectory is longer than most."""
    length = np.array([np.ptp(cycle.trajectory.arc_length) for cycle in recording.cycles])
    cost = np.array([report.cost for report in recording.reports])
    return int(np.argmax(np.where(length >= np.median(length), cost, -np.inf)))


def choose(found: scenarios.ScenarioSet, name: str | None) -> int:
    """Index of the scenario with a name; the first one for None.

    Raises:
      UserError: there is no such scenario.
    """
    names = [info.name for info in found.infos]
    if name is None:
        return 0
    if name not in names:
        raise UserError(f"--name {name}: no such scenario; there are {', '.join(names[:10])}{' …' * (len(names) > 10)}")
    return names.index(name)


def view(options: ViewOptions) -> None:
    """Drive the chosen scenario, write its pictures, and print where they are."""
    planner = chosen_planner(options)
    found = load_scenarios(options)
    index = choose(found, options.name)
    folder = prepare_folder(options.out)
    with tqdm(desc="driving", unit=" steps", mininterval=1.0, total=jf.max_steps(found.scenarios[index])) as bar:
        recording = record(planner, found.infos[index].name, found.scenarios[index], bar.update)
    film = Film(recording, planner.config.vehicle)
    still = folder / f"{recording.name}.png"
    with written_whole(still) as file:
        Image.fromarray(film.frame(key_step(recording))).quantize(256, dither=Image.Dither.NONE).save(file, "PNG")
    print(f"outcome    {recording.outcome.name.lower()} after {jf.DT * len(recording.cycles):.1f} s")
    print(f"picture    {still}")
    if options.format != "png":
        print(f"animation  {_write_animation(film, recording, folder, options.format)}")


def _write_animation(film: Film, recording: Recording, folder: Path, kind: Literal["gif", "mp4"]) -> Path:
    target = folder / f"{recording.name}.{kind}"
    steps = tqdm(frame_steps(len(recording.cycles)), desc="drawing", unit=" frames", mininterval=1.0)
    write = write_gif if kind == "gif" else write_mp4
    with written_whole(target) as file:
        write(file, map(film.frame, steps), SECONDS_PER_FRAME, HOLD)
    return target


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(ViewOptions, view, "experiments.view", arguments)


if __name__ == "__main__":
    main()
