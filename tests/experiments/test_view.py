from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

import jaxfrenet as jf
import scenarios
from experiments import view
from experiments._movies import write_mp4
from experiments._outlines import filled_area


@pytest.fixture(scope="module")
def name():
    return scenarios.load_set(scenarios.builtin_paths()[:1]).infos[0].name


def test_animation_has_a_frame_for_every_second_step(viewed, name):
    scenario = scenarios.load_set(scenarios.builtin_paths()[:1]).scenarios[0]
    episode = jf.roll_out(jf.PlannerConfig(), scenario, jf.CostWeights(), jf.max_steps(scenario))
    with Image.open(viewed / f"{name}.gif") as animation:
        assert len(list(ImageSequence.Iterator(animation))) == len(view.frame_steps(int(episode.steps)))
        assert animation.size == (1040, 560)


def test_animation_is_small_enough_to_send(viewed, name):
    assert (viewed / f"{name}.gif").stat().st_size < 6_000_000


def test_picture_shows_road_ego_and_bundle(viewed, name):
    with Image.open(viewed / f"{name}.png") as picture:
        assert picture.size == (1040, 560)
        colors = {tuple(color) for color in np.asarray(picture.convert("RGB")).reshape(-1, 3)}
    assert any(np.abs(np.subtract(color, (211, 215, 220))).max() < 8 for color in colors), "no road"
    assert any(np.abs(np.subtract(color, (215, 38, 61))).max() < 8 for color in colors), "no ego"


def test_nothing_else_is_written(viewed, name):
    assert {path.name for path in viewed.iterdir()} == {f"{name}.gif", f"{name}.png"}


def test_film_has_its_frames_and_the_hold(tmp_path):
    frames = [np.full((16, 32, 3), level, np.uint8) for level in (0, 80, 160, 240)]
    with (tmp_path / "film.mp4").open("wb") as file:
        write_mp4(file, iter(frames), seconds_per_frame=0.1, hold=0.2)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert count == 6
    assert seconds == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("steps, frames", [(0, [0]), (1, [0, 1]), (4, [0, 2, 4]), (5, [0, 2, 4, 5])])
def test_frames_end_with_the_last_step(steps, frames):
    assert view.frame_steps(steps) == frames


def square(x, y, size):
    corners = np.array([[x, y], [x + size, y], [x + size, y + size], [x, y + size]], float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def test_a_hole_is_not_filled():
    segments = np.concatenate([square(0, 0, 10), square(2, 2, 3)[::-1, ::-1], square(20, 0, 5)])
    np.random.default_rng(0).shuffle(segments)
    area = filled_area(segments)
    assert area is not None
    winding = [_winding_number(area.to_polygons(), point) for point in ((1, 1), (3, 3), (22, 2), (15, 2))]
    assert [number != 0 for number in winding] == [True, False, True, False]


def _winding_number(rings, point):
    total = 0.0
    for ring in rings:
        angles = np.unwrap(np.arctan2(*(ring - point).T[::-1]))
        total += angles[-1] - angles[0]
    return round(total / (2 * np.pi))


def test_no_segments_fill_nothing():
    assert filled_area(np.zeros((0, 2, 2))) is None
