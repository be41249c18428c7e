"""Drive one scenario and show it: road, traffic with predictions, sampled bundle, chosen trajectory, charts."""

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
from experiments._charts import film_charts
from experiments._driving import DrivingOptions, chosen_planner, other_planners, own_name
from experiments._movies import write_gif, write_mp4
from experiments._planners import Planner
from experiments._player import player_page
from experiments._recording import Recording, record
from experiments._road_view import RoadView
from experiments._sources import choose, load_scenarios
from experiments._time_plots import TimePlots
from scenarios.command_line import prepare_folder, run_command
from scenarios.files import written_whole

STEPS_PER_FRAME = 2
SECONDS_PER_FRAME = 0.1
HOLD = 2.0
"""How long an animation stands still at its end [s]."""


@dataclass(frozen=True)
class ViewOptions(DrivingOptions):
    """Drive one scenario and show it: a page that plays it in any browser, or an animation, and a still picture.

    The page is one file that needs no network. It shows road, traffic with predictions, all sampled trajectories, by
    their cost or by why they cannot be driven, the chosen one, and charts of speed, risk, weights and cost terms.
    Space plays and pauses, the arrow keys step, shift and an arrow go by a second.
    """

    name: str | None = None
    """Name of the scenario to show; the first one where it is not given."""
    compare: str | None = None
    """Drive another planner, too, and lay its episode over the first: `default`, `shipped` (the policy that comes with
    the project) or a policy's folder."""
    format: Literal["html", "gif", "mp4", "png"] = "html"
    """`html` is a page with a player, `gif` and `mp4` are animations; `png` writes the still picture alone."""
    out: Path = Path("runs/view")
    """Folder for the results."""


class Film:
    """Frames of an episode, drawn one at a time; a second planner's drive is laid over the first."""

    def __init__(self, recordings: Sequence[Recording], vehicle: jf.Vehicle) -> None:
        """Lay the figure out."""
        self._recordings = recordings
        charts = film_charts(recordings)
        with matplotlib.rc_context({"font.size": 8, "axes.edgecolor": "#8b939c", "axes.linewidth": 0.8}):
            self._figure = Figure(figsize=(10.4, 5.6), dpi=100, layout="constrained", facecolor="white")
            self._canvas = FigureCanvasAgg(self._figure)
            grid = self._figure.add_gridspec(len(charts), 2, width_ratios=(2.6, 1.0))
            self._road = RoadView(self._figure.add_subplot(grid[:, 0]), recordings, vehicle)
            beside = [self._figure.add_subplot(grid[row, 1]) for row in range(len(charts))]
            self._plots = TimePlots(beside, charts)
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
        states = [_state(one, step) for one in self._recordings]
        if len(self._recordings) > 1:
            states = [f"{one.planner}: {state}" for one, state in zip(self._recordings, states, strict=True)]
        return "    ".join([self._recordings[0].name, f"t = {jf.DT * step:4.1f} s", *states])


def _state(recording: Recording, step: int) -> str:
    """What the planner does at a step, or how its episode has ended."""
    if step >= len(recording.cycles):
        return recording.outcome.name.lower().replace("_", " ")
    return f"planning: {jf.PlanMode(int(recording.cycles[step].mode)).name.lower()}"


def frame_steps(steps: int) -> list[int]:
    """Steps that become frames: every second, and the last."""
    return [*range(0, steps, STEPS_PER_FRAME), steps]


def key_step(recording: Recording) -> int:
    """The step whose picture tells most: the costliest cycle whose chosen trajectory is longer than most."""
    length = np.array([np.ptp(cycle.trajectory.arc_length) for cycle in recording.cycles])
    cost = np.array([report.cost for report in recording.reports])
    return int(np.argmax(np.where(length >= np.median(length), cost, -np.inf)))


def view(options: ViewOptions) -> None:
    """Drive the chosen scenario, write what shows it, and print where that is."""
    planners = _planners(options)
    found = load_scenarios(options)
    index = choose(found, options.name)
    folder = prepare_folder(options.out)
    recordings = _record(planners, found.infos[index].name, found.scenarios[index])
    vehicle = next(iter(planners.values())).config.vehicle
    film = Film(recordings, vehicle)
    still = folder / f"{recordings[0].name}.png"
    with written_whole(still) as file:
        Image.fromarray(film.frame(key_step(recordings[0]))).quantize(256, dither=Image.Dither.NONE).save(file, "PNG")
    for one in recordings:
        seconds = jf.DT * len(one.cycles)
        print(f"outcome    {one.outcome.name.lower()} after {seconds:.1f} s, planner {one.planner}")
    print(f"picture    {still}")
    if options.format == "html":
        print(f"player     {_write_player(recordings, vehicle, folder)}")
    elif options.format != "png":
        print(f"animation  {_write_animation(film, recordings, folder, options.format)}")


def _planners(options: ViewOptions) -> dict[str, Planner]:
    """What drives, by names: the planner that is shown, and the one that is laid over it."""
    planner = chosen_planner(options)
    others = {} if options.compare is None else other_planners(options, [options.compare], planner.config)
    return {own_name(options): planner} | others


def _record(planners: dict[str, Planner], name: str, scenario: jf.Scenario) -> list[Recording]:
    recordings = []
    for called, planner in planners.items():
        with tqdm(desc=f"driving ({called})", unit=" steps", mininterval=1.0, total=jf.max_steps(scenario)) as bar:
            recordings.append(record(planner, called, name, scenario, bar.update))
    return recordings


def _write_player(recordings: Sequence[Recording], vehicle: jf.Vehicle, folder: Path) -> Path:
    target = folder / f"{recordings[0].name}.html"
    with written_whole(target) as file:
        file.write(player_page(recordings, vehicle).encode())
    return target


def _write_animation(film: Film, recordings: Sequence[Recording], folder: Path, kind: Literal["gif", "mp4"]) -> Path:
    target = folder / f"{recordings[0].name}.{kind}"
    frames = frame_steps(max(len(one.cycles) for one in recordings))
    steps = tqdm(frames, desc="drawing", unit=" frames", mininterval=1.0)
    write = write_gif if kind == "gif" else write_mp4
    with written_whole(target) as file:
        write(file, map(film.frame, steps), SECONDS_PER_FRAME, HOLD)
    return target


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(ViewOptions, view, "experiments.view", arguments)


if __name__ == "__main__":
    main()
