"""Shape functions and jerk integrals against numpy's polynomials, solved and integrated in float64."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from jaxfrenet.polynomials import offset_shapes, quartic_jerk, quintic_jerk, speed_shapes


def quartic(duration, speed, acceleration, end_speed) -> Polynomial:
    """s(t) with s(0) = 0, solved from its boundary conditions."""
    rows = np.array([[3 * duration**2, 4 * duration**3], [6 * duration, 12 * duration**2]])
    cubic = np.linalg.solve(rows, [end_speed - speed - acceleration * duration, -acceleration])
    return Polynomial([0.0, speed, acceleration / 2, *cubic])


def quintic(span, offset, slope, bend, end) -> Polynomial:
    powers = np.arange(6)
    rows, right = [], [offset, slope, bend, end, 0.0, 0.0]
    for z, order in ((0, 0), (0, 1), (0, 2), (span, 0), (span, 1), (span, 2)):
        rows.append([Polynomial.basis(k).deriv(order)(z) if order else float(z) ** k for k in powers])
    return Polynomial(np.linalg.solve(np.array(rows), right))


@pytest.mark.parametrize("duration, speed, acceleration, end_speed", [(1.1, 5, -2, 9), (3, 12, 1, 0.001), (2, 0, 0, 4)])
def test_quartic(duration, speed, acceleration, end_speed):
    exact = quartic(duration, speed, acceleration, end_speed)
    t = np.linspace(0, duration, 13)
    weights = np.array([speed, acceleration * duration, end_speed])
    distance, rate, push = (np.tensordot(weights, np.array(shape), 1) for shape in speed_shapes(t / duration))
    np.testing.assert_allclose(distance * duration, exact(t), atol=1e-9)
    np.testing.assert_allclose(rate, exact.deriv()(t), atol=1e-9)
    np.testing.assert_allclose(push / duration, exact.deriv(2)(t), atol=1e-9)
    squared = (exact.deriv(3) ** 2).integ()
    jerk = quartic_jerk(*(jnp.float32(value) for value in (duration, speed, acceleration, end_speed)))
    np.testing.assert_allclose(jerk, np.sqrt(squared(duration) - squared(0)), rtol=1e-5)


@pytest.mark.parametrize(
    "span, offset, slope, bend, end", [(1.1, 0.2, -1, 0.5, 3.5), (24, -2, 0.1, -0.02, 0), (3, 1, 0, 0, 1)]
)
def test_quintic(span, offset, slope, bend, end):
    exact = quintic(span, offset, slope, bend, end)
    z = np.linspace(0, span, 13)
    weights = np.array([slope * span, bend * span**2, end - offset])
    value, first, second = (np.tensordot(weights, np.array(shape), 1) for shape in offset_shapes(z / span))
    np.testing.assert_allclose(offset + value, exact(z), atol=1e-9)
    np.testing.assert_allclose(first / span, exact.deriv()(z), atol=1e-9)
    np.testing.assert_allclose(second / span**2, exact.deriv(2)(z), atol=1e-9)
    squared = (exact.deriv(3) ** 2).integ()
    jerk = quintic_jerk(*(jnp.float32(value) for value in (span, slope, bend, end - offset)))
    np.testing.assert_allclose(jerk, np.sqrt(abs(squared(span) - squared(0))), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("span", [0.0, 1e-12, 1e-6, 1e-4])
def test_jerk_over_hardly_any_span_is_finite(span):
    shift = jnp.asarray([0.0, 1e-6, 3.5])
    jerk = quintic_jerk(jnp.float32(span), jnp.float32(0.3), jnp.float32(-0.2), shift)
    assert np.all(np.isfinite(np.square(jerk)))
