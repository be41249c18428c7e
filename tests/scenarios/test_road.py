"""The road's edge: lane sections, the index of nearby segments; agreement with CommonRoad's checker, traffic too."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.collision import Box
from jaxfrenet.road import BIN_LENGTH, CORRIDOR, REACH, is_off_road
from jaxfrenet.simulation import hits_recorded
from scenarios import polyline
from scenarios.lanelets import Lanelet, Neighbor
from scenarios.road import lane_sections, surface_edge

POSES = 10_000
SAMPLE = "ZAM_Tjunction-1_42", "DEU_A9-1_1", "ZAM_Zip-1_6", "RUS_Bicycle-10_1", "DEU_Lohmar-16_1"


def box_lanelet(id_: int, low: float, high: float, left: Neighbor | None = None, right: Neighbor | None = None):
    """A straight lanelet of 50 m between two offsets."""
    along = np.array([0.0, 25.0, 50.0])
    left_bound, right_bound = (np.stack([along, np.full(3, offset)], axis=1) for offset in (high, low))
    return Lanelet(id_, left_bound, right_bound, (), (), left, right)


def test_slivers_between_neighbors_belong_to_the_road():
    right = box_lanelet(1, 0.0, 3.0, left=Neighbor(2, True))
    left = box_lanelet(2, 3.1, 6.0, right=Neighbor(1, True))
    edges = surface_edge({1: right, 2: left})
    assert polyline.contains(edges, np.array([[10.0, 3.05], [10.0, 1.0], [10.0, 7.0]])).tolist() == [True, True, False]


def test_opposite_neighbor_is_turned_round():
    right = box_lanelet(1, 0.0, 3.0, left=Neighbor(2, False))
    left = box_lanelet(2, 3.1, 6.0)
    turned = Lanelet(2, left.right_bound[::-1], left.left_bound[::-1], (), (), Neighbor(1, False), None)
    edges = surface_edge({1: right, 2: turned})
    assert polyline.contains(edges, np.array([[10.0, 3.05], [10.0, 5.0], [10.0, 7.0]])).tolist() == [True, True, False]


def test_neighbors_in_a_circle():
    first = box_lanelet(1, 0.0, 3.0, left=Neighbor(2, True), right=Neighbor(2, True))
    second = box_lanelet(2, 3.0, 6.0, left=Neighbor(1, True), right=Neighbor(1, True))
    assert len(lane_sections({1: first, 2: second})) >= 1


@pytest.mark.parametrize("name", ["t_junction", "two_lanes"])
def test_nearby_lists_all_segments_in_reach(name, request):
    import shapely

    scenario: jf.Scenario = request.getfixturevalue(name)
    nearby = np.asarray(scenario.road.nearby)
    points = np.stack([np.asarray(scenario.path.x), np.asarray(scenario.path.y)], axis=1)
    along = np.asarray(scenario.path.arc_length)
    segments = shapely.linestrings(np.asarray(scenario.road.segments, float))
    assert nearby.shape[0] >= float(scenario.path.length) / BIN_LENGTH
    for index in range(0, nearby.shape[0], 7):
        inside = (along >= index * BIN_LENGTH) & (along <= (index + 1) * BIN_LENGTH)
        stretch = shapely.MultiPoint(points[inside])
        reached = set(np.flatnonzero(shapely.distance(segments, stretch) <= CORRIDOR + REACH).tolist())
        listed = [one for one in nearby[index].tolist() if one >= 0]
        assert reached <= set(listed) and len(set(listed)) == len(listed)


@pytest.fixture(scope="module")
def checked(tmp_path_factory) -> Callable[[Path], dict[str, np.ndarray]]:
    """What the checker says of random poses in a scenario; asked once for each file."""
    pytest.importorskip("commonroad_dc")
    folder, program = tmp_path_factory.mktemp("poses"), Path(__file__).parent / "checker_poses.py"

    def ask(path: Path) -> dict[str, np.ndarray]:
        out = folder / f"{path.stem}.npz"
        if not out.is_file():
            environment = os.environ | {"PYTHONPATH": str(Path(scenarios.__file__).parents[1])}
            command = [sys.executable, str(program), str(path), str(out), str(POSES)]
            done = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment)
            assert out.is_file(), done.stderr[-2000:]
        return dict(np.load(out))

    return ask


def assert_agreement(theirs: np.ndarray, theirs_near: np.ndarray, ours: np.ndarray):
    """Nothing missed; a false alarm only where an enlarged box touches. Both verdicts occur."""
    assert not (theirs & ~ours).any()
    assert not (ours & ~theirs_near).any()
    assert 0.05 < ours.mean() < 0.95


def check_road(path: Path, verdicts: dict[str, np.ndarray]):
    road = scenarios.load(path).road

    def verdict(pose):
        return is_off_road(road.segments, road.valid, pose[:2], pose[2], jnp.float32(4.508), jnp.float32(1.610))

    placed = jnp.concatenate([verdicts["positions"], verdicts["headings"][:, None]], axis=1)
    ours = np.asarray(jax.jit(lambda all_: jax.lax.map(verdict, all_, batch_size=1000))(placed))
    assert_agreement(verdicts["off_road"], verdicts["near_edge"], ours)


def check_traffic(path: Path, verdicts: dict[str, np.ndarray]):
    obstacles = scenarios.load(path).obstacles
    poses = jnp.asarray(verdicts["traffic_poses"], jnp.float32)

    def verdict(pose):
        box = Box.from_heading(pose[1], pose[2], pose[3], jnp.float32(4.508), jnp.float32(1.610))
        return jnp.any(hits_recorded(obstacles, pose[0].astype(jnp.int32), box))

    ours = np.asarray(jax.jit(lambda all_: jax.lax.map(verdict, all_, batch_size=1000))(poses))
    assert_agreement(verdicts["hit"], verdicts["near_hit"], ours)


@pytest.mark.parametrize("check", [check_road, check_traffic])
@pytest.mark.parametrize("index", [0, 1])
def test_agrees_with_the_checker_on_builtin_maps(index, check, t_junction_file, checked):
    path = scenarios.builtin_paths()[index]
    check(path, checked(path))


@pytest.mark.data
@pytest.mark.parametrize("check", [check_road, check_traffic])
@pytest.mark.parametrize("name", SAMPLE)
def test_agrees_with_the_checker_on_real_maps(name, check, data_root, checked):
    path = data_root / "scenarios" / "sample" / f"{name}_T-1.xml"
    check(path, checked(path))
