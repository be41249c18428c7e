"""Exact overlap tests for oriented boxes and line segments, and the box that a moving box sweeps.

All tests are separating-axis tests (Gottschalk et al. 1996) and broadcast over leading axes.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float

SMALLEST_MARGIN = 2e-5
"""Boxes that are nearer than this [m] count as touching, wherever they are."""
MARGIN_PER_METER = 5e-7
"""What is added to it per metre from the origin: a few roundings of a float32 coordinate."""


@pytree_dataclass
class Box:
    """Oriented boxes; the fields broadcast against each other."""

    x: Float[Array, "*#shape"]
    """Centre, m."""
    y: Float[Array, "*#shape"]
    cos: Float[Array, "*#shape"]
    """Direction of the long side as a unit vector."""
    sin: Float[Array, "*#shape"]
    half_length: Float[Array, "*#shape"]
    """m."""
    half_width: Float[Array, "*#shape"]

    @classmethod
    def from_heading(cls, x: Array, y: Array, heading: Array, length: Array, width: Array) -> Box:
        """Boxes with centre `x`, `y` [m], `heading` [rad], `length` and `width` [m]."""
        return cls(x, y, jnp.cos(heading), jnp.sin(heading), 0.5 * length, 0.5 * width)

    def expand_dims(self, axis: int) -> Box:
        """The same boxes with one more axis of size 1."""
        return Box(*(jnp.expand_dims(field, axis) for field in vars(self).values()))


def contact_margin(x: Float[Array, "*shape"], y: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Distance [m] below which things at `x`, `y` [m] count as touching, so that rounding never hides a collision."""
    return SMALLEST_MARGIN + MARGIN_PER_METER * (jnp.abs(x) + jnp.abs(y))


def boxes_overlap(a: Box, b: Box) -> Bool[Array, "*shape"]:
    """Whether boxes `a` and `b` overlap or touch; broadcast over their shapes."""
    dx, dy = b.x - a.x, b.y - a.y
    margin = contact_margin(a.x, a.y)
    cos = jnp.abs(a.cos * b.cos + a.sin * b.sin)
    sin = jnp.abs(a.cos * b.sin - a.sin * b.cos)

    def meets(first: Box, second: Box) -> Array:
        along = jnp.abs(dx * first.cos + dy * first.sin)
        across = jnp.abs(dy * first.cos - dx * first.sin)
        reach_along = first.half_length + second.half_length * cos + second.half_width * sin
        reach_across = first.half_width + second.half_length * sin + second.half_width * cos
        return (along <= reach_along + margin) & (across <= reach_across + margin)

    return meets(a, b) & meets(b, a)


def box_meets_segment(box: Box, start: Float[Array, "*#shape 2"], end: Float[Array, "*#shape 2"]) -> Array:
    """Whether boxes meet the line segments from `start` to `end` [m]; broadcast, boolean."""
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    dx, dy = middle[..., 0] - box.x, middle[..., 1] - box.y
    x, y = dx * box.cos + dy * box.sin, dy * box.cos - dx * box.sin
    hx, hy = half[..., 0] * box.cos + half[..., 1] * box.sin, half[..., 1] * box.cos - half[..., 0] * box.sin
    margin = contact_margin(box.x, box.y)
    length, width = box.half_length + margin, box.half_width + margin
    inside = (jnp.abs(x) <= length + jnp.abs(hx)) & (jnp.abs(y) <= width + jnp.abs(hy))
    return inside & (jnp.abs(x * hy - y * hx) <= length * jnp.abs(hy) + width * jnp.abs(hx))


def swept_box(before: Box, after: Box) -> Box:
    """The oriented hull of two boxes of equal size: the smallest box along their mean direction that contains both.

    The mean direction is the bisector of the two, as in the OBB sum of the CommonRoad drivability checker (Pek et al.
    2020). Boxes that point in opposite directions have none; their hull follows the first.
    """
    cos, sin = before.cos + after.cos, before.sin + after.sin
    norm = jnp.sqrt(cos**2 + sin**2)
    opposite = norm < 1e-3
    norm = jnp.where(opposite, 1.0, norm)
    cos = jnp.where(opposite, before.cos, cos / norm)
    sin = jnp.where(opposite, before.sin, sin / norm)
    turn_cos = jnp.abs(cos * before.cos + sin * before.sin)
    turn_sin = jnp.abs(cos * before.sin - sin * before.cos)
    half_length = before.half_length * turn_cos + before.half_width * turn_sin
    half_width = before.half_length * turn_sin + before.half_width * turn_cos
    dx, dy = 0.5 * (after.x - before.x), 0.5 * (after.y - before.y)
    return Box(
        before.x + dx,
        before.y + dy,
        cos,
        sin,
        half_length + jnp.abs(dx * cos + dy * sin),
        half_width + jnp.abs(dy * cos - dx * sin),
    )
