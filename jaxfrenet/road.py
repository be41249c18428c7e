"""Does a vehicle leave the road surface? Exactly, and quickly along the reference path."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._typing import Array, Bool, Float
from jaxfrenet.collision import Box, box_meets_segment
from jaxfrenet.scenario import Road

BIN_LENGTH = 2.0
"""Length [m] of the stretches of reference path for which `Road.nearby` lists road edge segments."""
CORRIDOR = 6.0
"""Farthest offset [m] from the reference path at which the planner may drive; `Road.nearby` is complete up to it."""
REACH = 8.0
"""Farthest distance [m] from the rear axle to a point of the box that the vehicle sweeps within one time step."""


def is_inside(
    start: Float[Array, "segments 2"], end: Float[Array, "segments 2"], valid: Array, point: Float[Array, "2"]
) -> Bool[Array, ""]:
    """Whether a point lies inside the outline made of line segments (even-odd rule)."""
    (x0, y0), (x1, y1) = start.T, end.T
    crosses = (y0 > point[1]) != (y1 > point[1])
    rise = jnp.where(crosses, y1 - y0, 1.0)
    right = x0 + (point[1] - y0) / rise * (x1 - x0) > point[0]
    return jnp.sum(crosses & right & valid) % 2 == 1


def is_off_road(
    segments: Float[Array, "segments 2 2"],
    valid: Bool[Array, "segments"],
    center: Float[Array, "2"],
    heading: Float[Array, ""],
    length: Float[Array, ""],
    width: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether a box is not entirely on the road: it meets the road's edge, or lies outside of it altogether.

    Args:
      segments: the road's edge [m], as in `Road`.
      valid: which segments exist.
      center: the box's centre [m].
      heading: its direction [rad].
      length: its length [m].
      width: its width [m].
    """
    start, end = segments[:, 0], segments[:, 1]
    box = Box.from_heading(center[0], center[1], heading, length, width)
    meets = jnp.any(box_meets_segment(box, start, end) & valid)
    return meets | ~is_inside(start, end, valid, center)


def sweeps_edge(
    road: Road, swept: Box, arc_length: Float[Array, "*shape"], offset: Float[Array, "*shape"]
) -> Bool[Array, "*shape"]:
    """Whether boxes that a vehicle sweeps along the reference path meet the road's edge.

    A vehicle farther than `CORRIDOR` from the path counts as off the road. Only the segments listed for the stretch
    of path are looked at, which within the corridor are all that can be met.

    Args:
      road: the road's edge.
      swept: the swept boxes, any shape.
      arc_length: of the rear axle at the start of the step [m], same shape.
      offset: of the rear axle [m], same shape.
    """
    stretch = jnp.clip((arc_length / BIN_LENGTH).astype(jnp.int32), 0, road.nearby.shape[0] - 1)
    candidates = road.nearby[stretch]
    corners = road.segments[candidates]
    meets = box_meets_segment(swept.expand_dims(-1), corners[..., 0, :], corners[..., 1, :])
    return jnp.any(meets & (candidates >= 0), axis=-1) | (jnp.abs(offset) > CORRIDOR)
