"""Each limit of the kinematic check against its own formula in float64, on made-up motions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.feasibility import check
from jaxfrenet.trajectories import Bundle, EgoState, Pose

VEHICLE = jf.BMW_320I
POINTS = 31


def bundle(rows: int = 1, end_step: int = 30, **fields) -> Bundle:
    """Trajectories at 10 m/s straight ahead, except for the given `[rows, points]` fields; one end offset."""
    zero = np.zeros((rows, POINTS))
    values = {field.name: zero for field in dataclasses.fields(EgoState)} | {
        "speed": zero + 10,
        "arc_length_rate": zero + 10,
    }
    values |= {name: np.broadcast_to(value, zero.shape) for name, value in fields.items()}
    motion = EgoState(**{name: jnp.asarray(value.T[:, None], jnp.float32) for name, value in values.items()})
    row, cos, sin = jnp.zeros((1, rows)), jnp.cos(motion.heading), jnp.sin(motion.heading)
    return Bundle(
        motion=motion,
        pose=Pose(motion.x, motion.y, cos, sin, motion.offset, jnp.zeros_like(cos)),
        valid=jnp.ones((1, rows), bool),
        end_step=jnp.full((1, rows), end_step, jnp.int32),
        end_speed=row,
        end_offset=row,
        lateral_jerk=row,
        longitudinal_jerk=row,
    )


def failed(made: Bundle, **settings) -> dict[str, list[bool]]:
    verdict = jax.jit(check, static_argnums=0)(jf.PlannerConfig(**settings), made)
    return {name: np.asarray(value).tolist() for name, value in vars(verdict).items() if name != "valid"}


def only(name: str) -> dict[str, list[bool]]:
    names = ("acceleration", "curvature", "curvature_rate", "yaw_rate", "backwards")
    return {"feasible": [not name], **{one: [one == name] for one in names}}


def at(index: int, value: float) -> np.ndarray:
    return np.where(np.arange(POINTS) == index, value, 0.0)


def test_straight_and_steady_is_feasible():
    assert failed(bundle()) == only("")


@pytest.mark.parametrize(
    ("speed", "acceleration", "ok"),
    [
        (5.0, 11.4, True),
        (5.0, 11.6, False),
        (20.0, 4.2, True),
        (20.0, 4.3, False),
        (20.0, -11.4, True),
        (5.0, -11.6, False),
    ],
)
def test_acceleration(speed, acceleration, ok):
    """At 20 m/s the engine gives 11.5 · 7.319/20 = 4.208 m/s²."""
    got = failed(bundle(speed=speed, arc_length_rate=speed, acceleration=at(7, acceleration)))
    assert got == only("" if ok else "acceleration")


def test_curvature_is_checked_inside_only():
    """Points 2 … n - 3 of the n points up to the end time; heading and rate are left out of it by a high limit."""
    limit = np.tan(1.066) / 2.5789128
    for index, counts in ((1, False), (2, True), (27, True), (28, True), (29, False), (30, False)):
        got = failed(bundle(curvature=at(index, 1.001 * limit)), curvature_rate_limit=1e3)
        assert got["curvature"] == [counts], index
        assert failed(bundle(curvature=at(index, 0.999 * limit)), curvature_rate_limit=1e3) == only("")
    assert failed(bundle(curvature=at(15, 1.0), end_step=11), curvature_rate_limit=1e3) == only("")


def test_curvature_rate_as_a_number():
    ramp = np.arange(POINTS) * 0.1
    assert failed(bundle(curvature=0.39 * ramp / 10)) == only("")
    steps = np.where(np.arange(POINTS) >= 5, 0.041, 0.0)
    assert failed(bundle(curvature=steps)) == only("curvature_rate")


def test_curvature_rate_of_the_vehicle():
    """|Δδ| ≤ 0.4 rad/s · 0.1 s with δ = atan(wheelbase · κ)."""
    rng = np.random.default_rng(0)
    curvature = np.repeat(rng.uniform(-0.6, 0.6, (500, 1)), POINTS, axis=1)
    curvature[:, 10:] += rng.uniform(-0.05, 0.05, (500, 1))
    steering = np.arctan(VEHICLE.wheelbase * curvature)
    change = np.abs(np.diff(steering, axis=1)).max(axis=1)
    clear = np.abs(change - 0.04) > 1e-5
    got = np.array(failed(bundle(500, curvature=curvature), curvature_rate_limit="vehicle")["curvature_rate"])
    np.testing.assert_array_equal(got[clear], (change > 0.04)[clear])
    assert 0.1 < got.mean() < 0.9


def test_friction_circle_of_the_vehicle():
    """Braking with 8 m/s² leaves √(11.5² - 8²) = 8.26 m/s² to the side; at 10 m/s that is a curvature of 0.0826 1/m."""
    for curvature, ok in ((0.082, True), (0.083, False)):
        made = bundle(acceleration=-8.0, curvature=curvature)
        assert failed(made, curvature_rate_limit="vehicle") == only("" if ok else "acceleration")
        assert failed(made) == only("")


def test_yaw_rate_also_across_pi():
    """|Δθ|/dt ≤ κ_max v; headings are compared by direction, so a turn of 2π between two points is none."""
    rng = np.random.default_rng(1)
    speed = rng.uniform(0.0, 5.0, (500, 1)) * np.ones(POINTS)
    turn = rng.uniform(-0.3, 0.3, (500, 1))
    heading = np.where(np.arange(POINTS) < 12, 3.1, 3.1 + turn)
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    limit = VEHICLE.max_curvature * speed[:, 0]
    clear = np.abs(np.abs(turn[:, 0]) / 0.1 - limit) > 1e-3
    got = np.array(failed(bundle(500, heading=heading, speed=speed))["yaw_rate"])
    np.testing.assert_array_equal(got[clear], (np.abs(turn[:, 0]) / 0.1 > limit)[clear])
    assert 0.1 < got.mean() < 0.9


def test_at_rest_without_turning_is_feasible():
    assert failed(bundle(speed=0.0, arc_length_rate=0.0, heading=1.234)) == only("")


def test_backwards():
    assert failed(bundle(arc_length_rate=at(3, -1e-4) + 1.0 * (np.arange(POINTS) != 3))) == only("backwards")


def test_what_is_not_valid_fails_no_check():
    made = dataclasses.replace(bundle(curvature=at(9, 5.0)), valid=jnp.zeros((1, 1), bool))
    assert failed(made) == {"feasible": [False]} | {k: [False] for k in only("") if k != "feasible"}
