"""Highway entries, drawn at random: two lanes, a ramp, and an acceleration lane that ends.

Either the ego comes from the ramp and merges into the traffic, or it drives on the right lane and others cut in. The
merging path is the one that the importer draws for a lane change (`scenarios.route_path`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from jaxfrenet.collision import Box
from scenarios.assembly import World, assemble, goal_interval, path_capacity, start_of
from scenarios.distributions import Dice, Knots, check_knots, check_number
from scenarios.errors import ScenarioError
from scenarios.lanelet_map import LaneletLinks, LaneletMap
from scenarios.lines import Line, integrated, joined, look_up, moved, moved_points, offset_by, smooth_step
from scenarios.traffic import Agents, Relations, as_obstacles, drive
from scenarios.vehicle_types import CAR, MOTORCYCLE, TRUCK, VehicleType, draw_types

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
MAX_VEHICLES = 8
NEARBY = 32
"""Most road edge segments near one stretch of a path."""
DICE = 96
"""Random numbers per scenario, at least as many as are taken."""


@dataclass(frozen=True, kw_only=True)
class HighwayConfig:
    """What highway entries are drawn from; frozen and hashable. Numbers are drawn from distributions, see `Knots`."""

    steps: int = 148
    """Recorded time steps of 0.1 s."""
    lane_width: Knots = (3.4, 3.75)
    """m."""
    bend: Knots = (-0.15, 0.15)
    """Angle by which the road bends before the entry, and behind it [rad]."""
    approach: Knots = (130.0, 170.0)
    """Length of the road before the entry [m]."""
    acceleration_lane: Knots = (110.0, 180.0)
    """Its length [m]; merging takes 30 m, or 3 s, from its start."""
    exit: Knots = (110.0, 170.0)
    """Length of the road behind the entry, which is the goal [m]."""
    ramp_offset: Knots = (6.0, 14.0)
    """How far to the right the ramp begins [m]."""
    merging: float = 0.5
    """Probability that the ego comes from the ramp; else it drives on the right lane."""
    start_distance: Knots = (15.0, 60.0)
    """From the ego's start to where the acceleration lane begins [m]."""
    start_speed: Knots = (14.0, 23.0)
    """m/s."""
    pace: Knots = (0.85, 1.15)
    """Mean speed to the middle of the goal relative to the start speed, which decides when to be there."""
    goal_window: int = 5
    """How many steps before and after that time the goal can be reached."""
    vehicles: int = 7
    """Most other vehicles."""
    vehicle_types: tuple[VehicleType, ...] = (replace(CAR, share=0.8), replace(TRUCK, share=0.15), MOTORCYCLE)
    """What drives there."""
    traffic_speed: Knots = (14.0, 25.0)
    """Speed of the traffic on the right lane [m/s]; the left one is faster."""
    headway: Knots = (1.0, 3.0)
    """Time between one vehicle and the next in a lane [s]."""
    cut_in: float = 0.5
    """Probability that a vehicle changes into the right lane beside the entry."""
    density: float = 0.8
    """Difficulty: probability that a vehicle is there."""
    gap: float = 1.0
    """Difficulty: factor on the headways."""
    speed_spread: float = 0.08
    """Difficulty: standard deviation of the logarithm of a factor on each vehicle's speed."""

    def __post_init__(self) -> None:
        """Refuse what no scenario can be made of.

        Raises:
          ScenarioError: a value is impossible.
        """
        for name, low, high in (
            ("lane_width", 2.5, 6.0),
            ("bend", -0.3, 0.3),
            ("approach", 100.0, 400.0),
            ("acceleration_lane", 80.0, 500.0),
            ("exit", 60.0, 500.0),
            ("ramp_offset", 2.0, 20.0),
            ("start_distance", 5.0, 95.0),
            ("start_speed", 5.0, 35.0),
            ("pace", 0.5, 1.5),
            ("traffic_speed", 1.0, 45.0),
            ("headway", 0.3, 20.0),
        ):
            check_knots(name, getattr(self, name), low, high)
        for name, low, high in (
            ("merging", 0.0, 1.0),
            ("cut_in", 0.0, 1.0),
            ("density", 0.0, 1.0),
            ("gap", 0.1, 10.0),
            ("speed_spread", 0.0, 0.5),
            ("steps", 60, 1000),
            ("goal_window", 0, 50),
            ("vehicles", 1, MAX_VEHICLES),
        ):
            check_number(name, getattr(self, name), low, high)
        if not self.vehicle_types:
            raise ScenarioError("vehicle_types is empty: name what drives there")
        if self.acceleration_lane[0] < 3.0 * self.start_speed[-1] + 10.0:
            raise ScenarioError(
                f"acceleration_lane may be {self.acceleration_lane[0]:g} m long, but merging takes 3 s and 10 m: "
                f"give at least {3.0 * self.start_speed[-1] + 10.0:g} m or a lower start_speed"
            )

    @property
    def path_nodes(self) -> int:
        """Nodes that are enough for every path."""
        ahead = self.start_distance[-1] + self.acceleration_lane[-1]
        nearest = self.start_distance[0] + self.acceleration_lane[0]
        beyond_middle = (nearest + self.exit[-1]) / (nearest + 0.5 * self.exit[-1])
        slowest = (ahead + self.exit[-1]) / (jf.DT * (self.steps - 2 - self.goal_window))
        fastest = max(1.0, self.pace[-1] * beyond_middle) * self.start_speed[-1]
        return path_capacity(ahead, self.exit[-1] + 5.0, max(fastest, slowest))


@pytree_dataclass
class Way:
    """A drive along the road in one lane, or from one to another; any leading axes."""

    first: Int[Array, "*ways"]
    """Lane at the start."""
    last: Int[Array, "*ways"]
    """Lane at the end, at most one apart."""
    change: Float[Array, "*ways 2"]
    """m, arc lengths of the road between which the lane changes."""


def sample(key: Array, config: HighwayConfig) -> jf.Scenario:
    """Draw a scenario; pure, works under `jit` (config static) and `vmap` (over keys).

    Args:
      key: random key; the same key gives the same scenario.
      config: what is drawn from.
    """
    return sample_with_map(key, config)[0]


def sample_with_map(key: Array, config: HighwayConfig) -> tuple[jf.Scenario, LaneletMap]:
    """`sample`, with the borders of the map's lanelets; `LINKS` tells how they hang together."""
    dice = Dice(key, DICE)
    width, side = dice.draw(config.lane_width), dice.draw(config.ramp_offset)
    lengths = jnp.stack([dice.draw(config.approach), dice.draw(config.acceleration_lane), dice.draw(config.exit)])
    road = _road(lengths, dice.draw(config.bend, (2,)))
    begin, end = lengths[0], lengths[0] + lengths[1]
    merges, speed = dice.uniform() < config.merging, dice.draw(config.start_speed)
    merge_length = jnp.maximum(30.0, 3.0 * speed)
    way = Way(
        first=jnp.where(merges, RAMP_LANE, RIGHT_LANE).astype(jnp.int32),
        last=jnp.int32(RIGHT_LANE),
        change=jnp.stack([begin, begin + merge_length]),
    )
    start = begin - dice.draw(config.start_distance)
    route = _line(road, way, begin, width, side)
    ego_arc = jnp.interp(start, road.arc_length, route.arc_length)
    agents, relations = _traffic(dice, config, road, begin, end, width, side, start, speed, merges)
    positions, speeds = drive(agents, relations, config.steps, slow_in_curves=False)

    at = look_up(route, ego_arc)
    heading = dice.draw((-np.pi, np.pi))
    frame = jnp.stack([at.x, at.y]), heading - at.heading
    corners = _corners(road, begin, width, side)
    lanelets = [(moved_points(left, *frame), moved_points(right, *frame)) for left, right in _lanelets(corners)]
    goal_arc = jnp.interp(jnp.stack([end, road.arc_length[-1]]), road.arc_length, route.arc_length)
    goal_steps, _ = goal_interval(
        0.5 * jnp.sum(goal_arc) - ego_arc, speed * dice.draw(config.pace), config.goal_window, config.steps
    )
    left, right = lanelets[GOAL_LANELET]
    ego = Box.from_heading(
        jnp.zeros(()), jnp.zeros(()), heading, jnp.float32(jf.BMW_320I.length), jnp.float32(jf.BMW_320I.width)
    )
    world = World(
        route=moved(route, *frame),
        ego_arc_length=ego_arc,
        goal_arc_length=goal_arc,
        goal_ring=jnp.concatenate([right, left[::-1]]),
        goal_steps=goal_steps,
        goal_speed=jnp.stack([speed - 10.0, speed + 10.0]),
        road_ring=moved_points(_ring(corners), *frame),
        obstacles=as_obstacles(replace(agents, line=moved(agents.line, *frame)), positions, speeds, ego),
        initial_state=start_of(heading, speed, at.curvature),
    )
    lanelet_map = LaneletMap(
        left=tuple(one for one, _ in lanelets),
        right=tuple(one for _, one in lanelets),
        is_goal=jnp.arange(len(LINKS)) == GOAL_LANELET,
    )

    def lanes(along: Array) -> jf.Lanes:
        return _lanes(jnp.interp(along, route.arc_length, road.arc_length), way, merges, begin, end, width, side)

    return assemble(world, lanes, config.path_nodes, NEARBY), lanelet_map


def _road(lengths: Array, bend: Array) -> Line:
    """The right edge of the right lane: bent before and behind the entry, straight beside the acceleration lane."""
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
    return joined(*parts)


def _bent(along: Array, length: Array, angle: Array, before: Array) -> Array:
    """Heading [rad] along a section that turns by an angle."""
    return before + angle * smooth_step(along / length)[0]


def _ramp(place: Array, begin: Array, width: Array, side: Array) -> list[Array]:
    """Offset of the ramp's middle from the road's right edge [m] at places on the road [m], and its two derivatives."""
    step, slope, second = smooth_step(place / begin)
    return [side * (step - 1.0) - 0.5 * width, side * slope / begin, side * second / begin**2]


def _offset(place: Array, way: Way, begin: Array, width: Array, side: Array) -> list[Array]:
    """Offset of one way from the road's right edge [m] at places on the road [m], and its two derivatives."""
    ramp, zero = _ramp(place, begin, width, side), jnp.zeros_like(place)

    def lane(index: Array) -> list[Array]:
        own = [(index.astype(jnp.float32) - 0.5) * width + zero, zero, zero]
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


def _line(road: Line, way: Way, begin: Array, width: Array, side: Array) -> Line:
    """The line of one way."""
    return offset_by(road, *_offset(road.arc_length, way, begin, width, side))


def _traffic(
    dice: Dice,
    config: HighwayConfig,
    road: Line,
    begin: Array,
    end: Array,
    width: Array,
    side: Array,
    start: Array,
    ego_speed: Array,
    merges: Array,
) -> tuple[Agents, Relations]:
    """Vehicles at step 0, one after the other in their lanes, and how their ways lie to each other.

    Those on the right lane are around the ego if it merges, and ahead of it if not; the others may cut in.
    """
    count = config.vehicles
    index = jnp.arange(count)
    kind, length, vehicle_width, top_speed = draw_types(dice, config.vehicle_types, count)
    noise = jnp.exp(config.speed_spread * dice.normal((count,)))
    exists, headway = dice.uniform((count,)) < config.density, config.gap * dice.draw(config.headway, (count,))
    in_right, cuts_in = index < (count + 1) // 2, dice.uniform((count,)) < config.cut_in
    side_lane = jnp.where(merges | (dice.uniform((count,)) < 0.5), LEFT_LANE, RAMP_LANE)
    lane = jnp.where(in_right, RIGHT_LANE, side_lane).astype(jnp.int32)
    pace = dice.draw(config.traffic_speed)
    speed = jnp.minimum(pace * jnp.where(lane == LEFT_LANE, 1.15, 1.0) * noise, top_speed)
    room = jnp.maximum(speed * headway, length + 4.0)
    behind = jnp.cumsum(jnp.where(in_right, room, 0.0))
    ahead = jnp.cumsum(jnp.where(in_right, 0.0, room))
    longest = jnp.sum(jnp.where(in_right, room, 0.0))
    gained = (ego_speed - speed) * (begin - start) / ego_speed
    around = start + gained + 0.5 * longest - behind
    in_front = start + 8.0 + behind
    beside = start - 10.0 + ahead
    at = jnp.where(in_right, jnp.where(merges, around, in_front), beside)
    change = begin + dice.uniform((count,)) * (end - begin - 3.0 * speed - 5.0)
    cuts_in = (cuts_in | (lane == RAMP_LANE)) & ~in_right
    way = Way(
        first=lane,
        last=jnp.where(cuts_in, RIGHT_LANE, lane).astype(jnp.int32),
        change=jnp.stack([change, change + jnp.maximum(30.0, 3.0 * speed)], axis=-1),
    )
    line = jax.vmap(lambda one: _line(road, one, begin, width, side))(way)
    agents = Agents(
        line=line,
        arc_length=jax.vmap(lambda nodes, place: jnp.interp(place, road.arc_length, nodes))(line.arc_length, at),
        speed=speed,
        desired_speed=speed,
        length=length,
        width=vehicle_width,
        kind=kind,
        exists=exists & (at > 0.5 * length) & ((lane != RAMP_LANE) | (at < change)),
        rank=jnp.zeros(count),
        yields=jnp.zeros(count, bool),
    )
    return agents, _relations(road, line, way)


def _relations(road: Line, line: Line, way: Way) -> Relations:
    """Each is in the way of the others where both are in one lane, on their way between lanes in both."""

    def intervals(lane: int) -> Array:
        """Between which arc lengths of the road each way occupies a lane: `[ways, 2]`, empty if nowhere."""
        starts, ends = way.first == lane, way.last == lane
        low = jnp.where(starts, -jnp.inf, jnp.where(ends, way.change[:, 0], jnp.inf))
        high = jnp.where(ends, jnp.inf, jnp.where(starts, way.change[:, 1], -jnp.inf))
        return jnp.stack([low, high], axis=-1)

    low, high = jnp.full((len(way.first),) * 2, jnp.inf), jnp.full((len(way.first),) * 2, -jnp.inf)
    for lane in (RAMP_LANE, RIGHT_LANE, LEFT_LANE):
        mine = intervals(lane)
        first = jnp.maximum(mine[:, None, 0], mine[None, :, 0])
        last = jnp.minimum(mine[:, None, 1], mine[None, :, 1])
        low = jnp.where(first <= last, jnp.minimum(low, first), low)
        high = jnp.where(first <= last, jnp.maximum(high, last), high)

    def on_line(nodes: Array, place: Array) -> Array:
        """The road's arc lengths `[others]` as arc lengths of one line; infinite ones stay so."""
        return jnp.where(jnp.isfinite(place), jnp.interp(place, road.arc_length, nodes), place)

    meeting = jnp.where(jnp.isfinite(low), low, jnp.where(jnp.isfinite(high), high, 0.0))
    own = jax.vmap(on_line)(line.arc_length, meeting)
    theirs = jax.vmap(on_line)(line.arc_length, meeting.T).T
    shared = jnp.stack([jax.vmap(on_line)(line.arc_length, bound.T).T for bound in (low, high)], axis=-1)
    return Relations(
        shift=own - theirs,
        shared=shared,
        meets=jnp.broadcast_to(jnp.asarray([jnp.inf, -jnp.inf]), (*low.shape, 2)),
    )


def _lanes(place: Array, way: Way, merges: Array, begin: Array, end: Array, width: Array, side: Array) -> jf.Lanes:
    """The ego's lane and its neighbours, each `[nodes, 3]`, at places on the road `[nodes]`, m."""
    offset = _offset(place, way, begin, width, side)[0]
    ramp, slope, _ = _ramp(place, begin, width, side)
    beside = (place >= begin) & (place < end)
    on_ramp = merges & ((place < begin) | (beside & (offset < 0.0)))
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


def _corners(road: Line, begin: Array, width: Array, side: Array) -> tuple[Array, ...]:
    """Borders along the whole road `[corners, 2]`, m: ramp right, ramp left, and those of the two lanes."""
    ramp = _ramp(road.arc_length, begin, width, side)[0]
    offsets = (ramp - 0.5 * width, ramp + 0.5 * width, 0.0, width, 2.0 * width)
    return tuple(road.beside(offset)[::CORNER_EVERY] for offset in offsets)


def _sections() -> tuple[slice, slice, slice]:
    count = (SECTION_NODES - 1) // CORNER_EVERY
    return slice(0, count + 1), slice(count, 2 * count + 1), slice(2 * count, 3 * count + 1)


def _lanelets(corners: tuple[Array, ...]) -> list[tuple[Array, Array]]:
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


def _ring(corners: tuple[Array, ...]) -> Array:
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


HARD = HighwayConfig(density=1.0, gap=0.5, speed_spread=0.2, cut_in=1.0, vehicles=8)
"""Dense traffic of unequal speeds, in which everybody cuts in."""

PRESETS = {"default": HighwayConfig(), "hard": HARD}
