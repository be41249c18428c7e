"""The cost terms that the recorded cases do not hold, against plain float64 sums over the bundle's points."""

import dataclasses
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import simpson

import jaxfrenet as jf

NAMES = tuple(jf.COST_TERMS)


@pytest.fixture(scope="module")
def cycle(config, world, thing):
    scenario = world([thing(45.0, 2.0, speed=6.0), thing(30.0, -3.0, static=True)], heading=0.1, yaw_rate=0.1)
    known: dict[str, Any] = dict.fromkeys(NAMES, 1.0)
    every = jf.CostWeights(**known)
    assert every.names() == NAMES
    return jax.tree.map(np.asarray, jax.jit(partial(jf.plan, config))(scenario, jf.reset(config, scenario), every))


def term(cycle: jf.PlanningCycle, name: str) -> np.ndarray:
    return np.asarray(cycle.costs)[:, NAMES.index(name)]


def over_time(values: np.ndarray) -> np.ndarray:
    return np.asarray(simpson(values.astype(float), dx=0.1, axis=1))


def test_all_terms_are_finite_and_not_negative(cycle):
    assert np.isfinite(cycle.costs).all()
    assert (cycle.costs >= 0).all()
    assert (cycle.costs.max(axis=0) > 0).all()


@pytest.mark.parametrize(
    ("name", "integrand"),
    [
        ("acceleration", lambda m: m.acceleration**2),
        ("velocity", lambda m: m.speed**2),
        ("path_length", lambda m: m.speed),
        ("lateral_velocity", lambda m: (m.offset_slope * m.arc_length_rate) ** 2),
        ("steering_angle", lambda m: np.arctan(jf.BMW_320I.wheelbase * m.curvature) ** 2),
        ("yaw_rate", lambda m: (m.curvature * m.speed) ** 2),
    ],
)
def test_integrals(cycle, name, integrand):
    np.testing.assert_allclose(term(cycle, name), over_time(integrand(cycle.bundle.motion)), rtol=2e-3, atol=1e-5)


def test_steering_rate(cycle):
    """The sum of squared differences; the last of an even number of values counts less, see the term."""
    angle = np.arctan(jf.BMW_320I.wheelbase * cycle.bundle.motion.curvature.astype(float))
    rate = np.diff(angle, axis=1) / 0.1
    expected = over_time(rate[:, :-1] ** 2) + (rate[:, -2] ** 2 + rate[:, -1] ** 2) / 2 * 0.1 / 3
    np.testing.assert_allclose(term(cycle, "steering_rate"), expected, rtol=2e-3, atol=1e-4)


def test_path_length_is_the_length_of_the_polyline(cycle):
    """Holds for the rear axle's points themselves, within the curvature of the path between them."""
    motion = cycle.bundle.motion
    feasible = cycle.feasibility.feasible
    polyline = np.hypot(np.diff(motion.x, axis=1), np.diff(motion.y, axis=1)).sum(axis=1)
    np.testing.assert_allclose(term(cycle, "path_length")[feasible], polyline[feasible], rtol=2e-3)


def test_distance_to_obstacles(cycle):
    motion, prediction = cycle.bundle.motion, cycle.prediction
    away = [np.hypot(motion.x[:, 1:] - m[:, 0], motion.y[:, 1:] - m[:, 1]) for m in prediction.mean]
    expected = sum((np.where(v, 1 / d**2, 0)).sum(axis=1) for d, v in zip(away, prediction.valid, strict=True))
    np.testing.assert_allclose(term(cycle, "distance_to_obstacles"), expected, rtol=1e-3)


def test_lane_center_offset_takes_the_nearest_lane(cycle):
    """The test road has a lane on the path and one 3.5 m to its left."""
    offset = cycle.bundle.motion.offset.astype(float)
    nearest = np.minimum(np.abs(offset), np.abs(offset - 3.5))
    np.testing.assert_allclose(term(cycle, "lane_center_offset"), np.linalg.norm(nearest, axis=1), rtol=1e-3, atol=1e-4)


def test_weights_rank_the_sum(cycle):
    np.testing.assert_allclose(cycle.cost, cycle.costs.sum(axis=1), rtol=1e-4)


def test_default_weights_are_the_papers_default_planner():
    assert jf.CostWeights().names() == NAMES[:5]
    assert np.asarray(jf.CostWeights().values()).tolist() == [1.0, 1.0, 1.0, 1.0, 200.0]
    assert [field.name for field in dataclasses.fields(jf.CostWeights)] == [*NAMES, "extra"]
