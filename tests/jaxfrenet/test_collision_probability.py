"""Rectangle masses against scipy, and the planner's cost against a plain double loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

import jaxfrenet as jf
from jaxfrenet.collision_probability import CORRELATION_CLASSES, FEWEST_AT_ONCE, collision_probability_cost
from jaxfrenet.gaussian import Gaussian, in_ego_frame, rectangle_mass
from jaxfrenet.trajectories import Held, RowPoints, Rows, Track, multiply_out

HALF = 0.5 * jf.BMW_320I.length, 0.5 * jf.BMW_320I.width
mass = jax.jit(lambda gaussian: rectangle_mass(gaussian, *HALF))


def scipy_mass(mean, covariance, half=HALF) -> float:
    """Inclusion and exclusion of scipy's cumulative distribution at the four corners."""
    total = 0.0
    for a, b in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        corner = np.array([a * half[0], b * half[1]])
        total += a * b * multivariate_normal.cdf(corner, mean, covariance, abseps=1e-9, releps=1e-9)
    return total


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def check_pose(x, y, heading, sigma_x, sigma_y, correlation):
    mixed = correlation * sigma_x * sigma_y
    covariance = np.array([[sigma_x**2, mixed], [mixed, sigma_y**2]])
    turn = rotation(heading).T
    mean = np.array([1.0, -2.0])
    expected = scipy_mass(turn @ (mean - [x, y]), turn @ covariance @ turn.T)
    cos, sin = jnp.float32(np.cos(heading)), jnp.float32(np.sin(heading))
    gaussian = jnp.asarray(mean, jnp.float32), jnp.asarray(covariance, jnp.float32)
    seen = in_ego_frame(jnp.float32(x), jnp.float32(y), cos, sin, *gaussian)
    assert abs(float(mass(seen)) - expected) < 1e-4


sigma = st.floats(0.1, 5.0)


@settings(max_examples=300, deadline=None)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-np.pi, np.pi), sigma, sigma, st.floats(-0.99, 0.99))
def test_mass_agrees_with_scipy(x, y, heading, sigma_x, sigma_y, correlation):
    check_pose(x, y, heading, sigma_x, sigma_y, correlation)


@pytest.mark.parametrize("sigma_x, sigma_y", [(0.1, 0.1), (5.0, 5.0), (0.1, 5.0), (5.0, 0.1)])
@pytest.mark.parametrize("correlation", [-0.99, 0.0, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("heading", [0.0, np.pi / 4, 2.5])
def test_mass_of_tiny_large_and_correlated_covariances(sigma_x, sigma_y, correlation, heading):
    check_pose(2.5, -2.3, heading, sigma_x, sigma_y, correlation)


@pytest.mark.parametrize(("highest", "rule"), CORRELATION_CLASSES)
def test_each_class_of_correlation_is_accurate_up_to_its_end(highest, rule):
    highest = min(highest, 0.9999)
    rng = np.random.default_rng(1)
    compiled = jax.jit(lambda gaussian: rectangle_mass(gaussian, *HALF, rule))
    for _ in range(60):
        mean, sigmas = rng.normal(0, 2, 2), np.exp(rng.uniform(-2, 1.5, 2))
        correlation = np.sign(rng.normal()) * highest
        mixed = correlation * sigmas[0] * sigmas[1]
        expected = scipy_mass(mean, [[sigmas[0] ** 2, mixed], [mixed, sigmas[1] ** 2]])
        gaussian = Gaussian(*(jnp.float32(value) for value in (*mean, *sigmas, correlation)))
        assert abs(float(compiled(gaussian)) - expected) < 3e-5


def test_small_masses_are_accurate_relative_to_their_size():
    """Far tails of uncorrelated Gaussians against scipy's, down to 1e-30: a cost is a thousand times such a mass."""
    z = np.linspace(0.0, 11.0, 45)
    got = jax.jit(lambda x: rectangle_mass(Gaussian(x, 0 * x, 0 * x + 1, 0 * x + 1e-3, 0 * x), 0.5, 1.0))(single(z))
    expected = norm.sf(z - 0.5) - norm.sf(z + 0.5)
    np.testing.assert_allclose(got, expected, rtol=2e-5)
    assert expected[-1] < 1e-25


def test_mass_of_extreme_inputs_is_a_probability():
    for values in (
        (0, 0, 1e-6, 1e-6, 0),
        (1e4, 1e4, 1, 1, 0.5),
        (0, 0, 1e3, 1e-3, 0.99999),
        (0, 0, 1, 1, 1),
        (3, 3, 1, 1, -1),
    ):
        got = float(mass(Gaussian(*(jnp.float32(value) for value in values))))
        assert 0.0 <= got <= 1.0


def single(value) -> jax.Array:
    return jnp.asarray(value, jnp.float32)


def random_rows(rng, config) -> Rows:
    """Rows anywhere that point anywhere; offsets and headings are lines in the shift, headings hold others' values."""
    rows = config.trajectories // (config.samples_per_axis + 1)
    shape = config.points, rows

    def uniform(low: float, high: float) -> jax.Array:
        return single(rng.uniform(low, high, shape))

    angle, held_angle = rng.uniform(-np.pi, np.pi, (2, *shape))
    held = Held(
        single(np.cos(held_angle)),
        single(np.sin(held_angle)),
        *(uniform(*limits) for limits in ((-0.05, 0.05), (-1, 1), (0, 1), (-1, 1), (-0.5, 0.5))),
    )
    track = Track(
        uniform(-15, 15),
        uniform(-15, 15),
        single(np.cos(angle)),
        single(np.sin(angle)),
        uniform(-3, 3),
        uniform(-1, 1),
        held,
    )
    rest = [jnp.zeros(shape)] * 10
    offsets = single(np.sort(rng.uniform(-3.5, 3.5, config.samples_per_axis + 1)))
    one = jnp.ones(rows)
    jerk = jnp.zeros((len(offsets), rows))
    return Rows(RowPoints(track, *rest), offsets, offsets, one > 0, one.astype(jnp.int32), one, jerk, one)


def random_prediction(rng, config, obstacles) -> jf.Prediction:
    """Obstacles scattered in the same place with arbitrary covariances, some entries not valid."""
    shape = obstacles, config.horizon_steps
    root = rng.normal(0, 0.8, (*shape, 2, 2))
    return jf.Prediction(
        mean=single(rng.uniform(-15, 15, (*shape, 2))),
        covariance=single(root @ np.swapaxes(root, -1, -2) + 0.02 * np.eye(2)),
        heading=single(rng.uniform(-np.pi, np.pi, shape)),
        speed=jnp.zeros(shape),
        valid=jnp.asarray(rng.random(shape) < 0.8),
        length=jnp.full(obstacles, 5.0),
        width=jnp.full(obstacles, 2.0),
    )


def plain_cost(config, bundle, prediction, trajectory) -> float:
    """The definition, one pair and one point at a time, in float64."""
    total = 0.0
    pose, ahead = bundle.pose, config.vehicle.rear_axle_to_center
    for obstacle, step in np.argwhere(np.asarray(prediction.valid)):
        x, y, cos, sin = (float(value[trajectory, step + 1]) for value in (pose.x, pose.y, pose.cos, pose.sin))
        ego = np.array([x + ahead * cos, y + ahead * sin])
        turn = np.array([[cos, sin], [-sin, cos]])
        covariance = turn @ np.float64(prediction.covariance[obstacle, step]) @ turn.T
        center = np.float64(prediction.mean[obstacle, step])
        body = rotation(float(prediction.heading[obstacle, step]))
        size = 0.5 * np.array([prediction.length[obstacle], prediction.width[obstacle]], np.float64)
        corners = [center + body @ (np.array(sign) * size) for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        for weight, place in [(1.0, center)] + [(0.5, corner) for corner in corners]:
            total += weight * scipy_mass(turn @ (place - ego), covariance)
    return 1000.0 * total


cost_of = jax.jit(collision_probability_cost, static_argnums=0)


def test_cost_is_the_definition_for_every_pair():
    config, rng = jf.PlannerConfig(sampling_level=0), np.random.default_rng(3)
    rows, prediction = random_rows(rng, config), random_prediction(rng, config, obstacles=4)
    cost, bundle = cost_of(config, rows, prediction).reshape(-1), multiply_out(rows).flat()
    for trajectory in (0, 17, 47):
        expected = plain_cost(config, bundle, prediction, trajectory)
        assert expected > 1.0
        assert float(cost[trajectory]) == pytest.approx(expected, rel=1e-3, abs=1e-2)


def test_cost_fills_the_queue_more_than_once_and_stays_the_same_in_a_batch():
    config, rng = jf.PlannerConfig(sampling_level=1), np.random.default_rng(4)
    cases = [(random_rows(rng, config), random_prediction(rng, config, obstacles=12)) for _ in range(2)]
    tiles = 12 * config.horizon_steps * (config.samples_per_axis + 1)
    assert tiles > 4 * FEWEST_AT_ONCE
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *cases)
    batched = jax.vmap(lambda rows, prediction: cost_of(config, rows, prediction))(*together)
    for i, case in enumerate(cases):
        np.testing.assert_allclose(batched[i], cost_of(config, *case), rtol=1e-5)
