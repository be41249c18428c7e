"""Driving lines against circles, quadrature by scipy and finite differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from scenarios import lines
from scenarios.lines import Line


def circle(radius: float, length: float = 20.0, nodes: int = 41) -> Line:
    """A left-hand circle from the origin eastwards."""
    along = jnp.linspace(0.0, length, nodes)
    return lines.integrated(jnp.zeros(2), along, lambda s: s / radius, jnp.full(nodes, 1.0 / radius), jnp.zeros(nodes))


def clothoid(nodes: int = 61) -> Line:
    """Curvature grows linearly from 0 to 0.12 1/m over 30 m."""
    along = jnp.linspace(0.0, 30.0, nodes)
    return lines.integrated(jnp.zeros(2), along, lambda s: 0.002 * s**2, 0.004 * along, jnp.full(nodes, 0.004))


def test_integration_agrees_with_scipy() -> None:
    line = clothoid()
    for index in (7, 30, 60):
        end = float(line.arc_length[index])
        assert float(line.x[index]) == pytest.approx(quad(lambda s: np.cos(0.002 * s**2), 0.0, end)[0], abs=2e-5)
        assert float(line.y[index]) == pytest.approx(quad(lambda s: np.sin(0.002 * s**2), 0.0, end)[0], abs=2e-5)


def test_look_up_is_on_the_circle_and_goes_on_straight_beyond_its_ends() -> None:
    at = lines.look_up(circle(8.0), jnp.asarray([3.21, 11.07, -2.0, 25.0]))
    np.testing.assert_allclose(np.hypot(at.x[:2], at.y[:2] - 8.0), 8.0, atol=1e-5)
    np.testing.assert_allclose(at.heading, [3.21 / 8.0, 11.07 / 8.0, 0.0, 20.0 / 8.0], atol=1e-6)
    np.testing.assert_allclose(at.curvature, [0.125, 0.125, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose([at.x[2], at.y[2]], [-2.0, 0.0], atol=1e-6)
    end = 8.0 * np.sin(2.5) + 5.0 * np.cos(2.5), 8.0 - 8.0 * np.cos(2.5) + 5.0 * np.sin(2.5)
    np.testing.assert_allclose([at.x[3], at.y[3]], end, atol=1e-5)


@pytest.mark.parametrize("offset", [-2.0, 3.0])
def test_a_parallel_of_a_circle_is_a_circle(offset: float) -> None:
    line = lines.parallel(circle(8.0), offset)
    np.testing.assert_allclose(np.hypot(line.x, line.y - 8.0), 8.0 - offset, atol=1e-5)
    np.testing.assert_allclose(line.arc_length, np.linspace(0.0, 20.0, 41) * (8.0 - offset) / 8.0, atol=1e-5)
    np.testing.assert_allclose(line.curvature, 1.0 / (8.0 - offset), rtol=1e-6)


def test_a_line_reversed_twice_is_itself() -> None:
    line = clothoid()
    back = lines.reversed_line(line)
    assert float(back.curvature[0]) == pytest.approx(-0.12)
    np.testing.assert_allclose(np.cos(back.heading[0] - line.heading[-1]), -1.0, atol=1e-6)
    again = lines.reversed_line(back)
    np.testing.assert_allclose(again.points, line.points, atol=1e-6)
    np.testing.assert_allclose(again.heading - 2.0 * np.pi, line.heading, atol=1e-5)


def test_joined_lines_have_continuous_headings_and_arc_lengths() -> None:
    first = circle(8.0)
    second = lines.moved(circle(-8.0), jnp.zeros(2), first.heading[-1] - 2.0 * jnp.pi)
    both = lines.joined(first, second)
    assert both.x.shape == (81,)
    assert (np.diff(both.arc_length) > 0.0).all()
    assert np.abs(np.diff(both.heading)).max() < 0.1
    assert float(both.arc_length[-1]) == pytest.approx(40.0)


def test_moved_lines_turn_about_the_new_origin() -> None:
    line = lines.moved(circle(8.0), jnp.asarray([1.0, 2.0]), jnp.float32(0.5 * np.pi))
    np.testing.assert_allclose([line.x[0], line.y[0]], [2.0, -1.0], atol=1e-6)
    assert float(line.heading[0]) == pytest.approx(0.5 * np.pi)


def test_an_offset_that_changes_along_the_base_has_the_curvature_of_its_points() -> None:
    base = clothoid(241)
    step, slope, second = lines.smooth_step((base.arc_length - 4.0) / 20.0)
    line = lines.offset_by(base, 3.0 * step, 3.0 * slope / 20.0, 3.0 * second / 400.0)
    x, y, along = (np.asarray(leaf, float) for leaf in (line.x, line.y, line.arc_length))
    np.testing.assert_allclose(np.hypot(np.diff(x), np.diff(y)), np.diff(along), atol=1e-4)
    heading = np.unwrap(np.arctan2(np.gradient(y, along), np.gradient(x, along)))
    np.testing.assert_allclose(heading[2:-2], line.heading[2:-2], atol=1e-3)
    np.testing.assert_allclose(np.gradient(heading, along)[4:-4], line.curvature[4:-4], atol=3e-3)
    np.testing.assert_allclose(
        np.gradient(np.asarray(line.curvature), along)[3:-3], line.curvature_derivative[3:-3], atol=1e-3
    )


def test_the_quintic_step_has_the_derivatives_it_tells() -> None:
    share = jnp.linspace(0.01, 0.99, 25)
    _, slope, second = lines.smooth_step(share)
    np.testing.assert_allclose(jax.vmap(jax.grad(lambda t: lines.smooth_step(t)[0]))(share), slope, atol=1e-5)
    np.testing.assert_allclose(jax.vmap(jax.grad(lambda t: lines.smooth_step(t)[1]))(share), second, atol=1e-4)
