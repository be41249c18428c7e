"""The road of a highway entry: two lanes, a ramp, an acceleration lane, and the ways that lead along them.

Places are arc lengths on the right edge of the right lane; offsets from it are to the left.
"""

from __future__ import annotations

from functools import partial

import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from scenarios.lanelet_map import LaneletLinks
from scenarios.lines import Line, integrated, joined, offset_by, smooth_step

SECTION_NODES = 49
"""Nodes of the road in each of its three sections: before, beside and behind the acceleration lane."""
CORNER_EVERY = 3
"""One of so many nodes is a corner of lanelets and of the road's edge."""
RAMP_LANE, RIGHT_LANE, LEFT_LANE = 0, 1, 2
LINKS = (
    LaneletLinks((3,)),
    LaneletLinks((4,), left=2, left_same_direction=True),
    LaneletLinks((5,), right=1),
    LaneletLinks((), left=4, left_same_direction=True),
    LaneletLinks((6,), left=5, left_same_direction=True, right=3),
    LaneletLinks((7,), right=4),
    LaneletLinks((), left=7, left_same_direction=True),
    LaneletLinks((), right=6),
)
"""Ramp, right and left lane before the entry; acceleration lane, right and left lane beside it; both lanes behind."""
GOAL_LANELET = 6
PIECES = 5
"""Into how many pieces of a `jaxfrenet.LaneMap` a lanelet is cut."""


@pytree_dataclass
class Highway:
    """The road's shape."""

    edge: Line
    """The right edge of the right lane."""
    begin: Float[Array, ""]
    """m, place where the acceleration lane begins."""
    end: Float[Array, ""]
    """m, place where it ends."""
    lane_width: Float[Array, ""]
    """m."""
    ramp_offset: Float[Array, ""]
    """m, how far to the right of the acceleration lane the ramp begins."""


@pytree_dataclass
class Way:
    """A drive along the road in one lane, or from one to another; any leading axes."""

    first: Int[Array, "*ways"]
    """Lane at the start."""
    last: Int[Array, "*ways"]
    """Lane at the end, at most one apart."""
    change: Float[Array, "*ways 2"]
    """m, arc lengths of the road between which the lane changes."""


def highway(lengths: Array, bend: Array, lane_width: Array, ramp_offset: Array) -> Highway:
    """A road of three sections: before, beside and behind the acceleration lane, the middle one straight.

    Args:
      lengths: of the sections `[3]`, m.
      bend: angles by which the outer ones turn `[2]`, rad.
      lane_width: m.
      ramp_offset: m.
    """
    share = jnp.linspace(0.0, 1.0, SECTION_NODES)
    angles = jnp.stack([bend[0], jnp.zeros(()), bend[1]])
    before = jnp.concatenate([jnp.zeros(1), jnp.cumsum(angles)])
    _, slope, second = smooth_step(share)
    start, parts = jnp.zeros(2), []
    for index in range(3):
        length, angle = lengths[index], angles[index]
        heading = partial(_bent, length=length, angle=angle, before=before[index])
        parts.append(integrated(start, share * length, heading, angle / length * slope, angle / length**2 * second))
        start = parts[-1].points[-1]
    return Highway(joined(*parts), lengths[0], lengths[0] + lengths[1], lane_width, ramp_offset)


def _bent(along: Array, length: Array, angle: Array, before: Array) -> Array:
    """Heading [rad] along a section that turns by an angle."""
    return before + angle * smooth_step(along / length)[0]


def _ramp(road: Highway, place: Array) -> list[Array]:
    """Offset of the ramp's middle at places [m], and its two derivatives."""
    step, slope, second = smooth_step(place / road.begin)
    side = road.ramp_offset
    return [side * (step - 1.0) - 0.5 * road.lane_width, side * slope / road.begin, side * second / road.begin**2]


def _offset(road: Highway, way: Way, place: Array) -> list[Array]:
    """Offset of a way at places [m], and its two derivatives."""
    ramp, zero = _ramp(road, place), jnp.zeros_like(place)

    def lane(index: Array) -> list[Array]:
        own = [(index.astype(jnp.float32) - 0.5) * road.lane_width + zero, zero, zero]
        return [jnp.where(index == RAMP_LANE, ramp[i], own[i]) for i in range(3)]

    (d0, v0, a0), (d1, v1, a1) = lane(way.first), lane(way.last)
    length = way.change[1] - way.change[0]
    step, slope, second = smooth_step((place - way.change[0]) / length)
    slope, second = slope / length, second / length**2
    return [
        d0 + step * (d1 - d0),
        v0 + step * (v1 - v0) + slope * (d1 - d0),
        a0 + step * (a1 - a0) + 2.0 * slope * (v1 - v0) + second * (d1 - d0),
    ]


def line_of(road: Highway, way: Way) -> Line:
    """The line of one way."""
    return offset_by(road.edge, *_offset(road, way, road.edge.arc_length))


def lanes_of(road: Highway, way: Way, place: Array) -> jf.Lanes:
    """The lane that a way is in and its neighbours, each `[nodes, 3]`, at places `[nodes]`, m."""
    width, merges = road.lane_width, way.first == RAMP_LANE
    offset = _offset(road, way, place)[0]
    ramp, slope, _ = _ramp(road, place)
    beside = (place >= road.begin) & (place < road.end)
    on_ramp = merges & ((place < road.begin) | (beside & (offset < 0.0)))
    own = jnp.where(on_ramp, ramp, 0.5 * width)
    left, right = jnp.where(on_ramp, 0.5 * width, 1.5 * width), jnp.full_like(own, -0.5 * width)
    exists = jnp.stack([place > -jnp.inf, ~on_ramp | beside, beside & ~on_ramp], axis=-1)
    center = jnp.stack([own, left, right], axis=-1) - offset[:, None]
    narrower = jnp.where(on_ramp, 1.0 / jnp.sqrt(1.0 + slope**2), 1.0)[:, None]
    widths = width * jnp.where(jnp.arange(3) == 0, narrower, 1.0)
    return jf.Lanes(
        center=jnp.where(exists, center, 0.0),
        width=jnp.where(exists, widths, 0.0),
        direction=exists.astype(jnp.int32),
    )


def borders(road: Highway) -> tuple[Array, ...]:
    """Corners of the borders along the whole road, each `[corners, 2]`, m: ramp right, ramp left, the two lanes'."""
    ramp, width = _ramp(road, road.edge.arc_length)[0], road.lane_width
    offsets = (ramp - 0.5 * width, ramp + 0.5 * width, 0.0, width, 2.0 * width)
    return tuple(road.edge.beside(offset)[::CORNER_EVERY] for offset in offsets)


def _sections() -> tuple[slice, slice, slice]:
    count = (SECTION_NODES - 1) // CORNER_EVERY
    return slice(0, count + 1), slice(count, 2 * count + 1), slice(2 * count, 3 * count + 1)


def lanelet_borders(corners: tuple[Array, ...]) -> list[tuple[Array, Array]]:
    """Left and right border of each lanelet, in the order of `LINKS`."""
    ramp_right, ramp_left, right, middle, left = corners
    before, beside, behind = _sections()
    return [
        (jnp.concatenate([ramp_left[before][:-1], right[before][-1:]]), ramp_right[before]),
        (middle[before], right[before]),
        (left[before], middle[before]),
        (right[beside], ramp_right[beside]),
        (middle[beside], right[beside]),
        (left[beside], middle[beside]),
        (middle[behind], right[behind]),
        (left[behind], middle[behind]),
    ]


def road_ring(corners: tuple[Array, ...]) -> Array:
    """The road's edge, counter-clockwise, from the ramp's begin on."""
    ramp_right, ramp_left, right, middle, left = corners
    before, beside, behind = _sections()
    return jnp.concatenate(
        [
            ramp_right[before],
            ramp_right[beside][1:],
            right[behind],
            middle[-1:],
            left[::-1],
            middle[:1],
            right[before],
            ramp_left[before][-2::-1],
        ]
    )
