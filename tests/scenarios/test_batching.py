"""Padding and stacking change sizes only."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import scenarios
from jaxfrenet.reference_path import look_up, to_cartesian
from jaxfrenet.scenario import Scenario
from scenarios.batching import AXES, leaves_of, scenario_of


def test_every_leaf_of_a_scenario_is_known(t_junction: Scenario):
    paths, _ = jax.tree_util.tree_flatten_with_path(t_junction)
    names = [".".join(key.name for key in path) for path, _ in paths]
    assert sorted(names) == sorted(AXES)
    for name, leaf in leaves_of(t_junction).items():
        assert leaf.ndim == len(AXES[name]), name


def test_leaves_and_back(t_junction: Scenario):
    again = scenario_of(leaves_of(t_junction))
    for name, leaf in leaves_of(t_junction).items():
        assert leaf.dtype == leaves_of(again)[name].dtype
        np.testing.assert_array_equal(leaf, leaves_of(again)[name])


def test_stack_holds_each_scenario(t_junction: Scenario, two_lanes: Scenario):
    batch = leaves_of(scenarios.stack([t_junction, two_lanes]))
    for index, scenario in enumerate((t_junction, two_lanes)):
        for name, leaf in leaves_of(scenario).items():
            inside = (index, *(slice(0, size) for size in leaf.shape))
            np.testing.assert_array_equal(batch[name][inside], leaf)
            assert batch[name].dtype == leaf.dtype


def test_padding_does_not_exist(t_junction: Scenario):
    sizes = {axis: size + 3 for axis, size in scenarios.sizes_of(t_junction).items()}
    own, padded = leaves_of(t_junction), leaves_of(scenarios.pad_to(t_junction, sizes))
    assert scenarios.sizes_of(scenarios.pad_to(t_junction, sizes)) == sizes
    for name in ("road.valid", "obstacles.valid", "goal.valid", "goal.edge_valid"):
        assert padded[name].sum() == own[name].sum()
    for name, leaf in padded.items():
        assert np.isfinite(leaf).all(), name
    assert (padded["road.nearby"][-3:] == -1).all() and (padded["road.nearby"][:, -3:] == -1).all()
    assert (padded["obstacles.length"][-3:] == 1.0).all()


def test_padded_path_goes_straight_on(t_junction: Scenario):
    nodes = scenarios.sizes_of(t_junction)["nodes"]
    path, padded = t_junction.path, scenarios.pad_to(t_junction, {"nodes": nodes + 40}).path
    assert float(padded.length) == float(path.length)
    np.testing.assert_allclose(np.diff(np.asarray(padded.arc_length)), 0.25, atol=1e-4)
    along = jnp.linspace(0.0, float(path.length) + 9.0, 60)
    for offset in (0.0, 2.0):
        before, after = to_cartesian(path, along, along * 0 + offset), to_cartesian(padded, along, along * 0 + offset)
        np.testing.assert_allclose(np.asarray(after), np.asarray(before), atol=2e-3)
    beyond = look_up(padded, path.length + 5.0)
    assert float(beyond.curvature) == 0.0


def test_too_small_or_unknown_sizes(t_junction: Scenario):
    with pytest.raises(scenarios.ScenarioError, match="cannot pad nodes to 3"):
        scenarios.pad_to(t_junction, {"nodes": 3})
    with pytest.raises(scenarios.ScenarioError, match="no axis 'wheels'"):
        scenarios.stack([t_junction], pad={"wheels": 4})
    with pytest.raises(scenarios.ScenarioError, match="no scenario to stack"):
        scenarios.stack([])
