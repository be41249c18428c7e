"""The reference path: tables over arc length, and the Frenet frame that they span.

All look-ups are linear between the nodes. Positions are built as the path's point plus `d` times the left normal
`(-sin θ_r, cos θ_r)` of the interpolated heading (Werling et al. 2010).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._compilation import computed_once
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float


@pytree_dataclass
class ReferencePath:
    """A path as tables over its arc length; padding nodes continue it straight beyond `length`."""

    arc_length: Float[Array, "*batch nodes"]
    """`[nodes]`, m, strictly increasing, the first is usually 0."""
    x: Float[Array, "*batch nodes"]
    """`[nodes]`, m."""
    y: Float[Array, "*batch nodes"]
    """`[nodes]`, m."""
    heading: Float[Array, "*batch nodes"]
    """`[nodes]`, rad, continuous (never wrapped)."""
    curvature: Float[Array, "*batch nodes"]
    """`[nodes]`, 1/m, positive to the left."""
    curvature_derivative: Float[Array, "*batch nodes"]
    """`[nodes]`, 1/m², with respect to arc length."""
    length: Float[Array, "*batch"]
    """`[]`, m, arc length of the last node that is not padding."""


@pytree_dataclass
class PathPoint:
    """The path's frame at some arc lengths; all fields have the shape of those."""

    x: Float[Array, "*shape"]
    y: Float[Array, "*shape"]
    heading: Float[Array, "*shape"]
    curvature: Float[Array, "*shape"]
    curvature_derivative: Float[Array, "*shape"]


@computed_once
def node_before(path: ReferencePath, arc_length: Float[Array, "*shape"]) -> Array:
    """Index of the last node at or before each arc length, such that a node follows it; int32, same shape."""
    index = jnp.searchsorted(path.arc_length, arc_length, side="right", method="scan_unrolled") - 1
    return jnp.clip(index, 0, path.arc_length.shape[-1] - 2)


def look_up(path: ReferencePath, arc_length: Float[Array, "*shape"]) -> PathPoint:
    """The path's frame at `arc_length` [m], linear between nodes; beyond the ends the last segment is prolonged.

    Args:
      path: the path, without a batch axis.
      arc_length: any shape, m.
    """
    tables = jnp.stack([path.x, path.y, path.heading, path.curvature, path.curvature_derivative], axis=-1)
    blended = look_up_columns(path, tables, arc_length)
    return PathPoint(*(blended[..., i] for i in range(5)))


def look_up_columns(
    path: ReferencePath, columns: Float[Array, "nodes columns"], arc_length: Float[Array, "*shape"]
) -> Float[Array, "*shape columns"]:
    """Any tables over the path's nodes at `arc_length` [m], linear in between; see `look_up`."""
    index = node_before(path, arc_length)
    nodes = jnp.concatenate([path.arc_length[:, None], columns], axis=-1)
    segment = jnp.concatenate([nodes[:-1], jnp.diff(nodes, axis=0)], axis=-1)[index]
    start, change = jnp.split(segment, 2, axis=-1)
    weight = (arc_length - start[..., 0]) / change[..., 0]
    return start[..., 1:] + weight[..., None] * change[..., 1:]


def to_cartesian(
    path: ReferencePath, arc_length: Float[Array, "*shape"], offset: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Cartesian x, y [m] of Frenet points: the path's point plus `offset` [m] times its left normal."""
    point = look_up(path, arc_length)
    return point.x - offset * jnp.sin(point.heading), point.y + offset * jnp.cos(point.heading)


def project(
    path: ReferencePath, x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Frenet coordinates (arc length, offset) [m] of Cartesian points: the inverse of `to_cartesian`.

    The arc length is where the point lies on the path's normal. The search starts on the segment that is nearest to
    the point and is clipped to the path's ends.
    """
    index = _nearest_segment(path, x, y)
    start = path.arc_length[index]
    span = path.arc_length[index + 1] - start

    def ahead(arc_length):
        """How far the point lies ahead of the normal at `arc_length`, and that normal's frame."""
        point = look_up(path, arc_length)
        cos, sin = jnp.cos(point.heading), jnp.sin(point.heading)
        dx, dy = x - point.x, y - point.y
        return dx * cos + dy * sin, dy * cos - dx * sin, point

    def newton(_, arc_length):
        along, offset, point = ahead(arc_length)
        slope = jnp.maximum(1.0 - point.curvature * offset, 0.1)
        moved = arc_length + along / slope
        return jnp.clip(moved, start - span, start + 2.0 * span)

    arc_length = jax.lax.fori_loop(0, 8, newton, start + 0.5 * span)
    arc_length = jnp.clip(arc_length, path.arc_length[0], path.length)
    return arc_length, ahead(arc_length)[1]


def _nearest_segment(path: ReferencePath, x: Array, y: Array) -> Array:
    """Index of the node at which the path's nearest segment starts; padding is left out."""
    x0, y0 = path.x[:-1], path.y[:-1]
    dx, dy = path.x[1:] - x0, path.y[1:] - y0
    px, py = x[..., None] - x0, y[..., None] - y0
    share = jnp.clip((px * dx + py * dy) / jnp.maximum(dx**2 + dy**2, 1e-12), 0.0, 1.0)
    distance = (px - share * dx) ** 2 + (py - share * dy) ** 2
    return jnp.argmin(jnp.where(path.arc_length[:-1] < path.length, distance, jnp.inf), axis=-1)
