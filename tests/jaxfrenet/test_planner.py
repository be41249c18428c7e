"""What a planning cycle chooses, and that neither batches nor padding change it."""

import dataclasses
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.planner import TOGETHER, _total_risk


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
    assert [float(leaf) for leaf in jax.tree.leaves(cycle.risk)] == [0.0, 0.0, 0.0]


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
    keys = stopping_keys(cycle, state)
    best = min(map(tuple, keys[feasible]))
    assert tuple(keys[int(cycle.chosen)]) == best


def stopping_keys(cycle: jf.PlanningCycle, state: jf.SimulationState) -> np.ndarray:
    """`[trajectories, 3]`, by which emergencies are ranked without risk."""
    aside = np.abs(np.asarray(cycle.bundle.end_offset) - float(state.ego.offset))
    return np.stack([np.asarray(cycle.bundle.end_speed), np.asarray(cycle.bundle.end_step), aside], axis=1)


@pytest.fixture(scope="module")
def min_risk(config):
    """`min_risk(scenarios)`: planning cycles with `min_risk`, and the risks of their bundles, as one batch."""
    config = dataclasses.replace(config, emergency="min_risk")

    @jax.jit
    @jax.vmap
    def compiled(scenario, state):
        cycle = jf.plan(config, scenario, state, jf.CostWeights())
        return cycle, jf.assess_bundle(config, scenario, cycle.prediction, cycle.bundle)

    def run(found):
        states = [jf.reset(config, scenario) for scenario in found]
        together = compiled(*(jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows) for rows in (found, states)))
        return [(state, *jax.tree.map(lambda leaf, i=i: leaf[i], together)) for i, state in enumerate(states)]

    return run


def with_kinds(scenario: jf.Scenario, *kinds: jf.ObstacleKind) -> jf.Scenario:
    obstacles = dataclasses.replace(scenario.obstacles, kind=jnp.asarray(kinds, jnp.int32))
    return dataclasses.replace(scenario, obstacles=obstacles)


def test_emergency_of_least_risk(world, plan, min_risk, config, thing):
    """The brute-force choice; it is not the one that stops hardest, and less risky than that."""
    kind = jf.ObstacleKind
    blocked = [
        with_kinds(world(block(thing, 30.0)), kind.CAR, kind.TRUCK, kind.PEDESTRIAN),
        world(block(thing, 32.0)),
        world(),
    ]
    *emergencies, (_, normal, _) = min_risk(blocked)
    for scenario, (state, cycle, risk) in zip(blocked, emergencies, strict=False):
        assert mode_of(cycle) is jf.PlanMode.EMERGENCY
        total = np.maximum(risk.ego, risk.boundary_harm) + np.asarray(risk.third_party)
        feasible = np.flatnonzero(cycle.feasibility.feasible)
        least_first = np.lexsort([*stopping_keys(cycle, state)[feasible].T[::-1], total[feasible]])
        chosen = int(cycle.chosen)
        assert chosen == feasible[least_first[0]]
        hardest = int(plan(scenario, state).chosen)
        assert total[chosen] < 0.5 * total[hardest]
        np.testing.assert_array_equal(cycle.trajectory.x, cycle.bundle.motion.x[chosen])
        assert float(cycle.risk.ego) == pytest.approx(float(risk.ego[chosen]), rel=1e-4)
    usual = plan(blocked[2], jf.reset(config, blocked[2]))
    assert mode_of(normal) is mode_of(usual) is jf.PlanMode.NORMAL
    assert int(normal.chosen) == int(usual.chosen)


def test_without_any_risk_the_hardest_stop_is_chosen(world, min_risk, thing):
    """Boxes so wide that they block the road from afar: nobody's centre is near, so no collision is probable."""
    wide = [thing(32.0, y, static=True, width=51.0) for y in (-25.0, 25.0)]
    scenario = with_kinds(world(wide), *[jf.ObstacleKind.CAR] * 3)
    state, cycle, risk = min_risk([scenario] * 3)[0]
    assert mode_of(cycle) is jf.PlanMode.EMERGENCY
    keys = stopping_keys(cycle, state)
    least = np.asarray(cycle.feasibility.feasible & (risk.total == 0.0))
    assert least.sum() > 10
    assert tuple(keys[int(cycle.chosen)]) == min(map(tuple, keys[least]))


def test_risks_of_all_cost_nothing_without_an_emergency(world, plan, config):
    """In a batch, XLA keeps the whole assessment inside the loop that runs only where it is wanted."""
    if jax.default_backend() != "cpu":
        pytest.skip("reads the program that XLA makes for the CPU")
    scenario = world()
    cycle = plan(scenario, jf.reset(config, scenario))
    one = scenario, cycle.prediction, cycle.rows, jnp.asarray(False)
    pair = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), one)
    text = jax.jit(jax.vmap(partial(_total_risk, config))).lower(*pair).compile().as_text() or ""
    assert "exponential" in text
    assert len(re.findall(r"\bwhile\(", text[text.index("ENTRY") :])) == 1


def test_the_risk_of_all_is_not_compiled_without_need(world, config, monkeypatch):
    def refuse(*_):
        raise AssertionError("assessed")

    monkeypatch.setattr("jaxfrenet.risk.assess_bundle", refuse)
    scenario = world()
    arguments = scenario, jf.reset(config, scenario), jf.CostWeights()
    assert jax.eval_shape(partial(jf.plan, config), *arguments).risk.ego.shape == ()
    with pytest.raises(AssertionError, match="assessed"):
        jax.eval_shape(partial(jf.plan, dataclasses.replace(config, emergency="min_risk")), *arguments)


def test_standstill_stays(world, plan, config, thing):
    scenario = world(block(thing, 24.8), speed=0.05)
    state = jf.reset(config, scenario)
    cycle = plan(scenario, state)
    assert mode_of(cycle) is jf.PlanMode.STANDSTILL
    assert np.ptp(np.asarray(cycle.trajectory.x)) == 0.0
    assert not np.asarray(cycle.trajectory.speed).any()
    assert float(cycle.trajectory.heading[0]) == float(state.ego.heading)
    assert float(cycle.risk.ego) > 0.0
    assert float(cycle.risk.boundary_harm) == 0.0


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


def test_a_batch_in_parts_gives_what_each_gives_alone(world, plan, config, thing):
    """More scenarios than are planned at once, of every mode, with the collision check ending at different depths."""
    starts = [dict(), dict(speed=0.05), dict(start=(25.0, 1.5)), dict(speed=3.0), dict(speed=18.0, heading=0.1)]
    obstacle, slow = thing(33.0, 0.0, static=True), thing(36.0, 1.0, speed=3.0)
    things = [[], block(thing, 24.8), block(thing, 32.0), [obstacle], [slow]]
    found = [world(those, **start) for those in things for start in starts][: TOGETHER + 5]
    states = [jf.reset(config, scenario) for scenario in found]
    batch = (jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows) for rows in (found, states))
    together = jax.jit(jax.vmap(lambda scenario, state: jf.plan(config, scenario, state, jf.CostWeights())))(*batch)
    assert len(set(np.asarray(together.mode).tolist())) >= 3
    assert len(set(np.asarray(together.collision_checked).tolist())) > 3
    for row, (scenario, state) in enumerate(zip(found, states, strict=True)):
        alone = plan(scenario, state)
        assert int(together.mode[row]) == int(alone.mode)
        assert int(together.chosen[row]) == int(alone.chosen)
        assert int(together.collision_checked[row]) == int(alone.collision_checked)
        np.testing.assert_allclose(together.cost[row], alone.cost, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(together.trajectory.x[row], alone.trajectory.x, atol=1e-4)


def test_a_padded_episode_ends_like_one_alone(real_pair):
    config, weights = jf.PlannerConfig(sampling_level=1), jf.CostWeights()
    steps = max(jf.max_steps(scenario) for scenario in real_pair)
    batch = scenarios.stack(real_pair)
    together = jax.vmap(lambda scenario: jf.roll_out(config, scenario, weights, steps))(batch)
    row = int(np.argmin([scenarios.sizes_of(scenario)["obstacles"] for scenario in real_pair]))
    alone = jf.roll_out(config, real_pair[row], weights, steps)
    assert (int(together.outcome[row]), int(together.steps[row])) == (int(alone.outcome), int(alone.steps))
    np.testing.assert_allclose(together.ego.x[row], alone.ego.x, atol=1e-2)


@pytest.mark.parametrize(
    "wrong",
    [
        dict(sampling_level=-1),
        dict(shortest_end_step=31),
        dict(horizon_steps=251),
        dict(curvature_rate_limit=0.0),
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        jf.PlannerConfig(**wrong)


@pytest.mark.parametrize(("name", "trajectories"), [("fast", 180), ("full", 800), ("dense", 3564)])
def test_presets(name, trajectories):
    config = jf.PlannerConfig.preset(name, predictor="neural")
    assert (config.trajectories, config.predictor) == (trajectories, "neural")


def test_unknown_presets_are_refused():
    with pytest.raises(ValueError, match="'sparse': choose one of fast, full, dense"):
        jf.PlannerConfig.preset("sparse")


@pytest.mark.parametrize("name", ["harm_model", "emergency"])
def test_unknown_words_are_refused(name):
    """Also where annotations are not checked."""
    config = jf.PlannerConfig()
    object.__setattr__(config, name, "gentle")
    with pytest.raises(ValueError, match=rf"{name} is 'gentle': choose one of \w+, \w+"):
        config.__post_init__()
