"""Harm against the same formulas written down plainly in float64, and against values worked out by hand."""

import math
from functools import partial
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.config import HarmModel
from jaxfrenet.harm import Harm, Party, boundary_harm, harm, impact_angles, obstacle_mass, velocity_changes

KINDS = list(jf.ObstacleKind)
EGO_MASS = jf.BMW_320I.mass


def logistic(value: float) -> float:
    return 1 / (1 + math.exp(-value))


def plain_mass(kind: jf.ObstacleKind, length: float, width: float) -> float:
    fixed = dict(TRUCK=25e3, BUS=13e3, BICYCLE=90.0, PEDESTRIAN=75.0, TRAIN=118.8e3, MOTORCYCLE=250.0)
    return fixed.get(kind.name) or (526.9 * (length * width) ** 0.8 - 1333.5)


def area(angle: float) -> float:
    angle = math.pi - (math.pi - angle) % (2 * math.pi)
    assert -math.pi < angle <= math.pi
    if abs(angle) < math.pi / 4 - 1e-6:
        return 0.0
    return -0.431 if abs(angle) > 3 * math.pi / 4 + 1e-6 else 0.244


def plain_harm(model: str, ego, partner, kind: jf.ObstacleKind) -> tuple[float, float]:
    """The definition for one pair; `ego` and `partner` are x, y, heading, speed, mass in float64."""
    (ex, ey, et, ev, em), (ox, oy, ot, ov, om) = ego, partner
    if kind is jf.ObstacleKind.STRUCTURE:
        return 1.0, 1.0
    change = math.sqrt(max(ev**2 + ov**2 + 2 * ev * ov * math.cos(ot - et + math.pi), 0.0))
    ego_change, partner_change = om / (em + om) * change, em / (em + om) * change
    free = logistic(0.185 * ego_change - 4.591), logistic(0.185 * partner_change - 4.591)
    if kind.name in ("PEDESTRIAN", "BICYCLE", "MOTORCYCLE"):
        return free[0], logistic(0.288 * partner_change - 3.164)
    if model == "angle_free":
        return free
    bearing = math.atan2(oy - ey, ox - ex)
    return (
        logistic(-4.457 + 0.177 * ego_change + area(bearing - et)),
        logistic(-4.457 + 0.177 * partner_change + area(math.pi + bearing - ot)),
    )


def party(values) -> Party:
    """`[..., 5]` to the fields x, y, heading, speed, mass."""
    return Party(*(jnp.asarray(values[..., i], jnp.float32) for i in range(5)))


def rounded(values) -> np.ndarray:
    """As the code under test sees them: float32, in float64."""
    return np.asarray(values, np.float32).astype(np.float64)


compiled = {model: jax.jit(partial(harm, model)) for model in get_args(HarmModel)}


def check(ego, partner, kinds):
    """Compare rows `[n, 5]` with the plain formulas."""
    ego, partner = rounded(ego), rounded(partner)
    for model, function in compiled.items():
        got: Harm = function(party(ego), party(partner), jnp.asarray(kinds, jnp.int32))
        expected = [
            plain_harm(model, one, other, jf.ObstacleKind(kind))
            for one, other, kind in zip(ego, partner, kinds, strict=True)
        ]
        np.testing.assert_allclose(np.stack([got.ego, got.third_party], -1), expected, rtol=0, atol=1e-5)


def test_every_kind_of_obstacle_at_random():
    rng = np.random.default_rng(0)
    count = 400 * len(KINDS)
    kinds = np.tile(KINDS, 400)

    def draw(mass):
        return np.stack(
            [*rng.uniform(-30, 30, (2, count)), *rng.uniform([[-7], [0]], [[7], [40]], (2, count)), mass], -1
        )

    sizes = rng.uniform([1.9, 1.8], [12, 2.6], (count, 2))
    masses = [plain_mass(jf.ObstacleKind(kind), *size) for kind, size in zip(kinds, sizes, strict=True)]
    single = [jnp.asarray(side, jnp.float32) for side in sizes.T]
    np.testing.assert_allclose(obstacle_mass(jnp.asarray(kinds, jnp.int32), *single), masses, rtol=1e-5)
    check(draw(np.full(count, EGO_MASS)), draw(np.array(masses)), kinds)


def test_borders_of_the_areas_belong_to_the_side():
    """Impacts at ± 45° and ± 135°, and a hundred-thousandth of a radian to either side, for both parties."""
    border = np.array([1, 3, -1, -3])[:, None] * math.pi / 4 + np.array([0.0, 1e-5, -1e-5])
    border = np.append(border.reshape(-1), [0.0, math.pi, -math.pi, math.pi / 2])
    base = np.array([3.0, -2.0, 0.0, 12.0, EGO_MASS])
    ego, partner = np.tile(base, (len(border), 1)), np.tile(base, (len(border), 1))
    partner[:, 0] += 10.0
    ego[:, 2], partner[:, 2] = -border, border[::-1]
    partner[:, 3] = 7.0
    check(ego, partner, [jf.ObstacleKind.CAR] * len(border))
    at_border = compiled["symmetric_areas"](party(ego[:1]), party(partner[:1]), jnp.asarray([1], jnp.int32))
    in_front = compiled["symmetric_areas"](party(ego[2:3]), party(partner[:1]), jnp.asarray([1], jnp.int32))
    odds = [float(value.ego[0] / (1 - value.ego[0])) for value in (at_border, in_front)]
    assert math.log(odds[0] / odds[1]) == pytest.approx(0.244, abs=1e-3)


@pytest.mark.parametrize("border", [1, 3, 5, 7])
@pytest.mark.parametrize("turns", [0, 1, -1])
def test_rounding_does_not_move_a_border(border, turns):
    """A diagonal bearing reaches the border through a difference of rounded angles, with and without full turns."""
    base = np.array([250.0, -131.0, 0.0, 12.0, EGO_MASS])
    ego, partner = base.copy(), base + [8.0, 8.0, 0.0, 0.0, 0.0]
    ego[2] = math.pi / 4 - border * math.pi / 4 + 2 * math.pi * turns
    got = compiled["symmetric_areas"](party(ego[None]), party(partner[None]), jnp.asarray([1], jnp.int32))
    share = 0.5 * 24.0 * abs(math.sin(ego[2] / 2))
    assert float(got.ego[0]) == pytest.approx(logistic(-4.457 + 0.177 * share + 0.244), abs=1e-5)


def test_alike_motion_does_not_cancel():
    """Following at nearly the same speed in nearly the same direction: pdof is near π."""
    rng = np.random.default_rng(1)
    count = 500
    ego = np.stack(
        [*np.zeros((2, count)), rng.uniform(-3, 3, count), rng.uniform(0, 50, count), np.full(count, 1e3)], -1
    )
    ego = rounded(ego)
    partner = ego + np.stack([np.ones(count), np.ones(count), *rng.normal(0, 1e-4, (2, count)), np.zeros(count)], -1)
    partner[:100] = ego[:100]
    partner = rounded(partner)
    speed, other, turn = ego[:, 3], partner[:, 3], partner[:, 2] - ego[:, 2]
    exact = 0.5 * np.sqrt((speed - other) ** 2 + 4 * speed * other * np.sin(turn / 2) ** 2)
    for got in velocity_changes(party(ego), party(partner)):
        np.testing.assert_allclose(got, exact, rtol=0, atol=1e-5)
    check(ego, partner, [jf.ObstacleKind.CAR] * count)


def test_by_hand():
    """Head-on at 10 m/s each, equal masses: each changes by 10 m/s. Ego hits a standing one's left side at 20 m/s."""
    head_on = velocity_changes(*(party(np.array(p)) for p in ([0, 0, 0, 10, 1e3], [5, 0, math.pi, 10, 1e3])))
    np.testing.assert_allclose(head_on, [10.0, 10.0], atol=1e-5)
    ego, partner = party(np.array([0, 0, math.pi / 2, 20, 1e3])), party(np.array([0, 5, math.pi, 0, 3e3]))
    np.testing.assert_allclose(velocity_changes(ego, partner), [15.0, 5.0], atol=1e-5)
    np.testing.assert_allclose(impact_angles(ego, partner), [0.0, math.pi / 2], atol=1e-6)
    got = harm("symmetric_areas", ego, partner, jnp.int32(jf.ObstacleKind.CAR))
    assert (
        float(got.ego)
        == pytest.approx(1 / (1 + math.exp(4.457 - 0.177 * 15)), abs=1e-6)
        == pytest.approx(0.1416, abs=1e-4)
    )
    assert float(got.third_party) == pytest.approx(1 / (1 + math.exp(4.457 - 0.177 * 5 - 0.244)), abs=1e-6)
    hit = harm("symmetric_areas", ego, partner, jnp.int32(jf.ObstacleKind.PEDESTRIAN))
    assert float(hit.third_party) == pytest.approx(1 / (1 + math.exp(3.164 - 0.288 * 5)), abs=1e-6)
    assert float(hit.ego) == pytest.approx(1 / (1 + math.exp(4.591 - 0.185 * 15)), abs=1e-6)


def test_at_rest_at_one_place_and_beyond_all_measure():
    still, far = [0.0, 0.0, 0.0, 0.0, EGO_MASS], [1e18, -1e18, 3.0, 1e18, 1e18]
    fast, turned = [0.0, 0.0, 1.0, 30.0, EGO_MASS], [0.0, 0.0, -2.5, 30.0, 75.0]
    pairs = [(a, b) for a in (still, fast, turned) for b in (still, fast, turned)]
    for kind in KINDS:
        check(np.array([a for a, _ in pairs]), np.array([b for _, b in pairs]), [kind] * len(pairs))
        for a, b in ((still, far), (far, still), (far, far), (fast, far)):
            got = compiled["symmetric_areas"](
                party(np.array([a])), party(np.array([b])), jnp.asarray([kind], jnp.int32)
            )
            assert 0.0 <= float(got.ego[0]) <= 1.0 and 0.0 <= float(got.third_party[0]) <= 1.0


def test_one_ego_meets_many():
    ego, partner = party(np.array([0.0, 0.0, 0.2, 9.0, EGO_MASS])), party(np.full((7, 3, 5), 4.0))
    got = harm("symmetric_areas", ego, partner, jnp.full((7, 1), jf.ObstacleKind.CAR, jnp.int32))
    assert got.ego.shape == got.third_party.shape == (7, 3)


def test_the_smallest_things_have_a_mass():
    kinds = jnp.asarray([jf.ObstacleKind.UNKNOWN, jf.ObstacleKind.CAR], jnp.int32)
    mass = obstacle_mass(kinds, jnp.asarray([0.5, 0.0]), jnp.asarray([0.5, 0.0]))
    np.testing.assert_array_equal(mass, [75.0, 75.0])


def test_leaving_the_road_depends_on_speed():
    speed = np.array([0.0, 13.9, 50.0, 1e4])
    expected = [logistic(0.185 * value - 4.591) for value in speed]
    np.testing.assert_allclose(boundary_harm(jnp.asarray(speed, jnp.float32)), expected, atol=1e-6)
