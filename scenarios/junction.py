"""Junctions of straight and bent arms with one lane in each direction, right-hand traffic.

The arms' centre lines meet in the origin; from the mouths, at one distance from it, road curves join every arm with
every other one. Each arm and curve has one lane to either side of its centre line, so that two lanes that lead between
the same arms lie side by side, and the road's edge is one ring.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._angles import wrapped
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from scenarios.lanelet_map import LaneletLinks
from scenarios.lines import Line, integrated, joined, parallel, reversed_line

ARM_NODES = 49
"""Nodes of an arm's centre line."""
CURVE_NODES = 49
"""Nodes of a road curve."""
CORNER_EVERY = 3
"""One of so many nodes is a corner of lanelets and of the road's edge."""
RAMP = 0.3
"""Share of a turn on which curvature rises, and on which it falls again."""
LARGEST_RADIUS = 3.0
"""Turn radius over lane width beyond which the lanes no longer cover the middle of the junction."""
INSET = 1e-3
"""Lanelets inside the junction keep this far [m] from the road's edge, which their borders would else follow."""
PIECES_OF_ARM = 5
"""Into how many pieces of a `jaxfrenet.LaneMap` a lane of an arm is cut; those inside the junction are one each."""
STRAIGHT = 0.7
"""Turns by less than this [rad] lead straight on."""


@pytree_dataclass
class Junction:
    """A junction's shape; the arms are in counter-clockwise order."""

    angle: Float[Array, "arms"]
    """`[arms]`, rad, direction of each arm from the origin."""
    bend: Float[Array, "arms"]
    """`[arms]`, rad, angle by which each arm bends to the left on its way outwards."""
    arm_length: Float[Array, "arms"]
    """`[arms]`, m, from the mouth to the arm's end."""
    turn_radius: Float[Array, ""]
    """`[]`, m, least radius of the road curves' centre lines; see `LARGEST_RADIUS`."""
    lane_width: Float[Array, ""]
    """`[]`, m."""


@pytree_dataclass
class JunctionLines:
    """Centre lines."""

    arms: Line
    """`[arms, nodes]`, from the mouth outwards."""
    curves: Line
    """`[arms, arms, nodes]`, from the mouth of the first to the mouth of the second; nothing useful on the diagonal."""
    lanes: Line
    """`[arms, arms, nodes]`, the middle of the lane from the end of the first arm to the end of the second."""

    @property
    def enters(self) -> Float[Array, "arms arms"]:
        """`[arms, arms]`, m, arc length at which a lane enters the junction."""
        return self.lanes.arc_length[..., ARM_NODES - 1]

    @property
    def leaves(self) -> Float[Array, "arms arms"]:
        """`[arms, arms]`, m, arc length at which a lane leaves the junction."""
        return self.lanes.arc_length[..., ARM_NODES + CURVE_NODES - 2]


def junction_lines(junction: Junction) -> JunctionLines:
    """All centre lines of a junction."""
    count = junction.angle.shape[0]
    turn = wrapped(junction.angle[None, :] - junction.angle[:, None] - jnp.pi)
    chord = _chord_share(turn)
    is_turn = (jnp.abs(turn) > STRAIGHT) & ~jnp.eye(count, dtype=bool)
    radius = jnp.minimum(junction.turn_radius, LARGEST_RADIUS * junction.lane_width)
    length = jnp.abs(turn) * radius / (1.0 - RAMP)
    tangent = length * chord / (2.0 * jnp.cos(0.5 * turn))
    shortest = jnp.min(jnp.where(is_turn, tangent, jnp.inf))
    mouth = jnp.max(jnp.where(is_turn, tangent, 0.0))
    tangent = jnp.where(is_turn, tangent, shortest)
    length = 2.0 * tangent * jnp.cos(0.5 * turn) / chord
    start = mouth * jnp.stack([jnp.cos(junction.angle), jnp.sin(junction.angle)], axis=-1)
    arms = jax.vmap(_arm)(start, junction.angle, junction.bend, junction.arm_length)
    from_one = jax.vmap(_curve, in_axes=(None, None, 0, 0, 0))
    curves = jax.vmap(from_one)(start, junction.angle, turn, length, mouth - tangent)

    def spread(line: Line, axis: int) -> Line:
        return jax.tree.map(lambda leaf: jnp.repeat(jnp.expand_dims(leaf, axis), count, axis=axis), line)

    inwards, outwards = spread(reversed_line(arms), 1), spread(arms, 0)
    lanes = parallel(joined(inwards, curves, outwards), -0.5 * junction.lane_width)
    return JunctionLines(arms, curves, lanes)


def _arm(start: Array, angle: Array, bend: Array, length: Array) -> Line:
    """An arm from its mouth outwards; its curvature is a quartic bump, so that both ends are straight."""
    share = jnp.linspace(0.0, 1.0, ARM_NODES)

    def heading(along: Array) -> Array:
        t = along / length
        return angle + bend * t**3 * (10.0 - 15.0 * t + 6.0 * t**2)

    curvature = bend / length * 30.0 * share**2 * (1.0 - share) ** 2
    change = bend / length**2 * 60.0 * share * (1.0 - share) * (1.0 - 2.0 * share)
    return integrated(start, share * length, heading, curvature, change)


def _curve(start: Array, angle: Array, turn: Array, length: Array, straight: Array) -> Line:
    """A road curve into the junction from the arm at `angle`, which turns between two straight stretches."""
    nodes = jnp.linspace(0.0, length + 2.0 * straight, CURVE_NODES)

    def share(along: Array) -> Array:
        return jnp.clip((along - straight) / length, 0.0, 1.0)

    def heading(along: Array) -> Array:
        return angle + jnp.pi + turn * _turned(share(along))

    level, slope = _bump(share(nodes))
    return integrated(start, nodes, heading, turn / length * level, turn / length**2 * slope)


def _bump(share: Array) -> tuple[Array, Array]:
    """Curvature over a turn, as a multiple of its mean, and its derivative: rising smoothly, constant, falling."""
    from_end = jnp.minimum(share, 1.0 - share)
    t = jnp.clip(from_end / RAMP, 0.0, 1.0)
    height = 1.0 / (1.0 - RAMP)
    slope = height * 6.0 * t * (1.0 - t) / RAMP
    return height * t**2 * (3.0 - 2.0 * t), jnp.where(share < 0.5, slope, -slope)


def _turned(share: Array) -> Array:
    """Share of a turn's angle that lies behind after a share of its length: the integral of `_bump`."""
    from_end = jnp.minimum(share, 1.0 - share)
    t = jnp.clip(from_end / RAMP, 0.0, 1.0)
    half = (RAMP * (t**3 - 0.5 * t**4) + jnp.maximum(from_end - RAMP, 0.0)) / (1.0 - RAMP)
    return jnp.where(share < 0.5, half, 1.0 - half)


def _chord_share(turn: Array) -> Array:
    """Chord of a turn by an angle [rad] over its length; the chord lies in the direction half way through."""
    share = (jnp.arange(64, dtype=jnp.float32) + 0.5) / 64
    return jnp.mean(jnp.cos(turn[..., None] * (_turned(share) - 0.5)), axis=-1)


def road_ring(lines: JunctionLines, lane_width: Array) -> Float[Array, "corners 2"]:
    """The road's edge, counter-clockwise: in along one arm, around the corner, out along the next, across its end."""
    count = lines.arms.x.shape[0]
    parts = []
    for first in range(count):
        second = (first + 1) % count
        inwards, outwards = arm_borders(lines, first, lane_width)[0], arm_borders(lines, second, lane_width)[2]
        around = curve_borders(lines, first, second, lane_width)[2]
        end = arm_borders(lines, second, lane_width)[1][-1:]
        parts += [inwards[::-1], around[1:-1], outwards, end]
    return jnp.concatenate(parts)


def arm_borders(lines: JunctionLines, arm: int, lane_width: Array) -> tuple[Array, Array, Array]:
    """Left border, middle and right border of an arm, seen outwards: each `[corners, 2]`, m."""
    line = jax.tree.map(lambda leaf: leaf[arm, ::CORNER_EVERY], lines.arms)
    return line.beside(lane_width), line.points, line.beside(-lane_width)


def curve_borders(lines: JunctionLines, first: int, second: int, lane_width: Array) -> tuple[Array, Array, Array]:
    """Left border, middle and right border of a road curve: each `[corners, 2]`, m; they end at the arms' corners."""
    line = jax.tree.map(lambda leaf: leaf[first, second, ::CORNER_EVERY], lines.curves)
    starts, ends = arm_borders(lines, first, lane_width), arm_borders(lines, second, lane_width)
    borders = (line.beside(lane_width), line.points, line.beside(-lane_width))
    return tuple(  # pyright: ignore[reportReturnType]
        jnp.concatenate([start[:1], border[1:-1], end[:1]])
        for border, start, end in zip(borders, starts[::-1], ends, strict=True)
    )


def lanelet_links(arms: int) -> tuple[LaneletLinks, ...]:
    """How the lanelets of a junction hang together: inwards and outwards per arm, then one per pair of arms."""
    pairs = _pairs(arms)
    through = {pair: 2 * arms + index for index, pair in enumerate(pairs)}
    links = []
    for arm in range(arms):
        into = tuple(through[pair] for pair in pairs if pair[0] == arm)
        links += [LaneletLinks(into, left=2 * arm + 1), LaneletLinks((), left=2 * arm)]
    return (*links, *(LaneletLinks((2 * second + 1,), left=through[second, first]) for first, second in pairs))


def lanelet_pieces(arms: int) -> tuple[int, ...]:
    """Into how many pieces each lanelet is cut, in the order of `lanelet_links`."""
    return (PIECES_OF_ARM,) * (2 * arms) + (1,) * len(_pairs(arms))


def _pairs(arms: int) -> list[tuple[int, int]]:
    return [(first, second) for first in range(arms) for second in range(arms) if first != second]


def lanelet_borders(lines: JunctionLines, lane_width: Array) -> list[tuple[Array, Array]]:
    """Left and right border `[corners, 2]`, m, of each lanelet, in the order of `lanelet_links`."""
    arms = lines.arms.x.shape[0]
    borders = []
    for arm in range(arms):
        left, middle, right = arm_borders(lines, arm, lane_width)
        borders += [(middle[::-1], left[::-1]), (middle, right)]
    for first, second in _pairs(arms):
        _, middle, right = curve_borders(lines, first, second, lane_width)
        if second != (first + 1) % arms:
            inner = curve_borders(lines, first, second, lane_width - INSET)[2]
            right = jnp.concatenate([right[:1], inner[1:-1], right[-1:]])
        borders.append((middle, right))
    return borders
