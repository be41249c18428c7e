"""Smooth driving lines as tables over arc length, with exact tangents and curvatures at the nodes.

Between nodes everything is interpolated by cubic Hermite polynomials; beyond the ends a line goes on straight.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float

GAUSS_POINTS, GAUSS_WEIGHTS = (np.asarray(part, np.float32) for part in np.polynomial.legendre.leggauss(4))


@pytree_dataclass
class Line:
    """A line's nodes; several lines of equally many nodes have leading axes."""

    arc_length: Float[Array, "*shape"]
    """`[nodes]`, m, strictly increasing."""
    x: Float[Array, "*shape"]
    """`[nodes]`, m."""
    y: Float[Array, "*shape"]
    """`[nodes]`, m."""
    heading: Float[Array, "*shape"]
    """`[nodes]`, rad, continuous."""
    curvature: Float[Array, "*shape"]
    """`[nodes]`, 1/m, positive to the left."""
    curvature_derivative: Float[Array, "*shape"]
    """`[nodes]`, 1/m²."""

    @property
    def points(self) -> Float[Array, "*shape 2"]:
        """`[nodes, 2]`, m."""
        return jnp.stack([self.x, self.y], axis=-1)

    def beside(self, offset: Array | float) -> Float[Array, "*shape 2"]:
        """`[nodes, 2]`, m, the nodes moved by `offset` [m] to the left."""
        return jnp.stack([self.x - offset * jnp.sin(self.heading), self.y + offset * jnp.cos(self.heading)], axis=-1)


def integrated(
    start: Float[Array, "2"],
    arc_length: Float[Array, "nodes"],
    heading: Callable[[Array], Array],
    curvature: Array,
    curvature_derivative: Array,
) -> Line:
    """The line from `start` [m] whose heading [rad] is a function of arc length [m], by Gauss-Legendre quadrature.

    Args:
      start: position of the first node.
      arc_length: of the nodes.
      heading: elementwise function of arc length.
      curvature: its derivative at the nodes [1/m].
      curvature_derivative: the derivative of that at the nodes [1/m²].
    """
    half = 0.5 * jnp.diff(arc_length)[:, None]
    at = heading(arc_length[:-1, None] + half * (1.0 + GAUSS_POINTS))
    x, y = (jnp.sum(half * GAUSS_WEIGHTS * part, axis=1) for part in (jnp.cos(at), jnp.sin(at)))
    zero = jnp.zeros((1,))
    return Line(
        arc_length=arc_length,
        x=start[0] + jnp.concatenate([zero, jnp.cumsum(x)]),
        y=start[1] + jnp.concatenate([zero, jnp.cumsum(y)]),
        heading=heading(arc_length),
        curvature=curvature,
        curvature_derivative=curvature_derivative,
    )


def reversed_line(line: Line) -> Line:
    """The line driven the other way, from arc length 0; any leading axes."""
    back = jax.tree.map(lambda leaf: leaf[..., ::-1], line)
    return Line(
        arc_length=line.arc_length[..., -1:] - back.arc_length,
        x=back.x,
        y=back.y,
        heading=back.heading + jnp.pi,
        curvature=-back.curvature,
        curvature_derivative=back.curvature_derivative,
    )


def parallel(line: Line, offset: Array | float) -> Line:
    """The line at `offset` [m] to the left, from arc length 0; any leading axes.

    A parallel's arc length follows from ds' = (1 - κ d) ds (e.g. Werling et al. 2010).
    """
    scale = 1.0 - line.curvature * offset
    turned = line.heading - line.heading[..., :1]
    points = line.beside(offset)
    return Line(
        arc_length=line.arc_length - line.arc_length[..., :1] - offset * turned,
        x=points[..., 0],
        y=points[..., 1],
        heading=line.heading,
        curvature=line.curvature / scale,
        curvature_derivative=line.curvature_derivative / scale**3,
    )


def joined(*parts: Line) -> Line:
    """Lines that follow each other as one, from arc length 0; the last node of each is the first of the next."""

    def kept(name: str) -> list[Array]:
        leaves = [getattr(part, name) for part in parts]
        return [leaves[0], *(leaf[..., 1:] for leaf in leaves[1:])]

    arcs, end = [], jnp.zeros_like(parts[0].arc_length[..., :1])
    for part in parts:
        arcs.append(part.arc_length - part.arc_length[..., :1] + end)
        end = arcs[-1][..., -1:]
    headings, before = [], parts[0].heading[..., :1]
    for part in parts:
        turns = jnp.round((before - part.heading[..., :1]) / (2 * jnp.pi))
        headings.append(part.heading + 2 * jnp.pi * turns)
        before = headings[-1][..., -1:]
    others = {name: jnp.concatenate(kept(name), axis=-1) for name in ("x", "y", "curvature", "curvature_derivative")}
    return Line(
        arc_length=jnp.concatenate([arcs[0], *(arc[..., 1:] for arc in arcs[1:])], axis=-1),
        heading=jnp.concatenate([headings[0], *(heading[..., 1:] for heading in headings[1:])], axis=-1),
        **others,
    )


def moved(line: Line, position: Float[Array, "2"], angle: Float[Array, ""]) -> Line:
    """The line in a frame whose origin was at `position` [m], turned by `angle` [rad]; any leading axes."""
    points = moved_points(line.points, position, angle)
    return dataclasses.replace(line, x=points[..., 0], y=points[..., 1], heading=line.heading + angle)


def moved_points(points: Float[Array, "*shape 2"], position: Float[Array, "2"], angle: Float[Array, ""]) -> Array:
    """Points [m] in a frame whose origin was at `position` [m], turned by `angle` [rad]."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = points[..., 0] - position[0], points[..., 1] - position[1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def look_up(line: Line, arc_length: Float[Array, "*shape"]) -> Line:
    """The line at any arc lengths [m], as nodes of that shape.

    Args:
      line: one line.
      arc_length: beyond the ends the line goes on straight.
    """
    nodes = line.arc_length
    inside = jnp.clip(arc_length, nodes[0], nodes[-1])
    index = jnp.searchsorted(nodes, inside, side="right", method="scan_unrolled") - 1
    index = jnp.clip(index, 0, nodes.shape[0] - 2)
    tangents = jnp.stack([jnp.cos(line.heading), jnp.sin(line.heading)], axis=-1)
    values = jnp.stack([line.x, line.y, line.heading, line.curvature], axis=-1)
    slopes = jnp.concatenate([tangents, line.curvature[:, None], line.curvature_derivative[:, None]], axis=-1)
    table = jnp.concatenate([nodes[:, None], values, slopes], axis=-1)
    before, after = table[index], table[index + 1]
    step = (after[..., 0] - before[..., 0])[..., None]
    share = (inside - before[..., 0])[..., None] / step
    p0, p1, m0, m1 = before[..., 1:5], after[..., 1:5], step * before[..., 5:], step * after[..., 5:]
    delta = p1 - p0
    bend = 3.0 * delta - 2.0 * m0 - m1
    twist = m0 + m1 - 2.0 * delta
    value = p0 + share * (m0 + share * (bend + share * twist))
    slope = (m0 + share * (2.0 * bend + 3.0 * share * twist)) / step
    beyond = arc_length - inside
    on_line = beyond == 0.0
    heading = value[..., 2]
    return Line(
        arc_length=arc_length,
        x=value[..., 0] + beyond * jnp.cos(heading),
        y=value[..., 1] + beyond * jnp.sin(heading),
        heading=heading,
        curvature=jnp.where(on_line, value[..., 3], 0.0),
        curvature_derivative=jnp.where(on_line, slope[..., 3], 0.0),
    )


def offset_by(base: Line, offset: Array, slope: Array, second: Array) -> Line:
    """The line at an offset from another one that changes along it, from arc length 0.

    Heading and curvature of a Frenet curve: Werling et al. 2010, equations 3 and 4 of the appendix.

    Args:
      base: one line.
      offset: at each of its nodes [m], to the left.
      slope: derivative of the offset with respect to the base's arc length.
      second: second derivative [1/m].
    """
    scale = 1.0 - base.curvature * offset
    turn = jnp.arctan2(slope, scale)
    cos, tan = jnp.cos(turn), slope / scale
    bent = second + (base.curvature_derivative * offset + base.curvature * slope) * tan
    curvature = (bent * cos**2 / scale + base.curvature) * cos / scale
    stretch = scale / cos
    steps = 0.5 * (stretch[1:] + stretch[:-1]) * jnp.diff(base.arc_length)
    points = base.beside(offset)
    return Line(
        arc_length=jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)]),
        x=points[..., 0],
        y=points[..., 1],
        heading=base.heading + turn,
        curvature=curvature,
        curvature_derivative=_slope(curvature, base.arc_length) / stretch,
    )


def _slope(values: Array, at: Array) -> Array:
    """Derivative at nodes that are nearly evenly spaced, by central differences."""
    padded, nodes = (jnp.pad(leaf, 1, mode="reflect", reflect_type="odd") for leaf in (values, at))
    return (padded[2:] - padded[:-2]) / (nodes[2:] - nodes[:-2])


def smooth_step(share: Array) -> tuple[Array, Array, Array]:
    """A quintic step from 0 to 1 on [0, 1], with its first and second derivative; all vanish at both ends."""
    t = jnp.clip(share, 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2), 30.0 * t**2 * (1.0 - t) ** 2, 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t)
