"""The sampling matrix by hand."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet import simulation
from jaxfrenet.environment import SAMPLING_ADJUSTMENTS, EnvironmentConfig
from jaxfrenet.environment.action import adjust, cost_weights, default_weights, sampling_range
from jaxfrenet.sampling import sample_end_states


@pytest.mark.parametrize(
    ("level", "end_times"),
    [(0, [1.1, 2.1, 3.0]), (1, [1.1, 1.6, 2.1, 2.6, 3.0]), (2, [1.1, 1.4, 1.7, 2.0, 2.3, 2.6, 2.9, 3.0])],
)
def test_end_times(level, end_times):
    np.testing.assert_allclose(0.1 * jf.PlannerConfig(sampling_level=level).end_steps, end_times, atol=1e-9)


@pytest.mark.parametrize(
    ("speed", "lowest", "highest"), [(10.0, 0.001, 15.75), (40.0, 5.5, 36.0), (0.0, 0.001, 5.75), (34.0, 0.001, 36.0)]
)
def test_end_speeds(speed, lowest, highest):
    got = sample_end_states(jf.PlannerConfig(), jnp.float32(speed), jnp.float32(speed + 0.25), jnp.float32(0.5)).speed
    np.testing.assert_allclose(got[:-1], np.linspace(lowest, highest, 9), atol=1e-5)
    assert float(got[-1]) == speed + 0.25


def test_end_offsets():
    got = sample_end_states(jf.PlannerConfig(), jnp.float32(9.0), jnp.float32(9.0), jnp.float32(0.5)).offset
    np.testing.assert_allclose(got, [*np.linspace(-3.5, 3.5, 9), 0.5], atol=1e-6)


@pytest.mark.parametrize(
    ("reach", "speeds", "side"),
    [
        ((1.0, 1.0, 1.0), (0.001, 15.75), 3.5),
        ((0.0, 0.1, 0.2), (9.0001, 10.0), 0.7),
        ((2.0, 0.5, 1.0), (5.0005, 21.5), 3.5),
        ((9.0, 0.0, 0.0), (10.0, 36.0), 0.0),
        ((1.0, 2.0, 2.0), (0.001, 15.75), 7.0),
    ],
)
def test_shares_of_the_ranges(reach, speeds, side):
    config, motion = jf.PlannerConfig(), (jnp.float32(10.0), jnp.float32(10.25), jnp.float32(0.5))
    got = sample_end_states(config, *motion, jf.SamplingRange(*reach))
    np.testing.assert_allclose(got.speed, [*np.linspace(speeds[0], speeds[1], 9), 10.25], atol=1e-5)
    np.testing.assert_allclose(got.offset, [*np.linspace(-side, side, 9), 0.5], atol=1e-6)
    if reach == (1.0, 1.0, 1.0):
        whole = sample_end_states(config, *motion)
        assert (got.speed == whole.speed).all() and (got.offset == whole.offset).all()


def test_an_agent_adjusts_them():
    weights = default_weights(SAMPLING_ADJUSTMENTS)
    assert sampling_range(SAMPLING_ADJUSTMENTS[:5], weights) is None
    moved = adjust(SAMPLING_ADJUSTMENTS, weights, jnp.asarray([0.0] * 5 + [1.0, -1.0, 1.0]))
    reach = sampling_range(SAMPLING_ADJUSTMENTS, moved)
    assert [float(leaf) for leaf in jax.tree.leaves(reach)] == pytest.approx([1.2, 0.9, 1.0])
    assert cost_weights(SAMPLING_ADJUSTMENTS, moved).names() == jf.CostWeights().names()
    with pytest.raises(ValueError, match="name at least one cost term"):
        EnvironmentConfig(adjustments=SAMPLING_ADJUSTMENTS[5:])


def test_a_cycle_samples_what_it_is_told(config, world, plan):
    scenario = world(speed=10.0)
    state, weights = jf.reset(config, scenario), jf.CostWeights()
    compiled = jax.jit(partial(jf.plan, config))
    whole = compiled(scenario, state, weights, jf.SamplingRange(1.0, 1.0, 1.0))
    usual = plan(scenario, state)
    assert whole.chosen == usual.chosen
    np.testing.assert_array_equal(whole.trajectory.x, usual.trajectory.x)
    np.testing.assert_array_equal(whole.cost, usual.cost)
    some = compiled(scenario, state, weights, jf.SamplingRange(0.0, 0.2, 0.1)).bundle
    assert some.end_speed.shape == usual.bundle.end_speed.shape
    assert 8.0 <= some.end_speed.min() < 8.01 and some.end_speed.max() <= 10.001
    assert np.abs(some.end_offset).max() == pytest.approx(0.35)


def test_whole_episodes_sample_what_they_are_told(config, world, monkeypatch):
    asked, plan = [], simulation.plan

    def ask(config, scenario, state, weights, reach):
        asked.append(reach)
        return plan(config, scenario, state, weights, reach)

    monkeypatch.setattr(simulation, "plan", ask)
    drive: Any = jf.roll_out
    for reach in (None, jf.SamplingRange(2.0, 0.5, 0.4)):
        asked.clear()
        jax.eval_shape(lambda *given: drive.__wrapped__(config, world(), jf.CostWeights(), 3, *given), reach)
        assert asked and {type(one) for one in asked} == {type(reach)}
