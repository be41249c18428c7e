"""Lane paths on maps that can be drawn by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.prediction import lane_paths
from jaxfrenet.prediction.lane_paths import STARTS, WAYS
from jaxfrenet.scenario import LANE_NODES

FIND = jax.jit(lane_paths.find)
LOOK_UP = jax.jit(lane_paths.look_up)


def line(start, end) -> np.ndarray:
    return np.linspace(start, end, LANE_NODES)


def arc(center, radius, first, last) -> np.ndarray:
    angle = np.linspace(first, last, LANE_NODES)
    return np.asarray(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.fixture(scope="module")
def fork() -> jf.LaneMap:
    """From (0, 0) 20 m to the right; then a left turn of radius 10, straight on, or a right turn; an oncoming lane."""
    quarter = 0.5 * np.pi
    center = [
        line((0, 0), (20, 0)),
        arc((20, 10), 10, -quarter, 0),
        line((20, 0), (40, 0)),
        arc((20, -10), 10, quarter, 0),
        line((20, 3.5), (0, 3.5)),
        line((0, 0), (1, 0)),
    ]
    length = [20, 10 * quarter, 20, 10 * quarter, 20, 1]
    successors = [[1, 2, 3]] + [[-1] * 3] * 5
    return jf.LaneMap(
        center=jnp.asarray(np.array(center), jnp.float32),
        length=jnp.asarray(length, jnp.float32),
        successors=jnp.asarray(successors, jnp.int32),
        valid=jnp.asarray([True] * 5 + [False]),
    )


def found(lane_map, x, y, heading) -> lane_paths.LanePaths:
    return FIND(lane_map, jnp.asarray([x, y], jnp.float32), jnp.float32(np.cos(heading)), jnp.float32(np.sin(heading)))


def test_every_way_at_a_fork_is_a_path(fork):
    paths = found(fork, 5.0, 0.4, 0.1)
    assert paths.valid.tolist() == [True] * WAYS + [False] * (len(paths.valid) - WAYS)
    np.testing.assert_allclose(paths.offset[:3], 0.4, atol=1e-5)
    np.testing.assert_allclose(paths.sin[:3], np.sin(0.1), atol=1e-5)
    np.testing.assert_allclose(paths.fork[:3], 15.0, atol=1e-4)
    np.testing.assert_allclose(paths.end[:3], [15 + 5 * np.pi, 35, 15 + 5 * np.pi], atol=1e-3)
    at = jnp.broadcast_to(jnp.asarray([0.0, 10.0, 15.0 + 2.5 * np.pi]), (STARTS * WAYS, 3))
    position, tangent = LOOK_UP(fork, paths, at)
    np.testing.assert_allclose(position[:3, 0], [[5, 0]] * 3, atol=1e-4)
    np.testing.assert_allclose(position[:3, 1], [[15, 0]] * 3, atol=1e-4)
    bend = 10 * np.sin(0.25 * np.pi)
    np.testing.assert_allclose(position[0, 2], [20 + bend, 10 - bend], atol=0.02)
    np.testing.assert_allclose(position[1, 2], [20 + 2.5 * np.pi, 0], atol=1e-3)
    np.testing.assert_allclose(position[2, 2], [20 + bend, -10 + bend], atol=0.02)
    np.testing.assert_allclose(tangent[0, 2], [np.sqrt(0.5)] * 2, atol=0.05)


def test_paths_go_straight_on_at_both_ends(fork):
    paths = found(fork, 5.0, 0.0, 0.0)
    at = jnp.broadcast_to(jnp.asarray([-8.0, 15.0 + 5 * np.pi + 7.0, 60.0]), (STARTS * WAYS, 3))
    position, _ = LOOK_UP(fork, paths, at)
    np.testing.assert_allclose(position[0, 0], [-3, 0], atol=1e-4)
    np.testing.assert_allclose(position[0, 1], [30, 17], atol=0.4)
    np.testing.assert_allclose(position[1, 2], [65, 0], atol=1e-3)


def test_overlapping_lanes_are_all_found_and_the_oncoming_one_is_not(fork):
    paths = found(fork, 22.0, 0.05, 0.0)
    assert paths.valid.tolist() == [True] * 9
    assert {int(piece) for piece in paths.piece[:, 0]} == {1, 2, 3}
    paths = found(fork, 10.0, 3.5, np.pi)
    assert paths.valid.tolist() == [True] * WAYS + [False] * 6
    np.testing.assert_allclose(paths.offset[0], 0.0, atol=1e-5)


def test_far_from_all_lanes_there_is_no_path(fork):
    assert not found(fork, 10.0, -5.5, 0.0).valid.any()
    assert not found(fork, 10.0, 0.0, 0.5 * np.pi).valid.any()
    nowhere = found(fork, 1e4, -1e4, 0.3)
    assert all(np.isfinite(leaf).all() for leaf in (nowhere.offset, nowhere.end, nowhere.fork))
