"""Shapes become boxes that contain them; records become states at every step."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios.obstacles import KINDS, Track, resampled, smallest_box

CIRCLE = "<circle><radius>1.5</radius></circle>"
TRIANGLE = "<polygon>" + "".join(
    f"<point><x>{x}</x><y>{y}</y></point>" for x, y in [(-1.0, -0.5), (3.0, 0.0), (-1.0, 0.7)]
)
TRIANGLE += "</polygon>"
OFFSET_BOX = "<rectangle><length>4</length><width>2</width><center><x>1</x><y>0.5</y></center></rectangle>"


def exact(tag: str, value: float | int) -> str:
    return f"<{tag}><exact>{value}</exact></{tag}>"


def state(tag: str, x: float, y: float, step: int, more: str = "") -> str:
    point = f"<position><point><x>{x}</x><y>{y}</y></point></position>"
    return f"<{tag}>{point}{exact('orientation', 0.5)}{exact('time', step)}{more}</{tag}>"


def only(markup: str):
    """An edit that leaves this obstacle alone in the file."""

    def edit(root):
        for node in root.findall("dynamicObstacle"):
            root.remove(node)
        root.insert(list(root).index(root.find("planningProblem")), ElementTree.fromstring(markup))

    return edit


def static(shape: str, kind: str = "parkedVehicle") -> str:
    start = state("initialState", -20.0, 5.0, 0)
    return f"<staticObstacle id='30'><type>{kind}</type><shape>{shape}</shape>{start}</staticObstacle>"


def dynamic(shape: str, motion: str, start: str) -> str:
    return f"<dynamicObstacle id='30'><type>car</type><shape>{shape}</shape>{start}{motion}</dynamicObstacle>"


def local_corners(obstacles: jf.Obstacles, origin: np.ndarray, step: int = 0) -> np.ndarray:
    """Corners of the first obstacle's box in the file's coordinates."""
    heading = float(obstacles.heading[0, step])
    rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    half = 0.5 * np.array([float(obstacles.length[0]), float(obstacles.width[0])])
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray(obstacles.position[0, step]) + origin + (signs * half) @ rotation.T


def moving(shape: str) -> str:
    start = state("initialState", -20.0, 5.0, 0, exact("velocity", 1.0))
    states = "".join(state("state", -20.0 + 0.1 * step, 5.0, step, exact("velocity", 1.0)) for step in range(1, 130))
    return dynamic(shape, f"<trajectory>{states}</trajectory>", start)


def assert_boxes_contain_what_commonroad_io_says(path: Path, steps: range) -> jf.Scenario:
    import shapely
    from commonroad.common.file_reader import CommonRoadFileReader

    scenario = scenarios.load(path)
    recorded: Any = CommonRoadFileReader(path).open()[0].obstacles[0]
    for step in steps:
        box = shapely.Polygon(local_corners(scenario.obstacles, np.asarray(scenario.origin), step))
        shape = recorded.occupancy_at_time(step).shape
        for part in getattr(shape, "shapes", [shape]):
            assert box.buffer(1e-4).contains(part.shapely_object)
    return scenario


@pytest.mark.parametrize("shape", [CIRCLE, TRIANGLE, OFFSET_BOX, OFFSET_BOX + CIRCLE])
def test_static_box_contains_the_shape(edited, shape):
    scenario = assert_boxes_contain_what_commonroad_io_says(edited(only(static(shape))), range(1))
    assert bool(scenario.obstacles.static[0]) and bool(scenario.obstacles.valid.all())
    assert float(np.abs(scenario.obstacles.speed).max()) == 0.0
    assert abs(float(scenario.obstacles.heading[0, 0]) - 0.5) <= np.pi / 4 + 1e-5


@pytest.mark.parametrize(("shape", "size"), [(CIRCLE, (3.0, 3.0)), (TRIANGLE, (4.0, 1.2)), (OFFSET_BOX, (4.0, 2.0))])
def test_moving_box_contains_the_shape(edited, shape, size):
    scenario = assert_boxes_contain_what_commonroad_io_says(edited(only(moving(shape))), range(0, 130, 20))
    obstacles = scenario.obstacles
    np.testing.assert_allclose([float(obstacles.length[0]), float(obstacles.width[0])], size, atol=1e-5)
    np.testing.assert_allclose(np.asarray(obstacles.heading[0]), 0.5, atol=1e-6)
    assert obstacles.valid.shape == (1, 130)


def test_moving_box_contains_several_shapes(edited):
    assert_boxes_contain_what_commonroad_io_says(edited(only(moving(OFFSET_BOX + CIRCLE))), range(0, 130, 20))


def test_record_that_ends_and_speed_from_positions(edited):
    start = state("initialState", -20.0, 5.0, 5)
    states = "".join(
        state("state", -20.0 + 0.1 * np.cos(0.5) * k, 5.0 + 0.1 * np.sin(0.5) * k, 5 + k, exact("acceleration", 0.0))
        for k in range(1, 20)
    )
    obstacles = scenarios.load(edited(only(dynamic(CIRCLE, f"<trajectory>{states}</trajectory>", start)))).obstacles
    valid = np.asarray(obstacles.valid[0])
    assert valid.shape == (121,)
    assert np.flatnonzero(valid).tolist() == list(range(5, 25))
    np.testing.assert_allclose(np.asarray(obstacles.speed[0])[valid], 1.0, atol=1e-4)


def test_set_of_occupancies(edited):
    start = state("initialState", -20.0, 5.0, 0, exact("velocity", 1.0))
    sets = "".join(
        f"<occupancy><shape><rectangle><length>{2.0 + step}</length><width>1.5</width>"
        f"<center><x>{-20.0 + step}</x><y>5</y></center></rectangle></shape>{exact('time', step)}</occupancy>"
        for step in range(1, 4)
    )
    box = "<rectangle><length>2</length><width>1</width></rectangle>"
    scenario = scenarios.load(edited(only(dynamic(box, f"<occupancySet>{sets}</occupancySet>", start))))
    obstacles = scenario.obstacles
    assert np.flatnonzero(np.asarray(obstacles.valid[0])).tolist() == [0, 1, 2, 3]
    assert float(obstacles.length[0]) == pytest.approx(5.0)
    assert float(obstacles.width[0]) == pytest.approx(1.5)
    np.testing.assert_allclose(np.asarray(obstacles.position[0, 3] + scenario.origin), [-17.0, 5.0], atol=1e-5)


def test_environment_and_phantom_obstacles(edited):
    corners = [(-30.0, 10.0), (-25.0, 10.0), (-25.0, 12.0), (-30.0, 12.0)]
    points = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in corners)
    building = "<environmentObstacle id='30'><type>building</type>"
    building += f"<shape><polygon>{points}</polygon></shape></environmentObstacle>"
    obstacles = scenarios.load(edited(only(building))).obstacles
    assert int(obstacles.kind[0]) == jf.ObstacleKind.STRUCTURE and bool(obstacles.static[0])
    assert float(obstacles.length[0]) == pytest.approx(5.0) and float(obstacles.width[0]) == pytest.approx(2.0)

    shape = f"<shape><polygon>{points}</polygon></shape>"
    phantom = f"<occupancySet><occupancy>{shape}{exact('time', 2)}</occupancy></occupancySet>"
    phantom = f"<phantomObstacle id='30'>{phantom}</phantomObstacle>"
    obstacles = scenarios.load(edited(only(phantom))).obstacles
    assert np.flatnonzero(np.asarray(obstacles.valid[0])).tolist() == [2]


def test_every_type_has_a_kind():
    types = pytest.importorskip("commonroad.scenario.obstacle").ObstacleType
    assert {one.value for one in types} - set(KINDS) == {"unknown"}


def test_smallest_box_of_a_turned_rectangle():
    rotation = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    corners = np.array([[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]]) @ rotation.T + [5.0, 6.0]
    center, heading, extent = smallest_box(corners)
    np.testing.assert_allclose(center, [5.0, 6.0], atol=1e-9)
    np.testing.assert_allclose(extent, [4.0, 2.0], atol=1e-9)
    assert np.sin(2.0 * (heading - 0.3)) == pytest.approx(0.0, abs=1e-9)


def test_resampling_takes_the_short_way_round():
    states = np.array([[0.0, 0.0, np.pi - 0.1, 1.0], [1.0, 0.0, -np.pi + 0.1, 3.0]])
    track = Track(0, states, 4.0, 2.0, jf.ObstacleKind.CAR, static=False)
    between, valid = resampled(track, 0.2, 0, 4)
    assert valid.tolist() == [True, True, True, False]
    np.testing.assert_allclose(between[1], [0.5, 0.0, np.pi, 2.0], atol=1e-9)


def test_no_state_is_made_up_across_a_gap():
    states = np.zeros((4, 4))
    states[1] = np.nan
    track = Track(0, states, 4.0, 2.0, jf.ObstacleKind.CAR, static=False)
    assert resampled(track, 0.2, 0, 7)[1].tolist() == [True, False, False, False, True, True, True]
