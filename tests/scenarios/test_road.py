"""The road's edge: lane sections, the index of nearby segments, and agreement with CommonRoad's own checker."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.road import BIN_LENGTH, CORRIDOR, REACH, is_off_road
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


def disagreements(path: Path, tmp_path: Path) -> tuple[int, int, float]:
    """Poses that only the checker calls off the road, far false alarms, and the share of poses off the road."""
    pytest.importorskip("commonroad_dc")
    out, program = tmp_path / "poses.npz", Path(__file__).parent / "checker_poses.py"
    command = [sys.executable, str(program), str(path), str(out), str(POSES)]
    environment = os.environ | {"PYTHONPATH": str(Path(scenarios.__file__).parents[1])}
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment)
    assert out.is_file(), done.stderr[-2000:]
    poses, road = np.load(out), scenarios.load(path).road

    def verdict(pose):
        return is_off_road(road.segments, road.valid, pose[:2], pose[2], jnp.float32(4.508), jnp.float32(1.610))

    placed = jnp.concatenate([poses["positions"], poses["headings"][:, None]], axis=1)
    ours = np.asarray(jax.jit(lambda all_: jax.lax.map(verdict, all_, batch_size=1000))(placed))
    missed, false = poses["off_road"] & ~ours, ours & ~poses["near_edge"]
    return int(missed.sum()), int(false.sum()), float(ours.mean())


@pytest.mark.parametrize("index", [0, 1])
def test_agrees_with_the_checker_on_builtin_maps(index, t_junction_file, tmp_path):
    missed, false, share = disagreements(scenarios.builtin_paths()[index], tmp_path)
    assert (missed, false) == (0, 0)
    assert 0.1 < share < 0.9


@pytest.mark.data
@pytest.mark.parametrize("name", SAMPLE)
def test_agrees_with_the_checker_on_real_maps(name, data_root, tmp_path):
    missed, false, share = disagreements(data_root / "scenarios" / "sample" / f"{name}_T-1.xml", tmp_path)
    assert (missed, false) == (0, 0)
    assert 0.1 < share < 0.9
