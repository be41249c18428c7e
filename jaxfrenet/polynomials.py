"""Jerk-optimal polynomials (Werling et al. 2010) as blends of shape functions of the normalised argument.

Each shape function is written in factors that vanish at the ends, so that no cancellation occurs in float32, where
power sums of coefficients would lose the small derivatives near a polynomial's end.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxfrenet._typing import Array, Float

SHORTEST_SPAN = 1e-5
"""Below this span [s, or m] the jerk of a quintic would leave float32's range."""


def speed_shapes(tau: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """Shape functions of the quartic that ends at a given speed without acceleration.

    With `T` the duration and `tau = t/T`, weights `(v0, a0·T, v1)` give: travelled distance / T, speed,
    acceleration · T. Returns these three triples; any array type and shape.
    """
    rest = 1.0 - tau
    distance = (tau - tau**3 + tau**4 / 2, tau**2 / 2 - 2 * tau**3 / 3 + tau**4 / 4, tau**3 - tau**4 / 2)
    speed = (rest**2 * (1 + 2 * tau), tau * rest**2, tau**2 * (3 - 2 * tau))
    acceleration = (-6 * tau * rest, rest * (1 - 3 * tau), 6 * tau * rest)
    return distance, speed, acceleration


def offset_shapes(z: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """Shape functions of the quintic that ends at a given offset, at rest.

    With `Z` the span and `z` the share of it covered, weights `(p0'·Z, p0''·Z², p1 - p0)` give: offset - p0, its first
    derivative · Z and its second · Z². Returns these three triples; any array type and shape.
    """
    rest = 1.0 - z
    value = (z * rest**3 * (1 + 3 * z), z**2 * rest**3 / 2, z**3 * (10 - 15 * z + 6 * z**2))
    first = (rest**2 * (1 - 3 * z) * (1 + 5 * z), z * rest**2 * (2 - 5 * z) / 2, 30 * z**2 * rest**2)
    second = (-12 * z * rest * (3 - 5 * z), rest * (1 - 8 * z + 10 * z**2), 60 * z * rest * (1 - 2 * z))
    return value, first, second


def quartic_jerk(
    duration: Float[Array, "*#shape"],
    speed: Float[Array, "*#shape"],
    acceleration: Float[Array, "*#shape"],
    end_speed: Float[Array, "*#shape"],
) -> Float[Array, "*shape"]:
    """√(∫₀ᵀ s⃛² dt) [m/s^2.5] of the quartic from `speed`, `acceleration` to `end_speed` within `duration`.

    The jerk is linear in time, from j₀ to j₁: the integral is T·(j₀² + j₀j₁ + j₁²)/3, written as a sum of squares.
    """
    slope = (end_speed - speed) / duration**2
    first = 6 * slope - 4 * acceleration / duration
    last = -6 * slope + 2 * acceleration / duration
    return jnp.sqrt(duration / 3 * ((first + last / 2) ** 2 + 0.75 * last**2))


def quintic_jerk(
    span: Float[Array, "*#shape"],
    slope: Float[Array, "*#shape"],
    bend: Float[Array, "*#shape"],
    shift: Float[Array, "*#shape"],
) -> Float[Array, "*shape"]:
    """√(∫₀ᶻ p⃛² dz) of the quintic with p′(0) = `slope`, p″(0) = `bend`, that moves by `shift` over `span`, to rest.

    [m/s^2.5] over time, [m^-1.5] over arc length. The third derivative is quadratic; in Legendre polynomials, which
    are orthogonal, the integral is a sum of squares. Spans below `SHORTEST_SPAN` count as that long.
    """
    span = jnp.maximum(span, SHORTEST_SPAN)
    slope, bend = slope * span, bend * span**2
    missing = shift - slope - bend / 2
    cubic = 10 * missing + 4 * (slope + bend) - bend / 2
    quartic = -15 * missing - 7 * (slope + bend) + bend
    quintic = 6 * missing + 3 * (slope + bend) - bend / 2
    mean = 6 * cubic + 12 * quartic + 20 * quintic
    linear = 12 * quartic + 30 * quintic
    square = 10 * quintic
    return jnp.sqrt((mean**2 + linear**2 / 3 + square**2 / 5) / span**5)
