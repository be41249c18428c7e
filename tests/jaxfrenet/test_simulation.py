"""Every way that an episode ends, and that an episode is the sum of its steps."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.simulation import judge_state


def outcome_of(episode: jf.Episode) -> jf.Outcome:
    return jf.Outcome(int(episode.outcome))


def test_goal_reached_in_time(world, drive):
    episode = drive(world(goal=(70.0, 110.0), goal_steps=(50, 60)))
    assert outcome_of(episode) is jf.Outcome.GOAL_REACHED_IN_TIME
    assert 50 <= int(episode.steps) <= 60
    assert 70.0 <= float(episode.ego.x[episode.steps]) <= 110.0
    np.testing.assert_allclose(episode.ego.offset, 0.0, atol=0.05)


def test_goal_reached_late(world, drive):
    """Too far for the time, but it gets there before the time limit."""
    episode = drive(world(goal=(83.0, 110.0), goal_steps=(40, 42), speed=9.0))
    assert outcome_of(episode) is jf.Outcome.GOAL_REACHED_LATE
    assert 42 < int(episode.steps) <= 1.3 * 42 + 1


def test_goal_reached_faster(world, drive):
    """A region that the ego stands in at the start and is through long before its time; it must not stop in it."""
    episode = drive(world(goal=(15.0, 30.0), goal_steps=(58, 60), goal_speed=(9.0, 11.0)))
    assert outcome_of(episode) is jf.Outcome.GOAL_REACHED_FASTER
    assert int(episode.steps) < 58


def test_past_the_goal(world, drive):
    """The region lies beside the road that the ego keeps to."""
    scenario = world(goal=(40.0, 45.0), goal_steps=(58, 60), goal_speed=(9.0, 11.0))
    beside = dataclasses.replace(scenario.goal, edges=scenario.goal.edges + jnp.array([0.0, 40.0]))
    episode = drive(dataclasses.replace(scenario, goal=beside))
    assert outcome_of(episode) is jf.Outcome.PAST_GOAL
    assert float(episode.ego.x[episode.steps]) < 50.0


def test_timeout(world, drive, thing):
    """The road is blocked before the goal, so the ego stops and waits."""
    blocked = [thing(60.0, y, static=True, width=4.0) for y in (-4.0, 0.0, 4.0)]
    episode = drive(world(blocked, goal=(90.0, 110.0), goal_steps=(50, 55)))
    assert outcome_of(episode) is jf.Outcome.TIMEOUT
    assert int(episode.steps) == 72
    assert float(episode.ego.speed[episode.steps]) < 1.0
    assert float(episode.ego.x[episode.steps]) < 60.0 - 2.5


def test_collision_with_an_obstacle(world, drive, thing):
    """Nobody can stop from 10 m/s within 2 m."""
    episode = drive(world([thing(27.5, y, static=True, width=4.0) for y in (-4.0, 0.0, 4.0)]))
    assert outcome_of(episode) is jf.Outcome.COLLISION_OBSTACLE
    assert int(episode.steps) < 10


def test_collision_with_the_road_edge(world, drive):
    """The ego points at an edge that is too near."""
    episode = drive(world(start=(20.0, 3.0), heading=0.9, half_width=5.0))
    assert outcome_of(episode) is jf.Outcome.COLLISION_ROAD


def test_infeasible(world, drive):
    """At full speed no sampled trajectory undoes this yaw rate within the limits; and none does within the path."""
    scenario = world(speed=10.0, yaw_rate=0.0)
    short = dataclasses.replace(scenario.path, length=jnp.float32(23.0))
    episode = drive(dataclasses.replace(scenario, path=short))
    assert outcome_of(episode) is jf.Outcome.INFEASIBLE
    assert int(episode.steps) == 1
    assert float(episode.ego.x[1]) == float(episode.ego.x[0])


def test_goal_without_a_position(world, drive):
    episode = drive(world(goal=None, goal_steps=(30, 30)))
    assert outcome_of(episode) is jf.Outcome.GOAL_REACHED_IN_TIME
    assert int(episode.steps) == 30
    np.testing.assert_allclose(episode.ego.speed[:31], 10.0, atol=0.3)


def test_collision_comes_before_all_other_outcomes(world, config, thing):
    scenario = world([thing(90.0, 0.0, static=True)], goal=(70.0, 110.0), goal_steps=(1, 1))
    state = jf.reset(config, dataclasses.replace(scenario, initial_state=world(start=(90.0, 5.5)).initial_state))
    late = dataclasses.replace(state, step=jnp.int32(60))
    judge = jax.jit(partial(judge_state, config))
    off_road = judge(scenario, late)
    assert jf.Outcome(int(off_road.outcome)) is jf.Outcome.COLLISION_ROAD
    inside = dataclasses.replace(scenario, initial_state=world(start=(90.0, 0.0)).initial_state)
    hit = judge(inside, dataclasses.replace(jf.reset(config, inside), step=jnp.int32(60)))
    assert jf.Outcome(int(hit.outcome)) is jf.Outcome.COLLISION_OBSTACLE


def test_an_obstacle_that_has_left_hits_nobody(world, config, thing):
    scenario = world([thing(20.0, 0.0, steps=(0, 5))])
    judge = jax.jit(partial(judge_state, config))
    state = jf.reset(config, scenario)
    for step, expected in ((4, jf.Outcome.COLLISION_OBSTACLE), (5, jf.Outcome.RUNNING), (70, jf.Outcome.RUNNING)):
        assert jf.Outcome(int(judge(scenario, dataclasses.replace(state, step=jnp.int32(step))).outcome)) is expected


def test_the_time_limit_is_exact(world, config):
    """1.3 · 60 = 78 steps are allowed, the 79th is not."""
    scenario = world(goal=(200.0, 210.0), goal_steps=(50, 60))
    judge = jax.jit(partial(judge_state, config))
    state = jf.reset(config, scenario)
    for step, expected in ((78, jf.Outcome.RUNNING), (79, jf.Outcome.TIMEOUT)):
        assert jf.Outcome(int(judge(scenario, dataclasses.replace(state, step=jnp.int32(step))).outcome)) is expected


def test_roll_out_is_the_sum_of_its_steps(world, config, drive, thing):
    scenario = world([thing(45.0, 0.5, speed=6.0)])
    episode = drive(scenario)
    step = jax.jit(partial(jf.step, config))
    state = jf.reset(config, scenario)
    for index in range(12):
        state, report = step(scenario, state, jf.CostWeights())
        np.testing.assert_allclose(state.ego.x, episode.ego.x[index + 1], atol=1e-4)
        np.testing.assert_allclose(report.cost, episode.reports.cost[index], rtol=1e-3)
        np.testing.assert_allclose(report.costs @ jf.CostWeights().values(), report.cost, rtol=1e-5)
        np.testing.assert_allclose(report.ego_risk, episode.reports.ego_risk[index], rtol=1e-2)
        np.testing.assert_allclose(report.third_party_risk, episode.reports.third_party_risk[index], rtol=1e-2)
    assert 0.0 < np.max(episode.reports.ego_risk) <= 1.0 and 0.0 < np.max(episode.reports.third_party_risk) <= 1.0
    after_end = int(episode.steps)
    assert np.ptp(np.asarray(episode.ego.x)[after_end:]) == 0.0
    assert not np.asarray(episode.reports.costs)[after_end:].any()


def test_max_steps_is_enough(world):
    scenario = world(goal_steps=(50, 60))
    assert jf.max_steps(scenario) == 79
    assert jf.max_steps(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), scenario)) == 79


def test_reset_moves_from_the_centre_to_the_rear_axle(world, config):
    state = jf.reset(config, world(start=(20.0, 1.0), heading=np.pi / 6 + 2 * np.pi, yaw_rate=0.5, speed=5.0))
    behind = config.vehicle.rear_axle_to_center
    assert float(state.ego.x) == pytest.approx(20.0 - behind * np.cos(np.pi / 6), abs=1e-4)
    assert float(state.ego.y) == pytest.approx(1.0 - behind * np.sin(np.pi / 6), abs=1e-4)
    assert float(state.ego.heading) == pytest.approx(np.pi / 6, abs=1e-5)
    assert float(state.ego.curvature) == pytest.approx(0.1, abs=1e-5)
    np.testing.assert_allclose(state.center(config.vehicle), [20.0, 1.0], atol=1e-4)


def test_an_ego_at_rest_has_no_curvature_from_its_yaw_rate(world, config):
    state = jf.reset(config, world(speed=0.0, yaw_rate=0.3))
    assert float(state.ego.curvature) == 0.0
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(state))
