"""Whole episodes in the environment: the default planner under the zero action, adjusted weights, the automatic reset,
draws, batches, generated scenarios, and the Gymnasium interface."""

import dataclasses
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.environment import (
    PAPER_ADJUSTMENTS,
    SAMPLING_ADJUSTMENTS,
    Adjustment,
    DrivingEnvironment,
    EnvironmentConfig,
    RewardFactors,
    begin,
    make_params,
    observation_fields,
    roll_out_policy,
)
from scenarios import tjunction

CONFIG = EnvironmentConfig(planner=jf.PlannerConfig.preset("fast", predictor="constant_velocity"))
ENVIRONMENT = DrivingEnvironment(CONFIG)
KEY = jax.random.key(3)
MAX_STEPS = 80


def stacked(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def element(tree, index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def assert_close(tree, expected, atol=0.0, rtol=0.0):
    def compare(path, a, b):
        np.testing.assert_allclose(a, b, atol=atol, rtol=rtol, err_msg=jax.tree_util.keystr(path))

    jax.tree_util.tree_map_with_path(compare, tree, expected)


def no_action(memory, observation):
    return memory, jnp.zeros(len(CONFIG.adjustments))


@pytest.fixture(scope="module")
def worlds(world, thing) -> dict[str, jf.Scenario]:
    """One for each outcome, and an obstacle ahead."""

    def wall(x, speed=0.0):
        return [thing(x, y, speed=speed, width=4.0) for y in (-4.0, 0.0, 4.0)]

    beside = world(goal=(40.0, 45.0), goal_steps=(58, 60), goal_speed=(9.0, 11.0))
    edges = beside.goal.edges + jnp.asarray([0.0, 40.0])
    short = world()
    return {
        "goal_reached_in_time": world(goal=(70.0, 110.0), goal_steps=(50, 60)),
        "obstacle_ahead": world([thing(45.0, 0.5, speed=6.0)]),
        "goal_reached_late": world(goal=(83.0, 110.0), goal_steps=(40, 42), speed=9.0),
        "goal_reached_faster": world(goal=(15.0, 30.0), goal_steps=(58, 60), goal_speed=(9.0, 11.0)),
        "past_goal": dataclasses.replace(beside, goal=dataclasses.replace(beside.goal, edges=edges)),
        "timeout": world([dataclasses.replace(one, static=True) for one in wall(60.0)], goal_steps=(50, 55)),
        "collision_obstacle": world(wall(27.5)),
        "collision_road": world(start=(20.0, 3.0), heading=0.9, half_width=5.0),
        "infeasible": dataclasses.replace(short, path=dataclasses.replace(short.path, length=jnp.float32(23.0))),
        "rear_ended": world(wall(10.0, speed=25.0), speed=5.0),
    }


@pytest.fixture(scope="module")
def params(worlds):
    return make_params(CONFIG, stacked(worlds.values()))


@pytest.fixture(scope="module")
def only(params, worlds):
    """`only(name)`: parameters by which that world alone is drawn."""

    def of(name):
        chosen = np.arange(len(worlds)) >= list(worlds).index(name)
        return dataclasses.replace(params, chances=jnp.asarray(chosen, jnp.float32))

    return of


@pytest.fixture(scope="module")
def reset():
    return jax.jit(ENVIRONMENT.reset)


@pytest.fixture(scope="module")
def step():
    return jax.jit(ENVIRONMENT.step)


@pytest.fixture(scope="module")
def drive(reset, step):
    """`drive(params, actions)`: for each step, until the first end, the state before it and all that it returned."""

    def until_the_end(params, actions=None):
        actions = np.zeros((MAX_STEPS, len(CONFIG.adjustments)), np.float32) if actions is None else actions
        _, state = reset(KEY, params)
        driven = []
        for action in actions:
            driven.append((state, step(KEY, state, jnp.asarray(action), params)))
            state = driven[-1][1][1]
            if driven[-1][1][3]:
                break
        return driven

    return until_the_end


@pytest.fixture(scope="module")
def episodes(worlds, only, drive):
    """{world: its episode without an action}."""
    return {name: drive(only(name)) for name in worlds}


@pytest.fixture(scope="module")
def expected(worlds):
    """{world: the default planner's episode}."""
    return {name: jf.roll_out(CONFIG.planner, one, jf.CostWeights(), MAX_STEPS) for name, one in worlds.items()}


def test_without_an_action_the_default_planner_drives(worlds, episodes, expected):
    for name, driven in episodes.items():
        episode = expected[name]
        assert len(driven) == int(episode.steps), name
        for count, (before, _) in enumerate(driven):
            simulation = before.situation.simulation
            assert int(simulation.step) == count
            assert_close(simulation.ego, element(episode.ego, count))
        told = driven[-1][1][-1]["episode"]
        assert float(told[f"outcome/{jf.Outcome(int(episode.outcome)).name.lower()}"]) == 1.0, name
        assert sum(float(value) for key, value in told.items() if key in OUTCOME_NAMES) == 1.0, name


OUTCOME_NAMES = [f"outcome/{one.name.lower()}" for one in jf.Outcome if one is not jf.Outcome.RUNNING]


def test_each_world_ends_as_it_is_meant_to(worlds, expected):
    named = {name: jf.Outcome(int(expected[name].outcome)).name.lower() for name in worlds}
    meant = {name: name for name in worlds} | {
        "obstacle_ahead": "goal_reached_late",
        "rear_ended": "collision_obstacle",
    }
    assert named == meant


def test_a_policy_that_does_nothing_is_the_default_planner(worlds, expected):
    for name, scenario in worlds.items():
        episode = roll_out_policy(CONFIG, scenario, no_action, None, MAX_STEPS)
        assert int(episode.outcome) == int(expected[name].outcome), name
        assert int(episode.steps) == int(expected[name].steps), name
        assert_close(episode.ego, expected[name].ego)
        np.testing.assert_array_equal(episode.reports.weights[0], jf.CostWeights().values())


def test_a_summary_tells_of_the_whole_episode(episodes, expected):
    for name, driven in episodes.items():
        told, reports, steps = driven[-1][1][-1]["episode"], expected[name].reports, len(driven)
        for summary, values in (
            ("mean_ego_risk", np.mean(reports.ego_risk[:steps])),
            ("mean_third_party_risk", np.mean(reports.third_party_risk[:steps])),
            ("max_ego_risk", np.max(reports.ego_risk[:steps])),
        ):
            assert float(told[summary]) == pytest.approx(float(values), rel=1e-3, abs=1e-9), (name, summary)


def test_metrics_tell_of_the_step(episodes, expected):
    for name, driven in episodes.items():
        for count, (before, (*_, info)) in enumerate(driven):
            metrics, report = info["metrics"], element(expected[name].reports, count)
            assert float(metrics["speed"]) == float(before.situation.simulation.ego.speed)
            assert float(metrics["feasible_share"]) == pytest.approx(float(report.feasible_share), abs=1e-6)
            assert float(metrics["emergency"]) == (int(report.mode) == jf.PlanMode.EMERGENCY)
            for risk in ("ego_risk", "third_party_risk"):
                assert float(metrics[risk]) == pytest.approx(float(getattr(report, risk)), rel=1e-3, abs=1e-9)


def test_who_runs_into_whom(episodes):
    struck = {
        name: float(driven[-1][1][-1]["episode"]["outcome/collision_from_behind"]) for name, driven in episodes.items()
    }
    assert struck == {name: float(name == "rear_ended") for name in episodes}


def test_observations_and_rewards_are_finite_and_only_the_last_step_ends(episodes):
    for driven in episodes.values():
        for count, (_, (observation, _, reward, terminated, truncated, info)) in enumerate(driven):
            assert observation.shape == (ENVIRONMENT.observation_size,) and observation.dtype == jnp.float32
            assert np.isfinite(observation).all() and np.isfinite(info["last_observation"]).all()
            assert np.isfinite(reward)
            assert bool(terminated) == (count == len(driven) - 1)
            assert not truncated


def test_the_reward_is_the_sum_of_its_terms(episodes, expected):
    defaults = RewardFactors()
    for name, driven in episodes.items():
        for count, (_, (*_, reward, _, _, info)) in enumerate(driven):
            terms = {key[7:]: float(value) for key, value in info["metrics"].items() if key.startswith("reward/")}
            assert sum(terms.values()) == pytest.approx(float(reward), rel=1e-5, abs=1e-6)
            after = element(expected[name].ego, count + 1)
            away = abs(float(after.speed - expected[name].reports.desired_speed[count]))
            assert terms["speed"] == pytest.approx(float(defaults.speed) * away, abs=1e-4)
            assert terms["weights"] == terms["prediction_weight"] == terms["progress"] == 0.0
        ends = {key: value for key, value in terms.items() if abs(value) >= 300.0 and "risk" not in key}
        outcome = jf.Outcome(int(expected[name].outcome)).name.lower()
        term = "collision" if "collision" in outcome else outcome
        assert ends == {term: getattr(defaults, term)}


def test_other_factors_need_no_other_program(only, reset, step, episodes):
    compiled = step._cache_size()
    factors = RewardFactors(speed=-2.0, offset=-3.0, progress=1.5, risk_magnitude=-0.1, goal_reached_in_time=7.0)
    params = dataclasses.replace(only("obstacle_ahead"), rewards=ENVIRONMENT.generator_params(factors).rewards)
    _, state = reset(KEY, params)
    action = jnp.asarray([0.5, 1.0, -1.0, -0.2, 0.3])
    for _ in range(5):
        before = state.situation.simulation
        *_, info = told = step(KEY, state, action, params)
        state = told[1]
        after = state.situation.simulation.ego
        metrics = info["metrics"]
        assert float(metrics["reward/offset"]) == pytest.approx(-3.0 * abs(float(after.offset)), abs=1e-5)
        driven = float(after.arc_length - before.ego.arc_length)
        assert float(metrics["reward/progress"]) == pytest.approx(1.5 * driven, abs=1e-4)
        away = np.abs(np.asarray(state.situation.weights) - [200.0, 1.0, 1.0, 1.0, 1.0])
        assert float(metrics["reward/weights"]) == pytest.approx(-0.1 * away[1:].sum(), rel=1e-4)
        assert float(metrics["reward/prediction_weight"]) == pytest.approx(-0.0005 * away[0], rel=1e-4)
    assert step._cache_size() == compiled


def test_weights_follow_the_actions(only, drive):
    """Random walks, to both limits; actions outside [-1, 1] count as the nearest within, NaN as zero."""
    rng = np.random.default_rng(1)
    actions = rng.uniform(-2.0, 2.0, (30, 5)).astype(np.float32)
    actions[3, 1], actions[7, :], actions[8, 2], actions[9, 3] = np.nan, np.nan, np.inf, -np.inf
    actions[12:, 0], actions[12:, 4] = 1.0, -1.0
    low, high, scale, weights = (
        np.asarray([getattr(one, name) for one in PAPER_ADJUSTMENTS], np.float32)
        for name in ("low", "high", "scale", "default")
    )
    driven = drive(only("timeout"), actions)
    assert len(driven) == len(actions)
    index = [place for place, one in enumerate(observation_fields(CONFIG)) if one.name.startswith("weight_")]
    for action, (_, (observation, state, *_, info)) in zip(actions, driven, strict=True):
        weights = np.clip(weights + scale * np.clip(np.nan_to_num(action, posinf=1.0, neginf=-1.0), -1, 1), low, high)
        np.testing.assert_allclose(state.situation.weights, weights, rtol=1e-5)
        told = [float(info["metrics"][f"weight/{one.term}"]) for one in PAPER_ADJUSTMENTS]
        np.testing.assert_allclose(told, weights, rtol=1e-5)
        np.testing.assert_allclose(observation[jnp.asarray(index)], 2 * (weights - low) / (high - low) - 1, atol=1e-5)
        assert np.isfinite(observation).all()
    assert weights[0] == 400.0 and weights[4] == np.float32(0.001)


def test_weights_decide_what_is_driven(only, drive):
    """Without the wish to keep the desired speed, the ego stays at its own."""
    actions = np.zeros((25, 5), np.float32)
    actions[:, 4] = -1.0
    usual, careless = (drive(only("goal_reached_late"), one)[24][1][1] for one in (0 * actions, actions))
    speeds = [float(one.situation.simulation.ego.speed) for one in (usual, careless)]
    assert speeds[0] > speeds[1] + 0.5


def test_after_an_end_the_next_episode_begins(params, episodes, reset, step):
    for key, (before, (_, _, _, _, _, alone)) in zip(
        jax.random.split(KEY, len(episodes)), (driven[-1] for driven in episodes.values()), strict=True
    ):
        observation, state, _, terminated, _, info = step(key, before, jnp.zeros(5), params)
        assert terminated
        first, fresh = reset(key, params)
        assert_close((observation, state), (first, fresh))
        np.testing.assert_array_equal(info["last_observation"], alone["last_observation"])
        assert np.abs(np.asarray(observation - info["last_observation"])).max() > 0.01
        assert [float(one) for one in jax.tree.leaves(state.sums)] == [0.0] * 4
        assert int(state.situation.simulation.step) == 0
        np.testing.assert_array_equal(state.situation.weights, [one.default for one in PAPER_ADJUSTMENTS])


def test_while_an_episode_goes_on_the_observation_is_its_own(episodes):
    for driven in episodes.values():
        for _, (observation, state, *_, info) in driven[:-1]:
            np.testing.assert_array_equal(observation, info["last_observation"])
            np.testing.assert_array_equal(observation, state.situation.observation)


def test_parameters_hold_every_scenario_once(worlds, params):
    """More scenarios than are prepared at a time, and not a multiple of it."""
    started = jax.jit(jax.vmap(partial(begin, CONFIG)))(stacked(worlds.values()))
    assert_close(params.starts, started, atol=1e-6)
    assert_close(params.scenarios, stacked(worlds.values()))
    np.testing.assert_allclose(params.chances, np.arange(1, 11) / 10, atol=1e-6)


SHARES = np.asarray([0.0, 1.0, 0.0, 3.0, 0.0], np.float32)
NEURAL = dataclasses.replace(CONFIG, planner=dataclasses.replace(CONFIG.planner, predictor="neural"))


@pytest.fixture(scope="module")
def neural_params(world, thing):
    """Five scenarios, drawn by `SHARES`; the last but one has traffic."""
    traffic = [thing(30.0, 0.0, speed=8.0), thing(60.0, 1.0, speed=5.0, steps=(10, 40)), thing(80.0, -3.0, static=True)]
    five = stacked([world(), world(), world(), world(traffic), world()])
    return make_params(NEURAL, five, shares=jnp.asarray(SHARES))


def test_scenarios_are_drawn_by_their_shares(neural_params):
    draw = jax.jit(jax.vmap(lambda key: DrivingEnvironment(NEURAL).reset(key, neural_params)[1].scenario))
    drawn = np.bincount(draw(jax.random.split(KEY, 4000)), minlength=5)
    assert not drawn[SHARES == 0].any()
    assert abs(drawn[1] / 4000 - 0.25) < 0.03


@pytest.mark.parametrize(("uniform", "drawn"), [(0.0, 1), (0.2499, 1), (0.25, 3), (np.float32(1 - 2**-24), 3)])
def test_the_ends_of_the_shares(params, worlds, monkeypatch, uniform, drawn):
    chances = jnp.asarray([0.0, 0.25, 0.25, 1.0, 1.0] + [1.0] * (len(worlds) - 5))
    monkeypatch.setattr(jax.random, "uniform", lambda key: jnp.float32(uniform))
    state = ENVIRONMENT.reset(KEY, dataclasses.replace(params, chances=chances))[1]
    np.testing.assert_array_equal(state.scenario, drawn)


def test_the_batch_changes_nothing(params, episodes, step):
    """Three episodes, of which one ends, side by side and one by one."""
    begun = [episodes["obstacle_ahead"][7][0], episodes["collision_obstacle"][-1][0], episodes["timeout"][30][0]]
    keys = jax.random.split(KEY, 3)
    actions = jnp.asarray(np.random.default_rng(2).uniform(-1, 1, (3, 5)), jnp.float32)
    together = jax.jit(jax.vmap(ENVIRONMENT.step, (0, 0, 0, None)))(keys, stacked(begun), actions, params)
    np.testing.assert_array_equal(together[3], [False, True, False])
    for index in range(3):
        alone = step(keys[index], begun[index], actions[index], params)
        assert_close(element(together, index), alone, atol=1e-5, rtol=1e-5)


EXTENDED = (
    *PAPER_ADJUSTMENTS[1:],
    Adjustment("acceleration", 0.2, 0.0, 1.0, 0.1),
    PAPER_ADJUSTMENTS[0],
    *SAMPLING_ADJUSTMENTS[5:],
)
JUNCTIONS = tjunction.TJunctionConfig()


def timed_out(state):
    """The state, with an end at the next step."""
    late = dataclasses.replace(state.situation.simulation, step=jnp.int32(1000))
    return dataclasses.replace(state, situation=dataclasses.replace(state.situation, simulation=late))


def test_generated_scenarios_with_more_adjustments():
    config = dataclasses.replace(CONFIG, adjustments=EXTENDED)
    environment = DrivingEnvironment(config, lambda key: tjunction.sample(key, JUNCTIONS))
    assert environment.action_size == 9
    assert environment.observation_size == ENVIRONMENT.observation_size + 3 + 4
    params, step = environment.generator_params(), jax.jit(environment.step)
    shapes = jax.eval_shape(environment.reset, KEY, params)[1]
    ending = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    action = jnp.asarray([0.0, 0.0, 0.0, 0.0, 1.0, -1.0, -0.5, 0.0, 0.0])
    _, state, *_ = step(KEY, ending, action, params)
    first = state.scenario
    names = [one.name for one in observation_fields(config)]
    for count in range(1, 4):
        observation, state, reward, terminated, _, info = step(KEY, state, action, params)
        assert not terminated and np.isfinite(observation).all() and np.isfinite(reward)
        weight, metrics = 0.1 + 0.2 * count, info["metrics"]
        assert float(metrics["weight/acceleration"]) == pytest.approx(weight)
        assert float(metrics["weight/prediction"]) == pytest.approx(200.0 - 20.0 * count)
        assert float(metrics["weight/acceleration_range"]) == pytest.approx(1.0 - 0.1 * count)
        assert float(metrics["reward/weights"]) == pytest.approx(-0.1 * 0.3 * count, rel=1e-4)
        assert float(observation[names.index("weight_acceleration")]) == pytest.approx(2 * weight - 1)
        assert float(observation[names.index("cost_acceleration_mean")]) > 0.0
        assert_close(state.scenario, first)
    observation, following, _, terminated, _, info = step(jax.random.key(8), timed_out(state), action, params)
    assert terminated and float(info["episode"]["outcome/timeout"]) == 1.0
    assert np.abs(np.asarray(following.scenario.path.x - first.path.x)).max() > 1.0
    begun = jax.jit(partial(begin, config))(following.scenario)
    assert_close((observation, following.situation), (begun.observation, begun), atol=1e-5, rtol=1e-5)
    assert [float(one) for one in jax.tree.leaves(following.sums)] == [0.0] * 4
    again = step(KEY, timed_out(following), action, params)[1]
    assert_close(again.scenario, first)


def test_nothing_is_generated_before_an_end(world):
    """Neither alone nor in a batch."""
    scenario, generated = world(), []

    def generate(key):
        jax.debug.callback(lambda: generated.append(1))
        speed = jax.random.uniform(key, (), jnp.float32, 3.0, 12.0)
        return dataclasses.replace(scenario, initial_state=dataclasses.replace(scenario.initial_state, speed=speed))

    def count():
        jax.effects_barrier()
        return len(generated)

    environment = DrivingEnvironment(CONFIG, generate)
    params = environment.generator_params()
    keys = jax.random.split(KEY, 3)
    states = jax.jit(jax.vmap(environment.reset, (0, None)))(keys, params)[1]
    before = count()
    go_on = jax.jit(environment._begin_if)
    for ended, expected in ((False, 0), (True, 1), (False, 1)):
        state = go_on(jnp.asarray(ended), keys[1], element(states, 0), params)
        assert count() - before == expected
        assert_close(state, element(states, int(ended)), atol=1e-5, rtol=1e-5)
    before = count()
    together = jax.jit(jax.vmap(environment._begin_if, (0, 0, 0, None)))
    for ended, expected in (([False] * 3, 0), ([True, False, True], 2)):
        together(jnp.asarray(ended), keys, states, params)
        assert count() - before == expected


def test_without_scenarios_nor_generator_there_is_no_episode():
    with pytest.raises(ValueError, match="params hold no scenarios: make them with make_params, or give a generator"):
        ENVIRONMENT.reset(KEY, ENVIRONMENT.generator_params())


def test_looked_up_predictions_are_the_live_ones(neural_params):
    """Of the table an episode sees only the present step."""
    environment = DrivingEnvironment(NEURAL)
    _, start = environment.reset(KEY, neural_params)
    start = dataclasses.replace(start, scenario=jnp.int32(3))

    @jax.jit
    def predictions(state):
        simulation = state.situation.simulation
        where = simulation.step, simulation.ego.x, simulation.ego.y
        tabled = environment._scenario(state, neural_params)
        assert tabled.predictions is not None and tabled.predictions.heading.shape[0] == 1
        live = dataclasses.replace(tabled, predictions=None)
        return jf.predict(NEURAL.planner, tabled, *where), jf.predict(NEURAL.planner, live, *where)

    for count in (0, 10, 25, 60, 70):
        simulation = dataclasses.replace(start.situation.simulation, step=jnp.int32(count))
        situation = dataclasses.replace(start.situation, simulation=simulation)
        tabled, live = predictions(dataclasses.replace(start, situation=situation))
        np.testing.assert_array_equal(tabled.valid, live.valid)
        assert bool(live.valid[1].any()) == (10 <= count < 40)
        seen = np.asarray(live.valid)
        for name in ("mean", "covariance", "heading", "speed"):
            a, b = (np.asarray(getattr(one, name))[seen] for one in (tabled, live))
            np.testing.assert_allclose(a, b, atol=2e-4, err_msg=name)


@pytest.fixture
def wrapper():
    pytest.importorskip("gymnasium")
    from jaxfrenet.environment.gymnasium import GymnasiumEnvironment

    return GymnasiumEnvironment


@pytest.mark.filterwarnings("ignore:.*Box observation space m..imum value")
def test_gymnasium_finds_nothing_to_complain_about(wrapper, params):
    from gymnasium.utils.env_checker import check_env

    check_env(wrapper(ENVIRONMENT, params), skip_render_check=True)


def test_gymnasium_episodes_are_the_environments(wrapper, only, episodes):
    from gymnasium.error import ResetNeeded

    driven = episodes["collision_obstacle"]
    env = wrapper(ENVIRONMENT, only("collision_obstacle"))
    zero = np.zeros(env.action_space.shape, np.float32)
    with pytest.raises(ResetNeeded, match="call reset before step"):
        env.step(zero)
    for _ in range(2):
        observation, info = env.reset()
        np.testing.assert_array_equal(observation, driven[0][0].situation.observation)
        assert info == {}
        for count, (_, (*_, reward, _, _, told)) in enumerate(driven):
            observation, got, terminated, truncated, info = env.step(zero)
            np.testing.assert_array_equal(observation, told["last_observation"])
            assert (type(got), type(terminated), type(truncated)) == (float, bool, bool)
            assert got == float(reward) and not truncated
            assert terminated == ("summary" in info) == (count == len(driven) - 1)
            assert all(type(value) is float for part in info.values() for value in part.values())
        assert info["summary"]["outcome/collision_obstacle"] == 1.0
        with pytest.raises(ResetNeeded, match="the episode has ended"):
            env.step(zero)
    env.reset()
    with pytest.raises(ValueError, match="reshape"):
        env.step(zero[:3])


def test_gymnasium_draws_by_its_seed(wrapper, params):
    env = wrapper(ENVIRONMENT, params)

    def draws(seed):
        return np.stack([env.reset(seed=seed)[0], *(env.reset()[0] for _ in range(8))])

    once, again, other = draws(5), draws(5), draws(6)
    np.testing.assert_array_equal(once, again)
    assert not np.array_equal(once, other)
    assert len(np.unique(once, axis=0)) > 2


def test_without_gymnasium_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "jaxfrenet.environment.gymnasium", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'jaxfrenet\[gymnasium\]'"):
        import jaxfrenet.environment.gymnasium  # noqa: F401
