"""Rectangle masses against scipy, and the planner's cost against a plain double loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

import jaxfrenet as jf
from jaxfrenet.collision_probability import (
    CORRELATION_CLASSES,
    Gaussian,
    collision_probability_cost,
    in_ego_frame,
    rectangle_mass,
)

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


@pytest.mark.parametrize("correlation_class", CORRELATION_CLASSES)
def test_each_class_of_correlation_is_accurate_up_to_its_end(correlation_class):
    highest, nodes, steep = correlation_class
    highest = min(highest, 0.9999)
    rng = np.random.default_rng(1)
    for _ in range(60):
        mean, sigmas = rng.normal(0, 2, 2), np.exp(rng.uniform(-2, 1.5, 2))
        correlation = np.sign(rng.normal()) * highest
        mixed = correlation * sigmas[0] * sigmas[1]
        expected = scipy_mass(mean, [[sigmas[0] ** 2, mixed], [mixed, sigmas[1] ** 2]])
        gaussian = Gaussian(*(jnp.float32(value) for value in (*mean, *sigmas, correlation)))
        assert abs(float(rectangle_mass(gaussian, *HALF, nodes, steep)) - expected) < 1e-4


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


def random_bundle(rng, config, obstacles):
    """Poses scattered around obstacles with arbitrary covariances, some entries not valid."""
    steps = config.horizon_steps
    heading = rng.uniform(-np.pi, np.pi, (config.trajectories, config.points))
    poses = rng.uniform(-15, 15, (2, config.trajectories, config.points))
    root = rng.normal(0, 0.8, (obstacles, steps, 2, 2))
    covariance = root @ np.swapaxes(root, -1, -2) + 0.02 * np.eye(2)
    prediction = jf.Prediction(
        mean=jnp.asarray(rng.uniform(-15, 15, (obstacles, steps, 2)), jnp.float32),
        covariance=jnp.asarray(covariance, jnp.float32),
        heading=jnp.asarray(rng.uniform(-np.pi, np.pi, (obstacles, steps)), jnp.float32),
        speed=jnp.zeros((obstacles, steps)),
        valid=jnp.asarray(rng.random((obstacles, steps)) < 0.8),
        length=jnp.full(obstacles, 5.0),
        width=jnp.full(obstacles, 2.0),
    )
    return [jnp.asarray(value, jnp.float32) for value in (*poses, np.cos(heading), np.sin(heading))], prediction


def plain_cost(pose, prediction, trajectory) -> float:
    """The definition, one pair and one point at a time, in float64."""
    total = 0.0
    for obstacle in range(prediction.valid.shape[0]):
        for point in range(1, pose[0].shape[1]):
            if not prediction.valid[obstacle, point - 1]:
                continue
            x, y, cos, sin = (float(value[trajectory, point]) for value in pose)
            turn = np.array([[cos, sin], [-sin, cos]])
            covariance = turn @ np.float64(prediction.covariance[obstacle, point - 1]) @ turn.T
            center = np.float64(prediction.mean[obstacle, point - 1])
            body = rotation(float(prediction.heading[obstacle, point - 1]))
            size = 0.5 * np.array([prediction.length[obstacle], prediction.width[obstacle]], np.float64)
            corners = [center + body @ (np.array(sign) * size) for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            for weight, place in [(1.0, center)] + [(0.5, corner) for corner in corners]:
                total += weight * scipy_mass(turn @ (place - np.array([x, y])), covariance)
    return 1000.0 * total


def test_cost_is_the_definition_for_every_pair():
    config = jf.PlannerConfig(sampling_level=0)
    pose, prediction = random_bundle(np.random.default_rng(3), config, obstacles=4)
    cost = jax.jit(collision_probability_cost, static_argnums=0)(config, *pose, prediction)
    for trajectory in (0, 17, 47):
        assert float(cost[trajectory]) == pytest.approx(plain_cost(pose, prediction, trajectory), rel=1e-3, abs=1e-2)


def test_cost_needs_more_than_one_chunk_and_stays_the_same_in_a_batch():
    config = jf.PlannerConfig(sampling_level=1)
    rng = np.random.default_rng(4)
    cases = [random_bundle(rng, config, obstacles=12) for _ in range(2)]
    poses = [jnp.stack(values) for values in zip(*(case[0] for case in cases), strict=True)]
    predictions = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(case[1] for case in cases))
    single = jax.jit(collision_probability_cost, static_argnums=0)
    batched = jax.vmap(lambda *pose_and_prediction: single(config, *pose_and_prediction))(*poses, predictions)
    for i, (pose, prediction) in enumerate(cases):
        np.testing.assert_allclose(batched[i], single(config, *pose, prediction), rtol=1e-5)
