"""Car-following and right of way against a double loop in plain Python and hand-computed cases."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.collision import Box
from scenarios import lines, traffic
from scenarios.traffic import Agents, Relations

STEPS = 120


def straight(count: int, length: float = 400.0) -> lines.Line:
    """The x-axis, once per agent."""
    along = jnp.broadcast_to(jnp.linspace(0.0, length, 41), (count, 41))
    zero = jnp.zeros_like(along)
    return lines.Line(along, along, zero, zero, zero, zero)


def agents(place: list[float], speed: list[float], desired: list[float], **changes: jnp.ndarray) -> Agents:
    count = len(place)
    one = Agents(
        line=straight(count),
        arc_length=jnp.asarray(place),
        speed=jnp.asarray(speed),
        desired_speed=jnp.asarray(desired),
        length=jnp.full(count, 4.5),
        width=jnp.full(count, 1.8),
        kind=jnp.full(count, jf.ObstacleKind.CAR, jnp.int32),
        exists=jnp.ones(count, bool),
        rank=jnp.arange(count, dtype=jnp.float32),
        yields=jnp.zeros(count, bool),
    )
    return dataclasses.replace(one, **changes)


def one_lane(count: int) -> Relations:
    everywhere = jnp.broadcast_to(jnp.asarray([-jnp.inf, jnp.inf]), (count, count, 2))
    return Relations(shift=jnp.zeros((count, count)), shared=everywhere, meets=-everywhere)


def strangers(meets: list[list[tuple[float, float]]]) -> Relations:
    count = len(meets)
    nowhere = jnp.broadcast_to(jnp.asarray([jnp.inf, -jnp.inf]), (count, count, 2))
    return Relations(shift=jnp.zeros((count, count)), shared=nowhere, meets=jnp.asarray(meets))


def idm_by_hand(place: list[float], speed: list[float], desired: list[float]) -> np.ndarray:
    """Positions `[steps, vehicles]` of vehicles in one lane, the foremost first."""
    s, v, rows = np.array(place), np.array(speed), []
    for _ in range(STEPS):
        rows.append(s.copy())
        acceleration = np.zeros(len(s))
        for me in range(len(s)):
            interaction = 0.0
            for leader in range(me):
                gap = s[leader] - s[me] - 4.5
                wanted = 2.0 + max(0.0, 1.2 * v[me] + v[me] * (v[me] - v[leader]) / (2.0 * np.sqrt(1.5 * 2.0)))
                interaction = max(interaction, (wanted / max(gap, 0.1)) ** 2)
            acceleration[me] = 1.5 * (1.0 - (v[me] / desired[me]) ** 4 - interaction)
        faster = np.maximum(v + 0.1 * np.clip(acceleration, -8.0, 1.5), 0.0)
        s, v = s + 0.05 * (v + faster), faster
    return np.array(rows)


def test_a_column_follows_the_intelligent_driver_model() -> None:
    place, speed, desired = [60.0, 40.0, 12.0], [5.0, 9.0, 12.0], [5.0, 10.0, 14.0]
    positions, speeds = traffic.drive(agents(place, speed, desired), one_lane(3), STEPS, slow_in_curves=False)
    np.testing.assert_allclose(positions, idm_by_hand(place, speed, desired), atol=5e-3)
    assert (np.diff(positions, axis=1) < -4.5).all()
    np.testing.assert_allclose(speeds[:, 0], 5.0, atol=1e-5)


def test_who_meets_a_standing_vehicle_stops_behind_it() -> None:
    positions, speeds = traffic.drive(
        agents([100.0, 30.0], [0.0, 10.0], [0.0, 10.0]), one_lane(2), 400, slow_in_curves=False
    )
    gap = float(positions[-1, 0] - positions[-1, 1]) - 4.5
    assert 1.5 < gap < 3.0
    assert float(speeds[-1, 1]) < 0.2


@pytest.mark.parametrize("yields", [False, True])
def test_who_yields_waits_until_the_other_has_passed(yields: bool) -> None:
    pair = agents([20.0, 10.0], [8.0, 8.0], [8.0, 8.0], yields=jnp.asarray([False, yields]))
    relations = strangers([[(0.0, -1.0), (50.0, 55.0)], [(40.0, 45.0), (0.0, -1.0)]])
    positions, _ = traffic.drive(pair, relations, STEPS, slow_in_curves=False)
    first_is_gone = np.asarray(positions[:, 0]) - 2.25 > 55.0
    second_is_there = np.asarray(positions[:, 1]) + 2.25 > 40.0
    assert second_is_there[-1]
    assert (second_is_there & ~first_is_gone).any() != yields


def test_everybody_lets_pedestrians_go_first() -> None:
    kind = jnp.asarray([jf.ObstacleKind.PEDESTRIAN, jf.ObstacleKind.CAR], jnp.int32)
    pair = agents([0.0, 10.0], [1.2, 8.0], [1.2, 8.0], kind=kind)
    relations = strangers([[(0.0, -1.0), (2.0, 8.0)], [(40.0, 45.0), (0.0, -1.0)]])
    positions, _ = traffic.drive(pair, relations, STEPS, slow_in_curves=False)
    assert not (np.asarray((positions[:, 0] < 8.0) & (positions[:, 1] + 2.25 > 40.0))).any()
    np.testing.assert_allclose(positions[:, 0], 0.12 * np.arange(STEPS), atol=1e-3)


def test_curves_are_taken_at_a_comfortable_speed() -> None:
    along = jnp.linspace(0.0, 100.0, 101)
    curvature = jnp.where((along > 50.0) & (along < 70.0), 0.1, 0.0)
    line = lines.Line(along, along, 0.0 * along, 0.0 * along, curvature, 0.0 * along)
    limit = traffic.comfortable_speed(line, jnp.float32(12.0))
    inside = (np.asarray(along) > 50.5) & (np.asarray(along) < 69.5)
    np.testing.assert_allclose(limit[inside], np.sqrt(3.0 / 0.1), rtol=1e-5)
    assert float(limit[0]) == pytest.approx(12.0) and float(limit[-1]) == pytest.approx(12.0)
    braking = np.diff(np.asarray(limit) ** 2) / 2.0
    assert braking.min() > -2.0 - 1e-3


def far_away() -> Box:
    away = jnp.float32(1e3)
    return Box.from_heading(away, away, jnp.float32(0.0), jnp.float32(4.5), jnp.float32(1.8))


def test_of_two_that_overlap_the_later_is_left_out() -> None:
    three = agents([50.0, 52.0, 20.0], [0.0, 0.0, 0.0], [0.1, 0.1, 0.1])
    positions = jnp.broadcast_to(three.arc_length, (5, 3))
    found = traffic.as_obstacles(three, positions, jnp.zeros((5, 3)), far_away())
    np.testing.assert_array_equal(found.valid.any(axis=1), [True, True, False])
    np.testing.assert_allclose(found.position[:, 0, 0], [50.0, 20.0, 0.0])
    np.testing.assert_allclose(found.length, [4.5, 4.5, 1.0])
    assert int(found.kind[2]) == jf.ObstacleKind.UNKNOWN


def test_who_starts_on_the_ego_or_reaches_the_end_of_its_line_is_not_there() -> None:
    two = agents([50.0, 397.0], [0.0, 0.0], [0.1, 0.1])
    positions = jnp.stack([jnp.full(3, 50.0), jnp.asarray([397.0, 397.7, 398.5])], axis=1)
    ego = Box.from_heading(*(jnp.float32(value) for value in (52.0, 1.0, 0.3, 4.5, 1.6)))
    found = traffic.as_obstacles(two, positions, jnp.zeros((3, 2)), ego)
    np.testing.assert_array_equal(found.valid, [[True, True, False], [False, False, False]])
    assert float(found.position[0, 0, 0]) == 397.0


def test_crossing_lines_meet_where_boxes_come_near() -> None:
    along = jnp.linspace(-50.0, 50.0, 41)
    zero = jnp.zeros(41)
    both = lines.Line(
        arc_length=jnp.stack([along + 50.0, along + 50.0]),
        x=jnp.stack([along, zero]),
        y=jnp.stack([zero, along]),
        heading=jnp.stack([zero, zero + 0.5 * jnp.pi]),
        curvature=jnp.zeros((2, 41)),
        curvature_derivative=jnp.zeros((2, 41)),
    )
    window = jnp.asarray([[30.0, 70.0], [30.0, 70.0]])
    meets = traffic.meeting_places(both, jnp.asarray([1.8, 2.2]), window, samples=201)
    np.testing.assert_allclose(meets[0, 1], [47.6, 52.4], atol=0.21)
    np.testing.assert_allclose(meets[1, 0], [47.6, 52.4], atol=0.21)
    apart = dataclasses.replace(both, y=both.y + jnp.asarray([[10.0], [100.0]]))
    assert not np.isfinite(traffic.meeting_places(apart, jnp.asarray([1.8, 2.2]), window, samples=41)[0, 1]).any()
