"""The scenarios that come with the package are those that our code draws, and can be driven."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.collision import Box, boxes_overlap
from scenarios.builtin import write_builtin


def test_files_are_reproduced(tmp_path):
    pytest.importorskip("commonroad")
    written, kept = write_builtin(tmp_path), scenarios.builtin_paths()
    assert [path.name for path in written] == [path.name for path in kept]
    for new, old in zip(written, kept, strict=True):
        assert new.read_bytes() == old.read_bytes()
        assert old.stat().st_size < 150_000


@pytest.mark.parametrize("name", ["t_junction", "two_lanes"])
def test_traffic_never_overlaps(name, request):
    scenario: jf.Scenario = request.getfixturevalue(name)
    obstacles = scenario.obstacles
    x, y = obstacles.position[..., 0], obstacles.position[..., 1]
    box = Box.from_heading(x, y, obstacles.heading, obstacles.length[:, None], obstacles.width[:, None])
    overlap = boxes_overlap(jax.tree.map(lambda leaf: leaf[:, None], box), jax.tree.map(lambda leaf: leaf[None], box))
    assert int(overlap.sum()) == len(obstacles.length) * obstacles.valid.shape[1]

    start, vehicle = scenario.initial_state, jf.BMW_320I
    x, y = start.position
    length, width = jnp.float32(vehicle.length + 2.0), jnp.float32(vehicle.width + 1.0)
    ego = Box.from_heading(x, y, start.heading, length, width)
    assert not bool(boxes_overlap(ego, jax.tree.map(lambda leaf: leaf[:, 0], box)).any())


@pytest.mark.parametrize("name", ["t_junction", "two_lanes"])
def test_goal_is_within_reach(name, request):
    scenario: jf.Scenario = request.getfixturevalue(name)
    nearest = np.argmin(
        np.hypot(*(np.stack([scenario.path.x, scenario.path.y]) - np.asarray(scenario.initial_state.position)[:, None]))
    )
    start = float(scenario.path.arc_length[nearest])
    entry, leave = np.asarray(scenario.goal.arc_length)[0] - start
    first, last = np.asarray(scenario.goal.steps)[0] * 0.1
    assert 5.0 <= float(scenario.initial_state.speed) <= 8.0
    assert entry / last < 8.0 < leave / first + 2.0
    assert float(np.abs(scenario.path.curvature).max()) < 0.2
