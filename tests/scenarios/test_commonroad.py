"""What a CommonRoad file says arrives in the arrays."""

from __future__ import annotations

import copy
import math
from xml.etree import ElementTree

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios.commonroad import local_origin

GOAL = "planningProblem/goalState"


def goal_position(markup: str | None):
    """An edit that replaces the goal's position; None removes it."""

    def edit(root):
        goal = root.find(GOAL)
        goal.remove(goal.find("position"))
        if markup is not None:
            goal.insert(0, ElementTree.fromstring(f"<position>{markup}</position>"))

    return edit


def test_t_junction(t_junction_file):
    scenario, info = scenarios.load_with_info(t_junction_file)
    assert (info.name, info.planning_problem_id, info.initial_time_step, info.file_dt) == (
        "ZAM_Builtin-1_1_T-1",
        100,
        0,
        0.1,
    )
    np.testing.assert_allclose(np.asarray(scenario.origin), [0.0, 0.0])
    np.testing.assert_allclose(np.asarray(scenario.initial_state.position), [-40.0, -1.75], atol=1e-6)
    assert float(scenario.initial_state.speed) == 7.0
    assert scenario.obstacles.valid.shape == (4, 121) and bool(scenario.obstacles.valid.all())
    np.testing.assert_allclose(np.asarray(scenario.obstacles.length), 4.6, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(scenario.obstacles.width), 1.9, rtol=1e-6)
    assert set(np.asarray(scenario.obstacles.kind).tolist()) == {jf.ObstacleKind.CAR}
    # The first oncoming car: 8 m/s from x = 24 to the west.
    first = np.asarray(scenario.obstacles.position[0]) + np.asarray(scenario.origin)
    np.testing.assert_allclose(first[:, 0], 24.0 - 0.8 * np.arange(121), atol=1e-3)
    np.testing.assert_allclose(first[:, 1], 1.75, atol=1e-3)
    assert np.asarray(scenario.goal.steps).tolist() == [[110, 120]]
    assert np.asarray(scenario.goal.speed).tolist() == [[0.0, 10.0]]
    assert bool(scenario.goal.has_speed[0]) and bool(scenario.goal.has_position[0])
    assert float(scenario.goal.heading[0, 1]) >= math.pi


def test_t_junction_goal_lies_along_the_path(t_junction):
    entry, leave = np.asarray(t_junction.goal.arc_length)[0]
    # 30 m behind the ego, 30 m to the junction, and the turn.
    assert 78.0 < entry < 81.0
    assert leave - entry == pytest.approx(90.0, abs=0.5)
    assert float(t_junction.path.length) >= leave + 30.0


def test_no_position_in_the_goal(edited):
    scenario = scenarios.load(edited(goal_position(None)))
    assert not bool(scenario.goal.has_position[0])
    assert np.asarray(scenario.goal.arc_length)[0].tolist() == [0.0, float(scenario.path.length)]
    # 12 s at 10 m/s and 10 m more; straight on is the simplest way to get there.
    assert float(scenario.path.length) > 160.0
    assert float(np.abs(scenario.path.curvature).max()) < 1e-3


def test_goal_as_rectangle(edited):
    box = "<rectangle><length>10</length><width>4</width><orientation>1.5708</orientation>"
    box += "<center><x>1.75</x><y>50</y></center></rectangle>"
    scenario = scenarios.load(edited(goal_position(box)))
    entry, leave = np.asarray(scenario.goal.arc_length)[0]
    assert leave - entry == pytest.approx(10.0, abs=0.5)
    edges = np.asarray(scenario.goal.edges)[0] + np.asarray(scenario.origin)
    np.testing.assert_allclose(edges[..., 1].max(), 55.0, atol=1e-3)


def test_goal_as_circle_and_polygon(edited):
    circle = "<circle><radius>3</radius><center><x>1.75</x><y>30</y></center></circle>"
    scenario = scenarios.load(edited(goal_position(circle)))
    entry, leave = np.asarray(scenario.goal.arc_length)[0]
    assert leave - entry == pytest.approx(6.0, abs=0.6)
    corners = [(0, 20), (3, 20), (3, 40), (0, 40)]
    points = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in corners)
    scenario = scenarios.load(edited(goal_position(f"<polygon>{points}</polygon>")))
    entry, leave = np.asarray(scenario.goal.arc_length)[0]
    assert leave - entry == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize(
    ("position", "origin"),
    [((-49.0, 49.9), (0.0, 0.0)), ((-51.0, 50.1), (-100.0, 100.0)), ((4_512_345.6, -1e6), (4_512_300.0, -1e6))],
)
def test_origins_lie_on_a_grid(position, origin):
    found = local_origin(np.array(position))
    assert found.tobytes() == np.array(origin).tobytes()


def test_map_is_the_same_wherever_the_ego_starts(edited, t_junction):
    def start_elsewhere(root):
        root.find("planningProblem/initialState/position/point/x").text = "-33.3"

    other = scenarios.load(edited(start_elsewhere))
    assert np.asarray(other.initial_state.position).tolist() != np.asarray(t_junction.initial_state.position).tolist()
    for one, same in ((other.road.segments, t_junction.road.segments), (other.origin, t_junction.origin)):
        assert np.asarray(one).tobytes() == np.asarray(same).tobytes()


def test_several_goal_states(edited):
    def add_goal(root):
        problem = root.find("planningProblem")
        other = copy.deepcopy(problem.find("goalState"))
        other.find("position/lanelet").set("ref", "4")
        other.remove(other.find("velocity"))
        orientation = "<orientation><intervalStart>-0.2</intervalStart><intervalEnd>0.4</intervalEnd></orientation>"
        other.append(ElementTree.fromstring(orientation))
        problem.append(other)

    scenario = scenarios.load(edited(add_goal))
    assert np.asarray(scenario.goal.valid).tolist() == [True, True]
    assert np.asarray(scenario.goal.has_speed).tolist() == [True, False]
    np.testing.assert_allclose(np.asarray(scenario.goal.heading[1]), [0.1, 0.3], atol=1e-6)
    # The turn (18 m) is a little shorter than going straight on (20 m).
    assert float(np.abs(scenario.path.curvature).max()) > 0.05


def test_several_planning_problems(edited):
    def add_problem(root):
        other = copy.deepcopy(root.find("planningProblem"))
        other.set("id", "200")
        other.find("initialState/velocity/exact").text = "5.5"
        root.append(other)

    path = edited(add_problem)
    assert float(scenarios.load(path).initial_state.speed) == 7.0
    assert float(scenarios.load(path, 200).initial_state.speed) == 5.5
    assert scenarios.load_with_info(path, 200)[1].planning_problem_id == 200
    assert float(scenarios.load_set([path], planning_problem=200).scenarios[0].initial_state.speed) == 5.5


def test_missing_state_values_are_zero(edited):
    def strip(root):
        initial = root.find("planningProblem/initialState")
        initial.remove(initial.find("acceleration"))
        initial.remove(initial.find("slipAngle"))
        initial.find("yawRate/exact").text = "0.25"

    state = scenarios.load(edited(strip)).initial_state
    assert float(state.acceleration) == 0.0
    assert float(state.yaw_rate) == 0.25
    assert float(state.speed) == 7.0


def test_heading_is_continuous_with_the_path(edited):
    def turn(root):
        root.find("planningProblem/initialState/orientation/exact").text = str(2.0 * math.pi + 0.01)

    scenario, info = scenarios.load_with_info(edited(turn))
    assert float(scenario.initial_state.heading) == pytest.approx(0.01, abs=1e-4)
    assert info.initial_heading == pytest.approx(2.0 * math.pi + 0.01)


def test_later_initial_time_step(edited, t_junction):
    def start_later(root):
        root.find("planningProblem/initialState/time/exact").text = "10"

    scenario, info = scenarios.load_with_info(edited(start_later))
    assert info.initial_time_step == 10
    assert np.asarray(scenario.goal.steps).tolist() == [[100, 110]]
    np.testing.assert_allclose(
        np.asarray(scenario.obstacles.position), np.asarray(t_junction.obstacles.position[:, 10:]), atol=1e-5
    )


def test_other_time_step_size_is_resampled(edited):
    def slow_down(root):
        root.set("timeStepSize", "0.25")

    scenario = scenarios.load(edited(slow_down))
    assert np.asarray(scenario.goal.steps).tolist() == [[275, 300]]
    assert scenario.obstacles.valid.shape == (4, 301) and bool(scenario.obstacles.valid.all())
    # 0.8 m per file step of 0.25 s.
    first = np.asarray(scenario.obstacles.position[0, :, 0]) + float(scenario.origin[0])
    np.testing.assert_allclose(first, 24.0 - 0.32 * np.arange(301), atol=2e-3)


def test_goal_steps_are_rounded_into_the_interval(edited):
    def change(root):
        root.set("timeStepSize", "0.04")
        root.find(f"{GOAL}/time/intervalStart").text = "251"
        root.find(f"{GOAL}/time/intervalEnd").text = "259"

    # 10.04 s to 10.36 s.
    assert np.asarray(scenarios.load(edited(change)).goal.steps).tolist() == [[101, 103]]


def test_no_obstacles(edited):
    def clear(root):
        for node in root.findall("dynamicObstacle"):
            root.remove(node)

    obstacles = scenarios.load(edited(clear)).obstacles
    assert obstacles.valid.shape == (1, 121) and not bool(obstacles.valid.any())


def test_lanes_beside_the_route(t_junction, two_lanes):
    before_junction, in_turn = 100, 280
    assert np.asarray(t_junction.lanes.direction[before_junction]).tolist() == [1, -1, 0]
    np.testing.assert_allclose(np.asarray(t_junction.lanes.center[before_junction]), [0.0, 3.5, 0.0], atol=0.1)
    np.testing.assert_allclose(np.asarray(t_junction.lanes.width[before_junction]), [3.5, 3.5, 0.0], atol=0.02)
    assert np.asarray(t_junction.lanes.direction[in_turn]).tolist() == [1, 0, 0]
    assert np.asarray(two_lanes.lanes.direction[400]).tolist() == [1, 1, 0]
