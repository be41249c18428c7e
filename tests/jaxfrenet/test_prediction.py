"""Predictors on tracks whose future is known."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.prediction import constant_velocity, ground_truth


def predicted(config, scenario, step=0, x=20.0, y=0.0) -> jf.Prediction:
    return jf.predict(config, scenario, jnp.int32(step), jnp.float32(x), jnp.float32(y))


@pytest.fixture(params=["constant_velocity", "ground_truth"])
def any_config(request, config):
    return dataclasses.replace(config, predictor=request.param)


def test_a_steady_car_is_predicted_by_both(any_config, world, thing):
    scenario = world([thing(30.0, 2.0, speed=8.0, heading=0.5)])
    got = predicted(any_config, scenario, step=4)
    time = 0.1 * np.arange(5, 35)
    expected = np.stack([30 + 8 * np.cos(0.5) * time, 2 + 8 * np.sin(0.5) * time], axis=-1)
    np.testing.assert_allclose(got.mean[0], expected, atol=1e-3)
    np.testing.assert_allclose(got.heading[0], 0.5, atol=1e-6)
    np.testing.assert_allclose(got.speed[0], 8.0, atol=1e-5)
    assert got.valid[0].all() and not got.valid[1:].any()
    assert float(got.length[0]) == pytest.approx(5.5)
    assert float(got.width[0]) == pytest.approx(2.2)


def test_covariances_are_positive_definite(any_config, world, thing):
    got = predicted(any_config, world([thing(30.0, 2.0, speed=8.0, heading=2.0), thing(40.0, 0.0, static=True)]))
    assert (np.linalg.eigvalsh(np.asarray(got.covariance, float)) > 1e-3).all()


def test_constant_velocity_is_less_certain_ahead_than_aside(config, world, thing):
    config = dataclasses.replace(config, predictor="constant_velocity")
    got = predicted(config, world([thing(30.0, 2.0, speed=8.0, heading=np.pi / 2)]))
    along, across = got.covariance[0, :, 1, 1], got.covariance[0, :, 0, 0]
    assert (np.diff(along) > 0).all() and (along > across).all()
    expected = constant_velocity.INITIAL_VARIANCE + (0.5 * constant_velocity.LONGITUDINAL_ACCELERATION * 9) ** 2
    assert float(along[-1]) == pytest.approx(expected, rel=1e-5)


def test_ground_truth_knows_the_future(config, world, thing):
    scenario = world([thing(30.0, 0.0, speed=5.0, steps=(0, 20))])
    got = predicted(config, scenario, step=10)
    np.testing.assert_array_equal(got.valid[0], np.arange(11, 41) < 20)
    np.testing.assert_allclose(got.covariance[0, 0], ground_truth.VARIANCE * np.eye(2), atol=1e-7)


def test_static_obstacles_stay_with_small_covariance(any_config, world, thing):
    scenario = world([thing(30.0, 2.0, speed=3.0, static=True)])
    for step in (0, 50, 200):
        got = predicted(any_config, scenario, step)
        assert got.valid[0].all()
        np.testing.assert_allclose(got.covariance[0], np.broadcast_to(0.02 * np.eye(2), (30, 2, 2)), atol=1e-7)
    got = predicted(dataclasses.replace(any_config, predictor="constant_velocity"), scenario)
    np.testing.assert_allclose(got.mean[0, -1], [30.0, 2.0], atol=1e-4)


def test_only_what_is_there_and_in_reach_is_predicted(any_config, world, thing):
    scenario = world([thing(99.0, 0.0), thing(101.0, 0.0), thing(50.0, 0.0, steps=(10, 61))])
    assert predicted(any_config, scenario).valid.any(axis=1).tolist() == [True, False, False]
    assert predicted(any_config, scenario, step=10).valid.any(axis=1).tolist() == [True, False, True]
    assert not predicted(any_config, scenario, step=100).valid.any()


def test_first_cuts_and_pads():
    zeros = jnp.zeros((2, 5))
    whole = jf.Prediction(
        mean=jnp.ones((2, 5, 2)),
        covariance=jnp.broadcast_to(jnp.eye(2), (2, 5, 2, 2)),
        heading=zeros,
        speed=zeros,
        valid=zeros == 0,
        length=jnp.ones(2),
        width=jnp.ones(2),
    )
    assert whole.first(3).valid.shape == (2, 3)
    longer = whole.first(8)
    assert longer.valid.sum(axis=1).tolist() == [5, 5]
    np.testing.assert_array_equal(longer.covariance[0, 7], np.eye(2))
