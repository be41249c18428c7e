"""Everything that can be wrong with a scenario source is reported in one line that says what, where and what to do."""

from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

import pytest

import scenarios
from scenarios import ScenarioError


def message(call, *arguments) -> str:
    with pytest.raises(ScenarioError) as caught:
        call(*arguments)
    text = str(caught.value)
    assert "\n" not in text and "Traceback" not in text and len(text) < 400
    return text


def remove(tag: str, parent: str = "."):
    def edit(root):
        node = root if parent == "." else root.find(parent)
        for child in node.findall(tag):
            node.remove(child)

    return edit


def set_text(path: str, text: str):
    def edit(root):
        root.find(path).text = text

    return edit


def test_missing_file(tmp_path):
    assert "no such file" in message(scenarios.load, tmp_path / "nothing.xml")
    assert "no such file or folder" in message(scenarios.load_set, [tmp_path / "nothing"])
    assert "no such file" in message(scenarios.load_npz, tmp_path / "nothing.npz")


def test_nothing_asked_for():
    assert "no scenario given" in message(scenarios.load_set, [])


def test_folder_without_scenarios(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    assert "holds no CommonRoad file" in message(scenarios.load_set, [tmp_path])


def test_unknown_kind_of_file(tmp_path):
    path = tmp_path / "scenario.json"
    path.write_text("{}")
    assert "neither a folder nor one of .xml" in message(scenarios.load_set, [path])


@pytest.mark.parametrize("name", ["empty.tar.xz", "empty.zip", "empty.tar.gz"])
def test_archive_of_no_bytes(tmp_path, name):
    (tmp_path / name).touch()
    assert "archive is empty" in message(scenarios.load_set, [tmp_path / name])


def test_archive_without_members(tmp_path):
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    assert "holds no CommonRoad file" in message(scenarios.load_set, [tmp_path / "empty.zip"])


def test_truncated_archive(tmp_path, t_junction_file):
    path = tmp_path / "set.tar.xz"
    with tarfile.open(path, "w:xz") as archive:
        archive.add(t_junction_file, arcname="one.xml")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert "not a complete archive" in message(scenarios.load_set, [path])


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "file is empty"),
        (b"  \n ", "file is empty"),
        (b"<commonRoad><lanelet", "not a complete XML file"),
        (b"no markup at all", "not a complete XML file"),
        (b"<html><body/></html>", "not a CommonRoad scenario (its root is <html>)"),
        (b"<commonRoad commonRoadVersion='2020a'/>", "timeStepSize"),
        (b"<commonRoad timeStepSize='0' commonRoadVersion='2020a'/>", "timeStepSize"),
        (b"<commonRoad timeStepSize='0.1' commonRoadVersion='2020a'/>", "no planning problem"),
    ],
)
def test_bad_content(tmp_path, content, expected):
    path = tmp_path / "bad.xml"
    path.write_bytes(content)
    text = message(scenarios.load, path)
    assert text.startswith(f"{path}: ") and expected in text


def test_truncated_file(tmp_path, t_junction_file):
    path = tmp_path / "truncated.xml"
    path.write_bytes(t_junction_file.read_bytes()[:-5000])
    assert "not a complete XML file" in message(scenarios.load, path)


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (remove("planningProblem"), "no planning problem"),
        (remove("goalState", "planningProblem"), "planning problem 100 has no goal state"),
        (remove("velocity", "planningProblem/initialState"), "the initial state has no velocity"),
        (remove("shape", "dynamicObstacle"), "obstacle 20 has no shape"),
        (remove("rectangle", "dynamicObstacle/shape"), "obstacle 20 has no shape"),
        (remove("time", "dynamicObstacle/initialState"), "obstacle 20: the initial state has no time"),
        (remove("leftBound", "lanelet"), "cannot read it"),
        (
            set_text("planningProblem/initialState/velocity/exact", "nan"),
            "planningProblem 100 initialState velocity is nan",
        ),
        (
            set_text("planningProblem/initialState/acceleration/exact", "-inf"),
            "planningProblem 100 initialState acceleration is -inf",
        ),
        (
            set_text("dynamicObstacle/trajectory/state/position/point/x", "NaN"),
            "dynamicObstacle 20 trajectory state position is NaN",
        ),
        (set_text("planningProblem/initialState/velocity/exact", "fast"), "cannot read it"),
        (set_text("planningProblem/initialState/yawRate/exact", "fast"), "cannot read it"),
        (set_text("planningProblem/initialState/position/point/y", "500"), "ego starts outside every lanelet"),
    ],
)
def test_bad_field(edited, edit, expected):
    assert expected in message(scenarios.load, edited(edit))


def test_goal_that_no_route_reaches(edited):
    def drive_the_wrong_way(root):
        root.find("planningProblem/goalState/position/lanelet").set("ref", "10")

    text = message(scenarios.load, edited(drive_the_wrong_way))
    assert "no route from lanelet 1 to the goal on lanelet 10" in text


def test_unknown_planning_problem(t_junction_file):
    assert "no planning problem 7; the file has 100" in message(scenarios.load, t_junction_file, 7)


def test_lanelet_without_length(edited):
    def shrink(root):
        for bound in ("leftBound", "rightBound"):
            points = root.find(f"lanelet[@id='3']/{bound}").findall("point")
            for point in points[1:]:
                point.find("x").text, point.find("y").text = points[0].find("x").text, points[0].find("y").text

    assert "not consistent" in message(scenarios.load, edited(shrink))


def test_one_bad_file_among_many_is_skipped_and_listed(tmp_path, t_junction_file):
    (tmp_path / "good.xml").write_bytes(t_junction_file.read_bytes())
    (tmp_path / "bad.xml").write_bytes(b"")
    loaded = scenarios.load_set([tmp_path])
    assert [info.name for info in loaded.infos] == ["good"]
    assert loaded.skipped == ((str(tmp_path / "bad.xml"), "file is empty; give a CommonRoad XML file"),)


def test_only_bad_files(tmp_path):
    (tmp_path / "first.xml").write_bytes(b"")
    (tmp_path / "second.xml").write_bytes(b"<html/>")
    text = message(scenarios.load_set, [tmp_path])
    assert "none of 2 scenarios can be used" in text and "file is empty" in text


def test_bad_file_alone(tmp_path: Path):
    path = tmp_path / "bad.xml"
    path.write_bytes(b"")
    assert message(scenarios.load_set, [path]).startswith(f"{path}: file is empty")


@pytest.mark.parametrize("keep", [0, 10, 1000])
def test_truncated_or_foreign_npz(tmp_path, t_junction_file, keep):
    path = tmp_path / "set.npz"
    scenarios.save_npz(path, scenarios.load_set([t_junction_file]))
    path.write_bytes(path.read_bytes()[:keep])
    assert "not a complete set of scenarios" in message(scenarios.load_npz, path)
