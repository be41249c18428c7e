"""Cost terms of one's own: they are computed, decide, and an agent can adjust them."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.environment import PAPER_ADJUSTMENTS, Adjustment, EnvironmentConfig, begin, observation_fields, proceed
from jaxfrenet.environment.action import cost_weights

OWN = "farthest_from_left_lane"


def farthest_from_left_lane(config: jf.PlannerConfig, inputs: jf.CostInputs) -> jax.Array:
    return abs(inputs.bundle.motion.offset - 3.5).max(axis=0)


def with_extra(weight: float) -> jf.CostWeights:
    return jf.CostWeights(prediction=None, extra=(jf.ExtraTerm(farthest_from_left_lane, weight),))


ADJUSTMENTS = (
    Adjustment(OWN, scale=5.0, low=0.0, high=100.0, default=50.0, cost=farthest_from_left_lane),
    *PAPER_ADJUSTMENTS[1:],
)


def test_it_is_computed_and_decides(config, world):
    scenario, weights = world(start=(20.0, 1.5)), with_extra(50.0)
    assert weights.names() == (*jf.CostWeights(prediction=None).names(), OWN)
    cycle = jax.jit(partial(jf.plan, config))(scenario, jf.reset(config, scenario), weights)
    farthest = np.abs(cycle.bundle.motion.offset - 3.5).max(axis=1)
    np.testing.assert_allclose(cycle.costs[:, -1], farthest, rtol=1e-5)
    without = cycle.costs[:, :-1].sum(axis=1)
    np.testing.assert_allclose(cycle.cost, without + 50.0 * farthest, rtol=1e-4, atol=1e-3)
    costs = np.where(cycle.feasibility.feasible, [cycle.cost, without], np.inf)
    assert cycle.chosen == costs[0].argmin() != costs[1].argmin()


def test_another_weight_compiles_nothing_anew():
    traced = []

    @jax.jit
    def values(weights: jf.CostWeights) -> jax.Array:
        traced.append(weights.names())
        return weights.values()

    assert [float(values(with_extra(weight))[-1]) for weight in (2.0, 3.0)] == [2.0, 3.0]
    assert len(traced) == 1


def test_an_agent_can_adjust_it():
    weights = cost_weights(ADJUSTMENTS, jnp.asarray([40.0, 1.0, 2.0, 3.0, 4.0]))
    assert weights.names() == (*(one.term for one in PAPER_ADJUSTMENTS[1:]), OWN)
    assert np.asarray(weights.values()).tolist() == [1.0, 2.0, 3.0, 4.0, 40.0]
    names = [field.name for field in observation_fields(EnvironmentConfig(adjustments=ADJUSTMENTS))]
    costs = [name for name in names if name.startswith("cost_")]
    assert costs[-3:] == [f"cost_{OWN}_{what}" for what in ("chosen", "mean", "variance")]
    assert names[-5:] == [f"weight_{one.term}" for one in ADJUSTMENTS]


def test_a_step_with_it_has_a_cost_and_an_observation_for_it(config, world):
    environment = EnvironmentConfig(planner=config, adjustments=ADJUSTMENTS)
    scenario = world()
    start = jax.eval_shape(partial(begin, environment), scenario)
    shapes = jax.eval_shape(partial(proceed, environment), scenario, start, jnp.zeros(5))
    situation, cycle, report = shapes
    assert situation.observation.shape == (len(observation_fields(environment)),)
    assert cycle.costs.shape == (config.trajectories, 5)
    assert report.costs.shape == report.weights.shape == (5,)


def test_a_name_that_the_planner_has_is_refused():
    with pytest.raises(ValueError, match="adjustment of 'velocity': the planner has a term of that name"):
        Adjustment("velocity", scale=1.0, low=0.0, high=2.0, default=1.0, cost=farthest_from_left_lane)
