"""Reference paths and routes, against what can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios import polyline, route, route_path
from scenarios.errors import ScenarioError
from scenarios.lanelets import Lanelet, Neighbor, Network


def lanelet(id_: int, center: np.ndarray, successors=(), predecessors=(), left=None, right=None) -> Lanelet:
    """A lanelet of 3.5 m around a centre line."""
    tangent = np.gradient(center, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return Lanelet(id_, center + 1.75 * normal, center - 1.75 * normal, predecessors, successors, left, right)


def straight(start: float, end: float, y: float = 0.0) -> np.ndarray:
    return np.stack([np.linspace(start, end, 12), np.full(12, y)], axis=1)


def path_of(network: Network, ids: list[int], position, speed: float = 5.0) -> route_path.RoutePath:
    line = route_path.center_line(network, ids, np.asarray(position, float), speed)
    return route_path.reference_path(line, line.length + 30.0)


def test_straight_lanes_have_no_curvature():
    network = {1: lanelet(1, straight(0.0, 50.0), successors=(2,)), 2: lanelet(2, straight(50.0, 80.0))}
    path = path_of(network, [1, 2], [10.0, 0.3])
    np.testing.assert_allclose(path.curvature, 0.0, atol=1e-6)
    np.testing.assert_allclose(path.heading, 0.0, atol=1e-6)
    np.testing.assert_allclose(path.y, 0.0, atol=1e-6)
    # From 30 m before the ego to 30 m beyond the road.
    np.testing.assert_allclose(path.x[[0, -1]], [-20.0, 110.0], atol=0.3)
    np.testing.assert_allclose(np.diff(path.arc_length), 0.25, atol=1e-9)
    np.testing.assert_allclose(np.diff(path.x), 0.25, atol=1e-6)


@pytest.mark.parametrize("radius", [12.0, 40.0, 200.0])
def test_circular_lane_has_the_curvature_of_its_circle(radius):
    angle = np.linspace(0.0, 200.0 / radius if radius > 40.0 else 4.5, 200)
    circle = radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    smooth = route_path.smoothed(polyline.at_arc_lengths(circle, np.arange(0.0, angle[-1] * radius, 0.5)), 0.25)
    arc_length = polyline.arc_lengths(smooth)
    path = route_path.tabulated(smooth[:, 0], smooth[:, 1], arc_length)
    middle = slice(len(arc_length) // 4, -len(arc_length) // 4)
    np.testing.assert_allclose(path.curvature[middle], 1.0 / radius, rtol=0.15)
    np.testing.assert_allclose(np.hypot(smooth[:, 0], smooth[:, 1] - radius), radius, atol=0.26)


def test_corner_is_rounded_within_the_allowed_deviation():
    corner = np.concatenate([straight(-60.0, 0.0), np.array([[20.0, 10.0], [60.0, 30.0]])])
    points = polyline.at_arc_lengths(corner, np.arange(0.0, polyline.arc_lengths(corner)[-1], 0.5))
    smooth = route_path.smoothed(points, 0.25)
    deviation = np.linalg.norm(polyline.project(points, smooth)[1] - smooth, axis=1)
    assert 0.1 < deviation.max() <= 0.2501
    path = route_path.tabulated(smooth[:, 0], smooth[:, 1], polyline.arc_lengths(smooth))
    assert np.abs(path.curvature_derivative).max() < 0.03
    assert np.trapezoid(path.curvature, path.arc_length) == pytest.approx(np.arctan2(1.0, 2.0), abs=0.01)


def test_whittaker_keeps_parabolas():
    s = np.arange(40.0)
    parabola = np.stack([s, 0.01 * s**2], axis=1)
    np.testing.assert_allclose(route_path.whittaker(parabola, 1e4), parabola, atol=1e-6)


def side_by_side() -> Network:
    """Two lanes of two lanelets each, to the right 1 and 3, to the left 2 and 4."""
    return {
        1: lanelet(1, straight(0.0, 100.0), successors=(3,), left=Neighbor(2, True)),
        2: lanelet(2, straight(0.0, 100.0, 3.5), successors=(4,), right=Neighbor(1, True)),
        3: lanelet(3, straight(100.0, 200.0), predecessors=(1,), left=Neighbor(4, True)),
        4: lanelet(4, straight(100.0, 200.0, 3.5), predecessors=(2,), right=Neighbor(3, True)),
    }


def test_lane_change_is_blended():
    network = side_by_side()
    path = path_of(network, [1, 2, 4], [20.0, 0.0], speed=8.0)
    at = {x: float(np.interp(x, path.x, path.y)) for x in (15.0, 35.0, 60.0)}
    assert at[15.0] == pytest.approx(0.0, abs=0.26)
    assert at[35.0] == pytest.approx(1.75, abs=0.1)
    assert at[60.0] == pytest.approx(3.5, abs=0.26)
    assert np.abs(path.curvature).max() < 0.03


def test_route_changes_lanes_where_there_is_room():
    network, start = side_by_side(), np.array([90.0, 0.0])
    starts = route.start_lanelets(network, start, 0.0)
    assert list(starts) == [1]
    # 10 m are too short for a lane change, so it comes after the joint.
    assert route.shortest(network, starts, start, 8.0, [4]) == [1, 3, 4]
    early = np.array([20.0, 0.0])
    assert len(route.shortest(network, route.start_lanelets(network, early, 0.0), early, 8.0, [4])) == 3


def test_start_prefers_the_lanelet_along_the_heading():
    crossing = {
        1: lanelet(1, straight(-20.0, 20.0)),
        2: lanelet(2, straight(-20.0, 20.0)[:, ::-1].copy()),
        3: lanelet(3, straight(-20.0, 20.0)[::-1].copy()),
    }
    starts = route.start_lanelets(crossing, np.array([0.1, 0.1]), 0.2)
    assert set(starts) == {1, 2} and starts[1] < starts[2]
    with pytest.raises(ScenarioError, match="outside every lanelet"):
        route.start_lanelets(crossing, np.array([15.0, 15.0]), 0.2)


def test_without_a_goal_the_route_goes_straight_as_far_as_needed():
    turn = np.array([[50.0, 0.0], [60.0, 4.0], [64.0, 14.0], [64.0, 60.0]])
    network = {
        1: lanelet(1, straight(0.0, 50.0), successors=(2, 3)),
        2: lanelet(2, turn, predecessors=(1,)),
        3: lanelet(3, straight(50.0, 120.0), predecessors=(1,)),
    }
    assert route.furthest(network, {1: 0.0}, np.array([10.0, 0.0]), 8.0, 80.0) == [1, 3]
    assert route.straight_on(network, 1, 30.0) == [3]


def test_following_a_circle_ends():
    angle = np.linspace(0.0, np.pi, 30)
    half = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = {1: lanelet(1, half, (2,), (2,)), 2: lanelet(2, -half, (1,), (1,))}
    missing, _, ids = route.ahead(ring, 1, 300.0)
    assert missing == 0.0 and ids == [1, 2, 1, 2, 1]
    assert len(route.straight_on(ring, 1, 300.0)) == 5
