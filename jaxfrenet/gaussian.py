"""The mass that a bivariate Gaussian has inside an axis-parallel rectangle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float

LARGEST_CORRELATION = 0.999999
"""Correlations are clipped to ± this; beyond it the Gaussian is a line within float32."""


@pytree_dataclass
class Gaussian:
    """Bivariate Gaussians in the ego's frame, relative to its box's centre; fields broadcast."""

    x: Float[Array, "*#shape"]
    """Mean along the ego's heading, m."""
    y: Float[Array, "*#shape"]
    sigma_x: Float[Array, "*#shape"]
    """Standard deviation along the ego's heading, m."""
    sigma_y: Float[Array, "*#shape"]
    correlation: Float[Array, "*#shape"]


@dataclass(frozen=True)
class Series:
    """The correlation's part of a mass as a power series in it (the tetrachoric series, Pearson 1900).

    Needs no further exponential function. Below 1e-7 are the errors of 6 terms up to |correlation| 0.1, of 11 up to
    0.3, and of 20 up to 0.6.
    """

    terms: int

    def __call__(self, x: _Interval, y: _Interval, correlation: Array) -> Array:
        """Σ rⁿ/n! (uₙ₋₁(x₁) - uₙ₋₁(x₀)) (uₙ₋₁(y₁) - uₙ₋₁(y₀)), with uₙ(z) = Heₙ(z) times the density at z."""
        edges = jnp.asarray(x.low), jnp.asarray(x.high), jnp.asarray(y.low), jnp.asarray(y.high)
        before, now = [jnp.zeros_like(edge) for edge in edges], [x.low_bell, x.high_bell, y.low_bell, y.high_bell]
        power = correlation * np.float32(0.5 / np.pi)
        total = power * (now[1] - now[0]) * (now[3] - now[2])
        for n in range(1, self.terms):
            following = [edge * u - (n - 1) * v for edge, u, v in zip(edges, now, before, strict=True)]
            before, now = now, following
            power = power * correlation * np.float32(1.0 / (n + 1))
            total = total + power * (now[1] - now[0]) * (now[3] - now[2])
        return total


@dataclass(frozen=True)
class Quadrature:
    """The correlation's part of a mass by Plackett's identity, with Gauss-Legendre quadrature.

    That is the integral over the correlation, from 0 to its value, of the density at the four corners (Plackett 1954;
    Drezner and Wesolowsky 1990). The error is 1e-6 with 8 nodes up to |correlation| 0.9. Beyond, `steep` crowds 16
    nodes towards the end, where the density rises: 3e-5.
    """

    nodes: int
    steep: bool = False

    def __call__(self, x: _Interval, y: _Interval, correlation: Array) -> Array:
        """The integral; mirrored so that the correlation is positive, as 1 + r would cancel near -1."""
        negative = correlation < 0
        low_y, high_y = jnp.where(negative, -y.high, y.low), jnp.where(negative, -y.low, y.high)
        final = jnp.minimum(jnp.abs(correlation), LARGEST_CORRELATION)
        total = jnp.zeros_like(x.low)
        for r, cos, weight in _steep_nodes(final, self.nodes) if self.steep else _nodes(final, self.nodes):
            per_difference, per_product = -0.5 / cos**2, -1.0 / (1.0 + r)

            def density(h: Array, k: Array, a: Array = per_difference, b: Array = per_product) -> Array:
                return jnp.exp(a * (h - k) ** 2 + b * h * k)

            same = density(x.high, high_y) + density(x.low, low_y)
            opposite = density(x.low, high_y) + density(x.high, low_y)
            total = total + weight * (same - opposite)
        return total


Rule = Series | Quadrature
"""How the correlation's part of a mass is computed."""
ANY_CORRELATION = Quadrature(16, steep=True)
"""What serves for every correlation."""


@partial(jax.jit, static_argnums=(1, 2, 3))
def rectangle_mass(
    gaussian: Gaussian, half_length: float, half_width: float, rule: Rule = ANY_CORRELATION
) -> Float[Array, "*shape"]:
    """Probability mass inside the box ± half_length, ± half_width [m].

    The mass without correlation, a product of two intervals, plus what the correlation adds, by some rule.
    """
    x = _interval(gaussian.x, gaussian.sigma_x, half_length)
    y = _interval(gaussian.y, gaussian.sigma_y, half_width)
    return jnp.clip(x.mass * y.mass + rule(x, y, gaussian.correlation), 0.0, 1.0)


def _nodes(final: Array, nodes: int) -> Iterator[tuple[Array, Array, Array]]:
    """Correlations r, √(1 - r²) and weights of the quadrature over r from 0 to `final`: no trigonometry."""
    for x, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
        r = final * np.float32((1 + x) / 2)
        cos = jnp.sqrt(1.0 - r**2)
        yield r, cos, final * np.float32(weight / (4 * np.pi)) / cos


def _steep_nodes(final: Array, nodes: int) -> Iterator[tuple[Array, Array, Array]]:
    """As `_nodes`, over the angle asin r, with quadratically more nodes towards its end."""
    angle = jnp.arcsin(final)
    for x, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
        rest = (1 - x) / 2
        at = np.float32(1 - rest**2) * angle
        yield jnp.sin(at), jnp.cos(at), np.float32(weight * rest / (2 * np.pi)) * angle


@pytree_dataclass
class _Interval:
    """An interval of a standard normal variable."""

    low: Array
    high: Array
    low_bell: Array
    """exp(-z²/2) at its lower end."""
    high_bell: Array
    mass: Array


def _interval(mean: Array, sigma: Array, half: float) -> _Interval:
    """The interval ± half of a normal variable; its mass is accurate in the tails."""
    per_sigma = 1.0 / sigma
    low, high = (-half - mean) * per_sigma, (half - mean) * per_sigma
    low_bell, high_bell = jnp.exp(-0.5 * low**2), jnp.exp(-0.5 * high**2)
    low_tail, high_tail = _tail(low, low_bell), _tail(high, high_bell)
    one_sided = jnp.abs(high_tail - low_tail)
    mass = jnp.where((low < 0) & (high > 0), 1.0 - low_tail - high_tail, one_sided)
    return _Interval(low, high, low_bell, high_bell, mass)


TAIL = (
    0.14361917,
    0.143629354,
    0.124672389,
    0.0919614709,
    0.0133891957,
    0.0805405077,
    -0.193647904,
    0.121730424,
    -0.0258944391,
)
"""Coefficients of t, t², … in the tail of the standard normal distribution over exp(-z²/2), t = 1 / (1 + 0.36 |z|):
fitted to scipy's erfcx, relative error 3.4e-7 everywhere."""


def _tail(z: Array, bell: Array) -> Array:
    """Mass of a standard normal variable beyond |z|, where `bell` = exp(-z²/2)."""
    t = 1.0 / (1.0 + 0.36 * jnp.abs(z))
    series = jnp.full_like(t, TAIL[-1])
    for coefficient in TAIL[-2::-1]:
        series = series * t + coefficient
    return series * t * bell


def in_ego_frame(
    x: Array, y: Array, cos: Array, sin: Array, mean: Float[Array, "*#shape 2"], covariance: Float[Array, "*#shape 2 2"]
) -> Gaussian:
    """Gaussians seen from boxes centred at `x`, `y` [m] that point along (`cos`, `sin`); broadcast."""
    dx, dy = mean[..., 0] - x, mean[..., 1] - y
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    along = xx * cos**2 + 2 * xy * cos * sin + yy * sin**2
    across = xx * sin**2 - 2 * xy * cos * sin + yy * cos**2
    mixed = (yy - xx) * cos * sin + xy * (cos**2 - sin**2)
    sigma_x, sigma_y = jnp.sqrt(jnp.maximum(along, 1e-12)), jnp.sqrt(jnp.maximum(across, 1e-12))
    return Gaussian(dx * cos + dy * sin, dy * cos - dx * sin, sigma_x, sigma_y, mixed / (sigma_x * sigma_y))
