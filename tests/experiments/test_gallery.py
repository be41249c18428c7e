from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import scenarios
from experiments import gallery
from experiments._scene import EGO, GOAL, KIND_COLORS, SURFACE
from scenarios.families import Draw, generate


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The folder with the gallery of two generated scenarios."""
    out = tmp_path_factory.mktemp("gallery")
    gallery.main(["--generate", "2", "--out", str(out)])
    return out


def has_color(picture: np.ndarray, color: str) -> bool:
    wanted = [int(color[place : place + 2], 16) for place in (1, 3, 5)]
    return bool((np.abs(picture.astype(int) - wanted).max(axis=-1) < 10).any())


def test_picture_shows_road_goal_ego_and_traffic(shown):
    assert {path.name for path in shown.iterdir()} == {"gallery.png"}
    with Image.open(shown / "gallery.png") as file:
        picture = np.asarray(file.convert("RGB"))
    assert all(has_color(picture, color) for color in (SURFACE, GOAL, EGO, *set(KIND_COLORS.values()) & traffic()))


def traffic() -> set[str]:
    """Colours of the kinds that are there at the first step."""
    every = [one.obstacles for one in generate(Draw(2)).scenarios]
    return {KIND_COLORS[kind] for one in every for kind in np.asarray(one.kind)[np.asarray(one.valid)[:, 0]].tolist()}


def test_files_can_be_shown_and_rows_hold_four(tmp_path):
    gallery.main(["--scenarios", "builtin", "--out", str(tmp_path)])
    with Image.open(tmp_path / "gallery.png") as file:
        two = file.size
    found = scenarios.load_set(scenarios.builtin_paths()[:1])
    five = gallery.draw_gallery(found.scenarios * 5, found.infos * 5).size
    assert five[0] == 2 * two[0] and five[1] > 1.8 * two[1]


@pytest.mark.parametrize("angle, way", [(1.2, "left turn"), (-1.2, "right turn"), (0.3, "straight on")])
def test_title_names_the_turn(angle, way):
    scenario = scenarios.load(scenarios.builtin_paths()[0])
    heading = jnp.linspace(0.0, angle, len(scenario.path.arc_length), dtype=jnp.float32)
    path = dataclasses.replace(scenario.path, heading=heading)
    assert gallery.scene_summary(dataclasses.replace(scenario, path=path)).startswith(way)
