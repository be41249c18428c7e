"""What a planning cycle chooses, and that neither batches nor padding change it."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios


def mode_of(cycle: jf.PlanningCycle) -> jf.PlanMode:
    return jf.PlanMode(int(cycle.mode))


def block(thing, x: float):
    return [thing(x, y, static=True, width=4.0) for y in (-4.0, 0.0, 4.0)]


def assert_finite(tree):
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        assert np.isfinite(np.asarray(leaf)).all(), jax.tree_util.keystr(path)


def test_the_cheapest_free_trajectory_is_chosen(world, plan, config):
    cycle = plan(*((scenario := world()), jf.reset(config, scenario)))
    assert mode_of(cycle) is jf.PlanMode.NORMAL
    ranked = np.where(cycle.feasibility.feasible, cycle.cost, np.inf)
    assert int(cycle.chosen) == int(np.argmin(ranked))
    assert int(cycle.collision_checked) == 1
    driven = jax.tree.map(lambda leaf: leaf[int(cycle.chosen)], cycle.bundle.motion)
    for mine, expected in zip(jax.tree.leaves(cycle.trajectory), jax.tree.leaves(driven), strict=True):
        np.testing.assert_array_equal(mine, expected)


def test_colliding_trajectories_are_passed_over(world, config, thing):
    """Without the collision-probability term the cheapest trajectory runs into the car ahead; the check stops that."""
    scenario = world([thing(40.0, 0.0, static=True)])
    weights = jf.CostWeights(prediction=None)
    cycle = jax.jit(partial(jf.plan, config))(scenario, jf.reset(config, scenario), weights)
    assert mode_of(cycle) is jf.PlanMode.NORMAL
    cheaper = np.asarray(cycle.feasibility.feasible & (cycle.cost < cycle.cost[cycle.chosen]))
    assert cheaper.sum() + 1 == int(cycle.collision_checked) > 1
    around = np.abs(np.asarray(cycle.trajectory.offset)) > 1.9
    behind = np.asarray(cycle.trajectory.x) + 2 * config.vehicle.rear_axle_to_center < 40.0
    assert (around | behind).all()


def test_emergency_stops_hardest(world, plan, config, thing):
    scenario = world(block(thing, 32.0))
    state = jf.reset(config, scenario)
    cycle = plan(scenario, state)
    assert mode_of(cycle) is jf.PlanMode.EMERGENCY
    feasible = np.asarray(cycle.feasibility.feasible)
    assert int(cycle.collision_checked) == feasible.sum()
    aside = np.abs(np.asarray(cycle.bundle.end_offset) - float(state.ego.offset))
    keys = np.stack([np.asarray(cycle.bundle.end_speed), np.asarray(cycle.bundle.end_step), aside], axis=1)
    best = min(map(tuple, keys[feasible]))
    assert tuple(keys[int(cycle.chosen)]) == best


def test_standstill_stays(world, plan, config, thing):
    scenario = world(block(thing, 24.8), speed=0.05)
    state = jf.reset(config, scenario)
    cycle = plan(scenario, state)
    assert mode_of(cycle) is jf.PlanMode.STANDSTILL
    assert np.ptp(np.asarray(cycle.trajectory.x)) == 0.0
    assert not np.asarray(cycle.trajectory.speed).any()
    assert float(cycle.trajectory.heading[0]) == float(state.ego.heading)


def test_without_a_feasible_trajectory(world, plan, config):
    scenario = world()
    nowhere = dataclasses.replace(scenario, path=dataclasses.replace(scenario.path, length=jnp.float32(21.0)))
    cycle = plan(nowhere, jf.reset(config, nowhere))
    assert mode_of(cycle) is jf.PlanMode.INFEASIBLE
    assert not np.asarray(cycle.bundle.valid).any()
    assert not np.asarray(cycle.feasibility.feasible).any()
    assert_finite(cycle)


def test_beyond_the_centre_of_curvature_is_not_valid(world, plan, config):
    """Where the path turns left with 1/2.5 m, offsets of 2.5 m and more have no place in the Frenet frame."""
    scenario = world()
    sharp = dataclasses.replace(scenario.path, curvature=jnp.full_like(scenario.path.curvature, 0.4))
    scenario = dataclasses.replace(scenario, path=sharp)
    cycle = plan(scenario, jf.reset(config, scenario))
    farthest = np.max(np.asarray(cycle.bundle.motion.offset), axis=1)
    np.testing.assert_array_equal(cycle.bundle.valid, farthest < 2.5 * (1 - 1e-3))
    assert_finite(cycle)


@pytest.mark.parametrize(
    "start",
    [
        dict(speed=0.0),
        dict(speed=1e-4),
        dict(speed=1.99),
        dict(speed=2.01, heading=1.2),
        dict(speed=35.0),
        dict(speed=50.0, yaw_rate=2.0),
        dict(start=(299.0, 0.0)),
        dict(start=(1.0, 0.0)),
        dict(start=(20.0, 5.9), heading=-1.5),
    ],
)
def test_nothing_is_ever_nan(world, plan, config, thing, start):
    scenario = world([thing(30.0, 0.0, 5.0), thing(20.0, 0.0, 0.0)], **start)
    assert_finite(plan(scenario, jf.reset(config, scenario)))


def test_low_velocity_mode_starts_below_its_threshold(world, plan, config):
    """Just above it the lateral polynomial runs over time: the bundle changes, its first points do not jump."""
    bundles = []
    for speed in (1.999, 2.001):
        scenario = world(speed=speed, heading=0.05)
        bundles.append(plan(scenario, jf.reset(config, scenario)).bundle)
    slow, fast = bundles
    np.testing.assert_allclose(slow.motion.y[:, 0], fast.motion.y[:, 0], atol=1e-4)
    np.testing.assert_allclose(slow.motion.curvature[:, 0], fast.motion.curvature[:, 0], atol=2e-3)
    assert not np.allclose(slow.lateral_jerk, fast.lateral_jerk, rtol=0.05)


def test_a_term_without_weight_is_not_computed(world, config):
    scenario = world()
    weights = jf.CostWeights(lateral_jerk=None, prediction=None, velocity=0.5)
    cycle = jax.jit(partial(jf.plan, config))(scenario, jf.reset(config, scenario), weights)
    assert weights.names() == ("longitudinal_jerk", "distance_to_reference_path", "velocity_offset", "velocity")
    assert cycle.costs.shape == (config.trajectories, 4)
    np.testing.assert_allclose(cycle.cost, cycle.costs @ np.array([1.0, 1.0, 1.0, 0.5]), rtol=1e-4)


@pytest.mark.parametrize(("level", "count"), [(0, 48), (1, 180), (2, 800), (3, 3564), (4, 12716)])
def test_every_sampling_level_plans(world, level, count):
    config = jf.PlannerConfig(sampling_level=level)
    assert config.trajectories == count
    scenario = world()
    cycle = jax.jit(partial(jf.plan, config))(scenario, jf.reset(config, scenario), jf.CostWeights(prediction=None))
    assert cycle.bundle.motion.x.shape == (count, 31)
    assert mode_of(cycle) is jf.PlanMode.NORMAL


@pytest.fixture(scope="module")
def real_pair():
    """The two built-in scenarios, which differ in every array size."""
    pytest.importorskip("commonroad")
    return [scenarios.load(path) for path in scenarios.builtin_paths()]


def test_a_padded_batch_gives_what_each_gives_alone(real_pair):
    config, weights = jf.PlannerConfig(sampling_level=1), jf.CostWeights()
    sizes = [scenarios.sizes_of(scenario) for scenario in real_pair]
    larger = {axis: max(size[axis] for size in sizes) + extra for extra, axis in enumerate(sizes[0], start=3)}
    batch = scenarios.stack(real_pair, larger)
    states = jax.vmap(partial(jf.reset, config))(batch)
    together = jax.jit(jax.vmap(jf.plan, in_axes=(None, 0, 0, None)), static_argnums=0)(config, batch, states, weights)
    for row, scenario in enumerate(real_pair):
        alone = jax.jit(jf.plan, static_argnums=0)(config, scenario, jf.reset(config, scenario), weights)
        assert int(together.chosen[row]) == int(alone.chosen)
        assert int(together.mode[row]) == int(alone.mode)
        np.testing.assert_array_equal(together.feasibility.feasible[row], alone.feasibility.feasible)
        np.testing.assert_allclose(together.cost[row], alone.cost, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(together.trajectory.x[row], alone.trajectory.x, atol=1e-4)


def test_padded_episodes_end_like_those_alone(real_pair):
    config, weights = jf.PlannerConfig(sampling_level=1), jf.CostWeights()
    steps = max(jf.max_steps(scenario) for scenario in real_pair)
    batch = scenarios.stack(real_pair)
    together = jax.vmap(lambda scenario: jf.roll_out(config, scenario, weights, steps))(batch)
    for row, scenario in enumerate(real_pair):
        alone = jf.roll_out(config, scenario, weights, steps)
        assert (int(together.outcome[row]), int(together.steps[row])) == (int(alone.outcome), int(alone.steps))
        np.testing.assert_allclose(together.ego.x[row], alone.ego.x, atol=1e-2)


@pytest.mark.parametrize("wrong", [dict(sampling_level=-1), dict(shortest_end_step=31), dict(curvature_rate_limit=0.0)])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        jf.PlannerConfig(**wrong)
