"""Desired speeds by hand, and each condition of a goal state on its own."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxfrenet.goal import desired_speed, judge, last_step


def wanted(goal, step=0, center=(20.0, 0.0), speed=10.0) -> float:
    center = jnp.asarray(center, jnp.float32)
    return float(desired_speed(goal, jnp.int32(step), center, center[0], jnp.float32(speed)))


def test_the_middle_of_the_region_in_the_middle_of_its_time(world):
    goal = world(goal=(70.0, 110.0), goal_steps=(50, 60)).goal
    assert wanted(goal) == pytest.approx(70 / 5.5, rel=1e-5)
    assert wanted(goal, step=20, center=(50.0, 0.0)) == pytest.approx(40 / 3.5, rel=1e-5)


def test_the_change_of_speed_is_bounded(world):
    goal = world(goal=(70.0, 110.0), goal_steps=(50, 60)).goal
    assert wanted(goal, step=54) == pytest.approx(15.0)
    assert wanted(goal, speed=30.0) == pytest.approx(25.0)
    assert wanted(goal, step=54, speed=48.0) == pytest.approx(50.0)
    assert wanted(world(goal=(20.5, 21.5)).goal, speed=1.0) == pytest.approx(1 / 5.5, rel=1e-4)


def test_inside_the_region_and_after_its_time(world):
    named = world(goal=(10.0, 110.0), goal_speed=(6.0, 9.0)).goal
    assert wanted(named) == pytest.approx(7.5)
    assert wanted(world(goal=(10.0, 110.0)).goal, speed=4.0) == pytest.approx(4.0)
    assert wanted(world(goal=(70.0, 110.0), goal_speed=(6.0, 9.0)).goal, step=58) == pytest.approx(7.5)
    assert wanted(world(goal=None).goal, speed=4.0) == pytest.approx(4.0)


def stands(goal, center=(80.0, 0.0), heading=0.0, speed=10.0) -> tuple[list[bool], list[bool]]:
    status = judge(goal, jnp.asarray(center, jnp.float32), jnp.float32(heading), jnp.float32(speed))
    return status.in_region.tolist(), status.matches.tolist()


def test_each_condition_counts(world):
    goal = world(goal_speed=(8.0, 12.0), goal_heading=(0.0, 0.2)).goal
    assert stands(goal) == ([True], [True])
    assert stands(goal, center=(69.9, 0.0)) == ([False], [False])
    assert stands(goal, speed=7.9) == ([True], [False])
    assert stands(goal, speed=12.1) == ([True], [False])
    assert stands(goal, heading=0.3) == ([True], [False])
    assert stands(goal, heading=2 * np.pi - 0.1) == ([True], [True])
    assert stands(goal, heading=-0.19 - 4 * np.pi) == ([True], [True])


def test_any_of_several_goal_states_will_do(world):
    near, far = world(goal=(20.0, 30.0)).goal, world(goal=(70.0, 110.0), goal_steps=(70, 90)).goal
    both = {}
    for field in dataclasses.fields(near):
        both[field.name] = jnp.concatenate([getattr(near, field.name), getattr(far, field.name)])
    goal = type(near)(**both)
    assert stands(goal) == ([False, True], [False, True])
    assert stands(goal, center=(25.0, 0.0)) == ([True, False], [True, False])
    assert int(last_step(goal)) == 90
    unused = dataclasses.replace(goal, valid=jnp.asarray([True, False]))
    assert stands(unused) == ([False, False], [False, False])
    assert int(last_step(unused)) == 60
