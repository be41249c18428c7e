"""Lanes cut into pieces, from files and from the generator."""

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.scenario import LANE_NODES
from scenarios import lane_pieces, polyline
from scenarios.families import FAMILIES, Draw, documents, generate
from scenarios.lanelets import Lanelet


def lanelet(id_, points, predecessors=(), successors=()):
    line = np.asarray(points, float)
    left, right = line + [0.0, 1.5], line - [0.0, 1.5]
    return Lanelet(id_, left, right, tuple(predecessors), tuple(successors), None, None)


def network(*lanelets):
    return {one.id: one for one in lanelets}


def test_lanelets_without_fork_are_one_lane():
    found = lane_pieces.cut(
        network(
            lanelet(1, [(0, 0), (10, 0)], successors=[2]),
            lanelet(2, [(10, 0), (25, 0)], [1], [3]),
            lanelet(3, [(25, 0), (80, 0)], [2]),
        )
    )
    np.testing.assert_allclose(found.length, 80 / 3)
    np.testing.assert_allclose(found.center[0, :, 0], np.linspace(0, 80 / 3, LANE_NODES))
    np.testing.assert_allclose(found.center[:, -1, 0], [80 / 3, 160 / 3, 80])
    assert found.successors.tolist() == [[1] * 3, [2] * 3, [-1] * 3]


def test_a_fork_has_a_left_a_straight_and_a_right_way():
    found = lane_pieces.cut(
        network(
            lanelet(1, [(0, 0), (20, 0)], successors=[4, 2, 3]),
            lanelet(2, [(20, 0), (40, 0)], [1]),
            lanelet(3, [(20, 0), (30, 0), (35, 10)], [1]),
            lanelet(4, [(20, 0), (30, 0), (35, -10)], [1]),
        )
    )
    ends = found.center[found.successors[0], -1]
    np.testing.assert_allclose(ends, [[35, 10], [40, 0], [35, -10]])
    assert (found.successors[1:] == -1).all()


def test_a_merge_ends_both_lanes_at_the_common_one():
    found = lane_pieces.cut(
        network(
            lanelet(1, [(0, 0), (20, 0)], successors=[3]),
            lanelet(2, [(0, 9), (20, 0)], successors=[3]),
            lanelet(3, [(20, 0), (40, 0)], [1, 2]),
        )
    )
    assert found.successors.tolist() == [[2] * 3, [2] * 3, [-1] * 3]


def test_a_ring_is_cut_somewhere_and_goes_round():
    corners = [(0, 0), (20, 0), (20, 20), (0, 20)]
    sides = [lanelet(i, [corners[i], corners[(i + 1) % 4]], [(i - 1) % 4], [(i + 1) % 4]) for i in range(4)]
    found = lane_pieces.cut(network(*sides))
    at, seen = 0, []
    for _ in range(len(found.length)):
        seen.append(at)
        at = int(found.successors[at, 0])
    assert at == 0 and sorted(seen) == list(range(len(found.length)))
    assert found.length.sum() == pytest.approx(80, abs=0.5)


def test_a_lanelet_without_length_is_left_out():
    found = lane_pieces.cut(network(lanelet(1, [(0, 0), (20, 0)], successors=[2]), lanelet(2, [(20, 0), (20, 0)], [7])))
    assert len(found.length) == 1 and found.successors.tolist() == [[-1] * 3]


def assert_connected(lane_map: jf.LaneMap) -> None:
    center, length = np.asarray(lane_map.center, float), np.asarray(lane_map.length, float)
    valid, successors = np.asarray(lane_map.valid), np.asarray(lane_map.successors)
    gaps = np.linalg.norm(np.diff(center, axis=1), axis=-1)
    assert (gaps[valid].sum(axis=1) <= length[valid] + 1e-3).all()
    assert (gaps[valid].sum(axis=1) >= 0.97 * length[valid]).all()
    for piece in np.flatnonzero(valid):
        for following in successors[piece][successors[piece] >= 0]:
            assert valid[following]
            assert np.linalg.norm(center[following, 0] - center[piece, -1]) < 0.05


def assert_ways_are_in_order(lane_map: jf.LaneMap, forks: int) -> None:
    center, successors = np.asarray(lane_map.center, float), np.asarray(lane_map.successors)
    end = center[:, -1] - center[:, -2]
    angle = np.arctan2(end[:, 1], end[:, 0])
    forking = np.flatnonzero(successors[:, 0] != successors[:, 2])
    assert len(forking) == forks
    for piece in forking:
        left, straight, right = (angle[successors[piece]] - angle[piece] + np.pi) % (2 * np.pi) - np.pi
        assert left > right + 0.5 and left >= straight >= right
        assert abs(straight) == min(abs(left), abs(straight), abs(right))


def test_pieces_of_a_file_hang_together(t_junction):
    assert_connected(t_junction.lane_map)
    spacing = np.asarray(t_junction.lane_map.length) / (LANE_NODES - 1)
    assert (spacing <= lane_pieces.LONGEST_PIECE / (LANE_NODES - 1) + 1e-4).all()
    assert_ways_are_in_order(t_junction.lane_map, 3)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_generated_map_is_that_of_its_file(family, tmp_path):
    pytest.importorskip("commonroad")
    draw = Draw(2, 5, family)
    made = generate(draw).scenarios
    for scenario, (name, content) in zip(made, documents(draw), strict=True):
        assert_connected(scenario.lane_map)
        assert_ways_are_in_order(scenario.lane_map, {"tjunction": 3, "crossing": 4, "highway": 0}[family])
        file = tmp_path / f"{name}.xml"
        file.write_bytes(content)
        read = scenarios.load(file)
        lines = [np.asarray(part.lane_map.center, float) for part in (scenario, read)]
        for mine, theirs in (lines, lines[::-1]):
            nodes = mine.reshape(-1, 2)
            nearest = [np.linalg.norm(polyline.project(line, nodes)[1] - nodes, axis=1) for line in theirs]
            assert np.min(nearest, axis=0).max() < 0.1
        total = [float(np.sum(part.lane_map.length)) for part in (scenario, read)]
        assert total[0] == pytest.approx(total[1], rel=0.01)


def test_padding_leads_nowhere(t_junction):
    pieces = t_junction.lane_map.length.shape[0]
    padded = scenarios.pad_to(t_junction, {"pieces": pieces + 3}).lane_map
    assert not np.asarray(padded.valid[pieces:]).any()
    assert (np.asarray(padded.successors[pieces:]) == -1).all()
    assert (np.asarray(padded.length) > 0).all()
