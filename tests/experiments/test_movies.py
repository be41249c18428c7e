from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from experiments import view
from experiments._charts import Chart, Line
from experiments._movies import write_gif, write_mp4

FRAMES = [np.full((16, 32, 3), level, np.uint8) for level in (0, 80, 160, 240)]


def test_film_has_its_frames_and_the_hold(tmp_path):
    with (tmp_path / "film.mp4").open("wb") as file:
        write_mp4(file, iter(FRAMES), seconds_per_frame=0.1, hold=0.2)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert count == 6
    assert seconds == pytest.approx(0.6, abs=0.02)


def test_last_frame_of_a_gif_stands_longer(tmp_path):
    with (tmp_path / "film.gif").open("wb") as file:
        write_gif(file, iter(FRAMES), seconds_per_frame=0.1, hold=0.5)
    with Image.open(tmp_path / "film.gif") as animation:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(animation)]
    assert sum(durations) == 900
    assert durations[-1] == 600


@pytest.mark.parametrize("steps, frames", [(0, [0]), (1, [0, 1]), (4, [0, 2, 4]), (5, [0, 2, 4, 5])])
def test_frames_end_with_the_last_step(steps, frames):
    assert view.frame_steps(steps) == frames


def limits(*values, logarithmic):
    return Chart("", "", logarithmic, [Line("", "", "#000000", np.array(values))]).limits


def test_logarithmic_axis_spans_what_matters():
    low, high = limits(0.0, 1e-30, 1e-3, logarithmic=True)
    assert 1e-10 < low < 1e-8 and 1e-3 < high < 1e-2
    assert limits(0.0, 0.0, logarithmic=True) == (0.1, 1.0)


def test_linear_axis_has_zero_and_all_values():
    low, high = limits(-2.0, 5.0, logarithmic=False)
    assert low < -2.0 and high > 5.0
    assert limits(3.0, 5.0, logarithmic=False)[0] == 0.0
