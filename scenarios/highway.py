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
from jaxfrenet._typing import Array
from scenarios.assembly import World, assemble, ego_box, goal_interval, path_capacity, start_of
from scenarios.distributions import Dice, Knots, check_knots, check_number
from scenarios.errors import ScenarioError
from scenarios.highway_road import (
    GOAL_LANELET,
    LEFT_LANE,
    LINKS,
    PIECES,
    RAMP_LANE,
    RIGHT_LANE,
    Highway,
    Way,
    borders,
    highway,
    lanelet_borders,
    lanes_of,
    line_of,
    road_ring,
)
from scenarios.lanelet_map import LaneletMap, lane_map_of
from scenarios.lines import Line, look_up, moved, moved_points
from scenarios.route import LANE_CHANGE_TIME, SHORTEST_LANE_CHANGE
from scenarios.traffic import Agents, Relations, as_obstacles, drive
from scenarios.vehicle_types import CAR, MOTORCYCLE, TRUCK, VehicleType, draw_types

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
    road = highway(lengths, dice.draw(config.bend, (2,)), width, side)
    merges, speed = dice.uniform() < config.merging, dice.draw(config.start_speed)
    start = road.begin - dice.draw(config.start_distance)
    way = Way(
        first=jnp.where(merges, RAMP_LANE, RIGHT_LANE).astype(jnp.int32),
        last=jnp.int32(RIGHT_LANE),
        change=jnp.stack([road.begin, road.begin + lane_change_length(speed)]),
    )
    route, places = line_of(road, way), road.edge.arc_length
    ego_arc = jnp.interp(start, places, route.arc_length)
    agents, relations = _traffic(dice, config, road, start, speed, merges)
    positions, speeds = drive(agents, relations, config.steps, slow_in_curves=False)

    at = look_up(route, ego_arc)
    heading = dice.draw((-np.pi, np.pi))
    frame = jnp.stack([at.x, at.y]), heading - at.heading
    corners = tuple(moved_points(border, *frame) for border in borders(road))
    left, right = (tuple(side) for side in zip(*lanelet_borders(corners), strict=True))
    goal_arc = jnp.interp(jnp.stack([road.end, places[-1]]), places, route.arc_length)
    pace = speed * dice.draw(config.pace)
    goal_steps, _ = goal_interval(0.5 * jnp.sum(goal_arc) - ego_arc, pace, config.goal_window, config.steps)
    world = World(
        route=moved(route, *frame),
        ego_arc_length=ego_arc,
        goal_arc_length=goal_arc,
        goal_ring=jnp.concatenate([right[GOAL_LANELET], left[GOAL_LANELET][::-1]]),
        goal_steps=goal_steps,
        goal_speed=jnp.stack([speed - 10.0, speed + 10.0]),
        lane_map=lane_map_of(list(zip(left, right, strict=True)), LINKS, (PIECES,) * len(LINKS)),
        road_ring=road_ring(corners),
        obstacles=as_obstacles(replace(agents, line=moved(agents.line, *frame)), positions, speeds, ego_box(heading)),
        initial_state=start_of(heading, speed, at.curvature),
    )

    def lanes(along: Array) -> jf.Lanes:
        return lanes_of(road, way, jnp.interp(along, route.arc_length, places))

    is_goal = jnp.arange(len(LINKS)) == GOAL_LANELET
    return assemble(world, lanes, config.path_nodes, NEARBY), LaneletMap(left=left, right=right, is_goal=is_goal)


def lane_change_length(speed: Array) -> Array:
    """Length [m] of a lane change at a speed [m/s], as the importer has it."""
    return jnp.maximum(SHORTEST_LANE_CHANGE, LANE_CHANGE_TIME * speed)


def _traffic(
    dice: Dice, config: HighwayConfig, road: Highway, start: Array, ego_speed: Array, merges: Array
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
    gained = (ego_speed - speed) * (road.begin - start) / ego_speed
    around = start + gained + 0.5 * longest - behind
    in_front = start + 8.0 + behind
    beside = start - 10.0 + ahead
    at = jnp.where(in_right, jnp.where(merges, around, in_front), beside)
    beside_lane = road.end - road.begin
    change_length = jnp.minimum(lane_change_length(speed), 0.9 * beside_lane)
    change = road.begin + dice.uniform((count,)) * (beside_lane - change_length)
    cuts_in = (cuts_in | (lane == RAMP_LANE)) & ~in_right
    way = Way(
        first=lane,
        last=jnp.where(cuts_in, RIGHT_LANE, lane).astype(jnp.int32),
        change=jnp.stack([change, change + change_length], axis=-1),
    )
    line, places = jax.vmap(partial(line_of, road))(way), road.edge.arc_length
    agents = Agents(
        line=line,
        arc_length=jax.vmap(lambda nodes, place: jnp.interp(place, places, nodes))(line.arc_length, at),
        speed=speed,
        desired_speed=speed,
        length=length,
        width=vehicle_width,
        kind=kind,
        exists=exists & (at > 0.5 * length) & ((lane != RAMP_LANE) | (at < change)),
        rank=jnp.zeros(count),
        yields=jnp.zeros(count, bool),
    )
    return agents, _relations(places, line, way)


def _relations(places: Array, line: Line, way: Way) -> Relations:
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
        return jnp.where(jnp.isfinite(place), jnp.interp(place, places, nodes), place)

    meeting = jnp.where(jnp.isfinite(low), low, jnp.where(jnp.isfinite(high), high, 0.0))
    own = jax.vmap(on_line)(line.arc_length, meeting)
    theirs = jax.vmap(on_line)(line.arc_length, meeting.T).T
    shared = jnp.stack([jax.vmap(on_line)(line.arc_length, bound.T).T for bound in (low, high)], axis=-1)
    return Relations(
        shift=own - theirs,
        shared=shared,
        meets=jnp.broadcast_to(jnp.asarray([jnp.inf, -jnp.inf]), (*low.shape, 2)),
    )


HARD = HighwayConfig(density=1.0, gap=0.5, speed_spread=0.2, cut_in=1.0, vehicles=8)
"""Dense traffic of unequal speeds, in which everybody cuts in."""

PRESETS = {"default": HighwayConfig(), "hard": HARD}
