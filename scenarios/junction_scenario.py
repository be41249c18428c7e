"""A drive through a junction: where the ego comes from and goes to, the traffic in its way, the goal behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

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
from scenarios.junction import (
    Junction,
    JunctionLines,
    arm_borders,
    curve_borders,
    junction_lines,
    road_ring,
)
from scenarios.lanelet_map import LaneletLinks, LaneletMap
from scenarios.lines import Line, look_up, moved, moved_points
from scenarios.traffic import Agents, Relations, as_obstacles, drive, meeting_places
from scenarios.vehicle_types import VehicleType, draw_types

Role = Literal["own", "exit", "other", "fourth"]
"""An arm as the ego sees it: the one it comes from, the one it leaves by, and the rest counter-clockwise."""
ROLES: tuple[Role, ...] = ("own", "exit", "other", "fourth")
MAX_VEHICLES = 8
"""Most vehicles in one scenario."""
MAX_PEDESTRIANS = 4
CROSSWALK = (2.0, 4.0)
"""How far outside the junction pedestrians cross an arm [m]."""
CURB = 2.0
"""How far from the road's edge pedestrians are out of the way [m]."""
PEDESTRIAN_SIZE = 0.6
"""Length and width of a pedestrian's box [m]."""
LONGEST_CURVE = 60.0
"""No lane through a junction is longer than this [m]."""
NEARBY = 88
"""Most road edge segments near one stretch of a path."""
NEAREST_START = 3.0
"""No ego starts nearer to the junction than this [m]."""
NOT_ARRIVED = 8.0
"""Who does not come to the middle of the junction stays this far from it [m]."""
EARLIEST_ARRIVAL = 2.5
"""Who would have to be in the middle of the junction earlier than this [s] comes as much later than the ego instead."""
INSET = 1e-3
"""Lanelets inside the junction keep this far [m] from the road's edge, which their borders would else follow."""
FIRST_ANYWAY = -1e3
"""Added to the rank of those who do not yield."""
FIRST_OF_ALL = -1e4
"""Rank of pedestrians."""


@dataclass(frozen=True)
class Stream:
    """Vehicles that come one after the other from one arm."""

    origin: Role
    """The arm they come from."""
    destination: Role | Literal["any"] = "any"
    """The arm they leave by."""
    vehicles: int = 1
    """Most of them."""
    arrival: Knots | Literal["behind the ego"] = (-5.0, 5.0)
    """How much later than the ego the first one would arrive in the middle of the junction [s], both at constant speed;
    or it follows the ego."""
    speed: Knots = (5.0, 10.0)
    """Of the first one [m/s]; relative to the ego's if it follows the ego."""
    distance: Knots | None = None
    """From the first one's start to the middle of the junction [m]: then its arrival says how fast it is."""
    spacing: Knots = (10.0, 30.0)
    """Distance between the centres of one and the next [m]."""
    follower_speed: Knots = (0.8, 1.1)
    """Of each further one, relative to the one ahead."""
    followers_arrive: bool = True
    """Whether the further ones may come to the middle of the junction before the record ends; if not, they are slow."""


@dataclass(frozen=True, kw_only=True)
class JunctionTask:
    """What all junction families have in common; numbers are drawn from distributions, see `Knots`."""

    steps: int = 148
    """Recorded time steps of 0.1 s."""
    lane_width: Knots = (3.2, 4.0)
    """m."""
    turn_radius: Knots = (7.0, 10.5)
    """Of the tightest road curve's middle [m]; never more than three lane widths."""
    bend: Knots = (-0.3, 0.3)
    """Angle by which each arm bends [rad]."""
    own_arm: Knots = (60.0, 110.0)
    """Length of the arm that the ego comes from [m], at least so that it starts on it."""
    exit_arm: Knots = (50.0, 110.0)
    """Length of the arm that it leaves by [m]."""
    other_arms: Knots = (60.0, 110.0)
    """Length of the others [m]."""
    start_distance: Knots = (8.0, 45.0)
    """From the ego's start to where it enters the junction [m]."""
    start_time: Knots | None = None
    """When the ego would be in the middle of the junction at its start speed [s], in place of that distance."""
    start_speed: Knots = (2.0, 8.0)
    """m/s."""
    start_offset: Knots = (-0.15, 0.15)
    """Of the ego's start from the middle of its lane [m]."""
    goal_in_junction: float | Literal["at start speed"] = 0.25
    """Probability that the goal is the junction itself instead of the arm behind it; or it is the one of the two where
    the ego would be in time at its start speed."""
    pace: Knots = (4.5, 8.0)
    """Mean speed [m/s] from the start to the middle of the goal's region, which decides when to be there."""
    goal_steps: tuple[int, int] | None = None
    """First and last step of the goal, in place of what the pace says."""
    goal_window: int = 5
    """How many steps before and after that time the goal can be reached."""
    streams: tuple[Stream, ...] = ()
    """The traffic."""
    vehicle_types: tuple[VehicleType, ...] = ()
    """What drives there."""
    separation: float = 0.0
    """Least time between the arrivals of two streams' first vehicles [s]; the one of the later stream moves."""
    density: float = 0.7
    """Difficulty: probability that a vehicle of a stream is there."""
    gap: float = 1.0
    """Difficulty: factor on arrivals and spacings; the smaller, the tighter the gaps in oncoming traffic."""
    speed_spread: float = 0.1
    """Difficulty: standard deviation of the logarithm of a further factor on each vehicle's speed."""
    yielding: float = 0.7
    """Share of vehicles that let others go first where lanes meet."""
    slow_in_curves: bool = True
    """Whether vehicles slow down for curves."""
    pedestrians: int = 0
    """Most pedestrians, each of whom crosses one of the arms."""
    pedestrian_arrival: Knots = (-4.0, 4.0)
    """How much later than the ego would be in the middle of the junction they are in the middle of the road [s]."""
    walking_speed: Knots = (0.8, 1.8)
    """m/s."""

    def __post_init__(self) -> None:
        """Refuse what no scenario can be made of.

        Raises:
          ScenarioError: a value is impossible.
        """
        for name, low, high in (
            ("lane_width", 2.5, 6.0),
            ("turn_radius", 5.5, 30.0),
            ("bend", -0.6, 0.6),
            ("own_arm", 40.0, 300.0),
            ("exit_arm", 30.0, 300.0),
            ("other_arms", 40.0, 300.0),
            ("start_distance", NEAREST_START, 200.0),
            ("start_speed", 0.0, 20.0),
            ("start_offset", -0.5, 0.5),
            ("pace", 1.0, 20.0),
            ("pedestrian_arrival", -60.0, 60.0),
            ("walking_speed", 0.1, 5.0),
        ):
            check_knots(name, getattr(self, name), low, high)
        for name, low, high in (
            ("separation", 0.0, 20.0),
            ("density", 0.0, 1.0),
            ("gap", 0.1, 10.0),
            ("speed_spread", 0.0, 0.5),
            ("yielding", 0.0, 1.0),
            ("steps", 60, 1000),
            ("goal_window", 0, 50),
            ("pedestrians", 0, MAX_PEDESTRIANS),
        ):
            check_number(name, getattr(self, name), low, high)
        if self.start_time is not None:
            check_knots("start_time", self.start_time, 0.5, 60.0)
        if self.goal_in_junction != "at start speed":
            check_number("goal_in_junction", self.goal_in_junction, 0.0, 1.0)
        elif self.goal_steps is None:
            raise ScenarioError("goal_in_junction is 'at start speed' but goal_steps is None: give both")
        if self.goal_steps is not None and not 0 < self.goal_steps[0] <= self.goal_steps[1] < self.steps:
            raise ScenarioError(f"goal_steps is {self.goal_steps}: give two steps within 1 … {self.steps - 1}")
        if (count := sum(stream.vehicles for stream in self.streams)) > MAX_VEHICLES:
            raise ScenarioError(f"streams hold {count} vehicles: give at most {MAX_VEHICLES} altogether")
        if self.streams and not self.vehicle_types:
            raise ScenarioError("vehicle_types is empty: name what drives in the streams")
        for stream in self.streams:
            _check_stream(stream)

    @property
    def farthest_start(self) -> float:
        """Largest distance from the ego's start to the junction [m]."""
        if self.start_time is None:
            return self.start_distance[-1]
        return max(self.start_time[-1] * self.start_speed[-1], NEAREST_START)

    @property
    def path_nodes(self) -> int:
        """Nodes that are enough for every path."""
        goal = LONGEST_CURVE + self.exit_arm[-1]
        first = self.goal_steps[1] if self.goal_steps is not None else self.steps - 2 - self.goal_window
        pace = 0.0 if self.goal_steps is not None else 2.0 * self.pace[-1]
        speed = max(self.start_speed[-1], (self.farthest_start + goal) / (jf.DT * first), pace)
        return path_capacity(self.farthest_start, goal, speed)


def _check_stream(stream: Stream) -> None:
    name = f"stream from {stream.origin}"
    if stream.origin not in ROLES or stream.destination not in (*ROLES, "any") or stream.origin == stream.destination:
        raise ScenarioError(f"{name} to {stream.destination}: give two different ones of {', '.join(ROLES)}")
    if stream.vehicles < 1:
        raise ScenarioError(f"{name} has {stream.vehicles} vehicles: give at least 1")
    if stream.arrival != "behind the ego":
        check_knots(f"{name}: arrival", stream.arrival, -60.0, 60.0)
    check_knots(f"{name}: speed", stream.speed, 0.0, 40.0)
    if stream.distance is not None:
        check_knots(f"{name}: distance", stream.distance, 5.0, 300.0)
    check_knots(f"{name}: spacing", stream.spacing, 4.0, 200.0)
    check_knots(f"{name}: follower_speed", stream.follower_speed, 0.0, 3.0)


@pytree_dataclass
class Ego:
    """The ego's start and where it goes."""

    roles: Int[Array, "arms"]
    """`[arms]`, the junction's arm for each of `ROLES`."""
    route: Line
    arc_length: Float[Array, ""]
    """m, of its centre on the route."""
    offset: Float[Array, ""]
    """m, of its centre from the route."""
    speed: Float[Array, ""]
    """m/s."""
    arrives: Float[Array, ""]
    """s, when it would be in the middle of the junction at constant speed."""


def role_table(arms: int, routes: tuple[tuple[int, int], ...]) -> np.ndarray:
    """For each route (first arm, second arm) the arms in the order of `ROLES`: `[routes, arms]`."""
    rest = [[(own + i) % arms for i in range(1, arms) if (own + i) % arms != leaves] for own, leaves in routes]
    return np.array([[*route, *others] for route, others in zip(routes, rest, strict=True)], np.int32)


def draw_junction(dice: Dice, task: JunctionTask, angle: Array, roles: Array, distance: Array) -> Junction:
    """A junction whose arms have these directions [rad], long enough for the ego's start at `distance` [m] from it."""
    arms = angle.shape[0]
    own = jnp.maximum(dice.draw(task.own_arm), distance + 20.0)
    lengths = jnp.concatenate([own[None], dice.draw(task.exit_arm, (1,)), dice.draw(task.other_arms, (arms - 2,))])
    return Junction(
        angle=angle,
        bend=dice.draw(task.bend, (arms,)),
        arm_length=jnp.zeros(arms).at[roles].set(lengths),
        turn_radius=dice.draw(task.turn_radius),
        lane_width=dice.draw(task.lane_width),
    )


def draw_scenario(dice: Dice, task: JunctionTask, angle: Array, roles: Array) -> tuple[jf.Scenario, LaneletMap]:
    """A scenario at a junction whose arms have these directions [rad], and its map.

    Args:
      dice: with enough numbers left.
      task: what is drawn.
      angle: `[arms]`, counter-clockwise.
      roles: `[arms]`, int, the ego's own arm, the one it leaves by, and the rest.
    """
    distance, speed = dice.draw(task.start_distance), dice.draw(task.start_speed)
    if task.start_time is not None:
        distance = dice.draw(task.start_time) * speed
    junction = draw_junction(dice, task, angle, roles, distance)
    lines = junction_lines(junction)
    own, leaves = roles[0], roles[1]
    route = jax.tree.map(lambda leaf: leaf[own, leaves], lines.lanes)
    enters, exits = lines.enters[own, leaves], lines.leaves[own, leaves]
    middle = 0.5 * (enters + exits)
    if task.start_time is not None:
        distance = jnp.maximum(distance - (middle - enters), NEAREST_START)
    ego = Ego(
        roles=roles,
        route=route,
        arc_length=enters - distance,
        offset=dice.draw(task.start_offset),
        speed=speed,
        arrives=(middle - enters + distance) / jnp.maximum(speed, 0.5),
    )
    agents, window, origin, destination = draw_vehicles(dice, task, lines, ego)
    if task.pedestrians:
        walkers, ways = draw_pedestrians(dice, task, lines, junction.lane_width, ego)
        agents = jax.tree.map(lambda *parts: jnp.concatenate(parts), agents, walkers)
        window = jnp.concatenate([window, ways])
        nobody = -1 - jnp.arange(task.pedestrians)
        origin, destination = jnp.concatenate([origin, nobody]), jnp.concatenate([destination, nobody])
    relations = _relations(agents, origin, destination, window)
    positions, speeds = drive(agents, relations, task.steps, task.slow_in_curves)

    at = look_up(route, ego.arc_length)
    center = jnp.stack([at.x - ego.offset * jnp.sin(at.heading), at.y + ego.offset * jnp.cos(at.heading)])
    heading = dice.draw((-np.pi, np.pi))
    turn = heading - at.heading
    frame = center, turn
    seen = replace(agents, line=moved(agents.line, *frame))
    ego_box = Box.from_heading(
        jnp.zeros(()), jnp.zeros(()), heading, jnp.float32(jf.BMW_320I.length), jnp.float32(jf.BMW_320I.width)
    )
    lanelets = _lanelets(lines, junction.lane_width)
    lanelets = [(moved_points(left, *frame), moved_points(right, *frame)) for left, right in lanelets]
    if task.goal_in_junction == "at start speed":
        in_junction = speed * _goal_time(task) < exits - ego.arc_length
    else:
        in_junction = dice.uniform() < task.goal_in_junction
    is_goal, goal_ring = _goal_lanelet(lanelets, roles, in_junction)
    goal_arc = jnp.where(in_junction, jnp.stack([enters, exits]), jnp.stack([exits, route.arc_length[-1]]))
    steps, pace = _goal_steps(dice, task, 0.5 * jnp.sum(goal_arc) - ego.arc_length)
    world = World(
        route=moved(route, *frame),
        ego_arc_length=ego.arc_length,
        goal_arc_length=goal_arc,
        goal_ring=goal_ring,
        goal_steps=steps,
        goal_speed=jnp.stack([jnp.minimum(speed, pace) - 8.0, jnp.maximum(speed, pace) + 5.0]),
        road_ring=moved_points(road_ring(lines, junction.lane_width), *frame),
        obstacles=as_obstacles(seen, positions, speeds, ego_box),
        initial_state=start_of(heading, speed, at.curvature),
    )
    left, right = (tuple(borders[side] for borders in lanelets) for side in range(2))
    scenario = assemble(world, lambda along: _two_lanes(along, junction.lane_width), task.path_nodes, NEARBY)
    return scenario, LaneletMap(left=left, right=right, is_goal=is_goal)


def _goal_time(task: JunctionTask) -> float:
    """The middle of fixed goal steps [s]."""
    assert task.goal_steps is not None
    return 0.5 * jf.DT * sum(task.goal_steps)


def _goal_steps(dice: Dice, task: JunctionTask, distance: Array) -> tuple[Array, Array]:
    """First and last step of the goal, and the mean speed [m/s] at which its middle is reached in time."""
    if task.goal_steps is not None:
        return jnp.asarray(task.goal_steps, jnp.int32), distance / _goal_time(task)
    return goal_interval(distance, dice.draw(task.pace), task.goal_window, task.steps)


def _two_lanes(along: Array, width: Array) -> jf.Lanes:
    """The ego's lane and the oncoming one to its left, all along its route."""
    everywhere = jnp.ones_like(along)[:, None]
    return jf.Lanes(
        center=everywhere * jnp.stack([0.0 * width, width, 0.0 * width]),
        width=everywhere * jnp.stack([width, width, 0.0 * width]),
        direction=everywhere.astype(jnp.int32) * jnp.asarray([1, -1, 0], jnp.int32),
    )


def draw_vehicles(dice: Dice, task: JunctionTask, lines: JunctionLines, ego: Ego) -> tuple[Agents, Array, Array, Array]:
    """The streams' vehicles at step 0.

    Returns:
      The vehicles, where each is inside the junction `[vehicles, 2]` [m], and the arms it comes from and leaves by.
    """
    count = sum(stream.vehicles for stream in task.streams)
    kind, length, width, top_speed = draw_types(dice, task.vehicle_types, count)
    noise = jnp.exp(task.speed_spread * dice.normal((count,)))
    is_there = dice.uniform((count,)) < task.density
    yields = dice.uniform((count,)) < task.yielding
    arms = ego.roles.shape[0]
    place, speeds, origins, destinations, expected = [], [], [], [], []
    arrivals: list[Array] = []
    for stream in task.streams:
        first = len(place)
        origin = ego.roles[ROLES.index(stream.origin)]
        spacing = task.gap * dice.draw(stream.spacing, (stream.vehicles,))
        factor = dice.draw(stream.follower_speed, (stream.vehicles,))
        first_speed = dice.draw(stream.speed)
        exits_by = dice.uniform((stream.vehicles,))
        for index in range(stream.vehicles):
            me = first + index
            destination = _destination(exits_by[index], stream, ego.roles, arms)
            enters, exits = lines.enters[origin, destination], lines.leaves[origin, destination]
            middle, half = 0.5 * (enters + exits), 0.5 * length[me]
            if index > 0 or stream.arrival == "behind the ego":
                ahead = place[-1] if index else ego.arc_length
                ahead_half = 0.5 * length[me - 1] if index else jnp.float32(0.5 * jf.BMW_320I.length)
                speed = speeds[-1] * factor[index] if index else first_speed * ego.speed
                at = ahead - jnp.maximum(spacing[index], half + ahead_half + 1.5)
                earliest = expected[-1] + 1.0 if index else ego.arrives
            else:
                wished = task.gap * dice.draw(stream.arrival)
                wished = jnp.where(ego.arrives + wished < EARLIEST_ARRIVAL, jnp.abs(wished), wished)
                arrivals.append(_separated(wished, arrivals, task.separation))
                arrives = jnp.maximum(ego.arrives + arrivals[-1], EARLIEST_ARRIVAL)
                earliest = -jnp.inf
                behind = jnp.sum(spacing[1:])
                room = middle - half - 1.0 - behind
                if stream.distance is None:
                    speed = jnp.minimum(first_speed * noise[me], room / arrives)
                else:
                    speed = jnp.minimum(dice.draw(stream.distance), room) / arrives
                speed = jnp.minimum(speed, top_speed[me])
                at = jnp.minimum(middle - speed * arrives, enters - half - 1.0)
                if stream.origin == "own":
                    at = jnp.maximum(at, ego.arc_length + spacing[index])
            if index > 0:
                speed = speed * noise[me]
                if not stream.followers_arrive:
                    speed = jnp.minimum(speed, (middle - NOT_ARRIVED - at) / (jf.DT * task.steps))
            speed = jnp.clip(speed, 0.0, top_speed[me])
            place.append(at)
            speeds.append(speed)
            origins.append(origin)
            destinations.append(destination)
            expected.append(jnp.maximum((middle - at) / jnp.maximum(speed, 0.5), earliest))
    at, speed = jnp.stack(place), jnp.stack(speeds)
    origin, destination = jnp.stack(origins), jnp.stack(destinations)
    enters, exits = lines.enters[origin, destination], lines.leaves[origin, destination]
    agents = Agents(
        line=jax.tree.map(lambda leaf: leaf[origin, destination], lines.lanes),
        arc_length=at,
        speed=speed,
        desired_speed=speed,
        length=length,
        width=width,
        kind=kind,
        exists=is_there & (at > 0.5 * length) & (at < enters - 0.5 * length + 1e-3),
        rank=jnp.stack(expected) + jnp.where(yields, 0.0, FIRST_ANYWAY),
        yields=yields,
    )
    return agents, jnp.stack([enters, exits], axis=-1), origin, destination


def draw_pedestrians(
    dice: Dice, task: JunctionTask, lines: JunctionLines, lane_width: Array, ego: Ego
) -> tuple[Agents, Array]:
    """Pedestrians at step 0 on straight ways across the arms, and where on these they are `[pedestrians, 2]` [m]."""
    shape = (task.pedestrians,)
    arm = dice.choose((1.0,) * ego.roles.shape[0], shape)
    outside, leftwards = dice.draw(CROSSWALK, shape), dice.uniform(shape) < 0.5
    speed, exists = dice.draw(task.walking_speed, shape), dice.uniform(shape) < task.density
    arrives = jnp.maximum(ego.arrives + dice.draw(task.pedestrian_arrival, shape), 0.0)
    at = jax.vmap(lambda arm, outside: look_up(jax.tree.map(lambda leaf: leaf[arm], lines.arms), outside))(arm, outside)
    heading = at.heading + jnp.where(leftwards, 0.5, -0.5) * jnp.pi
    length = 2.0 * (lane_width + CURB)
    along = jnp.linspace(0.0, length, lines.lanes.x.shape[-1])
    cos, sin = jnp.cos(heading)[:, None], jnp.sin(heading)[:, None]
    still = jnp.zeros((*shape, along.shape[0]))
    way = Line(
        arc_length=still + along,
        x=at.x[:, None] + (along - 0.5 * length) * cos,
        y=at.y[:, None] + (along - 0.5 * length) * sin,
        heading=still + heading[:, None],
        curvature=still,
        curvature_derivative=still,
    )
    size = jnp.full(shape, PEDESTRIAN_SIZE)
    walkers = Agents(
        line=way,
        arc_length=0.5 * length - speed * arrives,
        speed=speed,
        desired_speed=speed,
        length=size,
        width=size,
        kind=jnp.full(shape, jf.ObstacleKind.PEDESTRIAN, jnp.int32),
        exists=exists,
        rank=jnp.full(shape, FIRST_OF_ALL),
        yields=jnp.zeros(shape, bool),
    )
    return walkers, jnp.broadcast_to(jnp.stack([0.0 * length, length]), (*shape, 2))


def _separated(arrival: Array, others: list[Array], separation: float) -> Array:
    """An arrival [s] relative to the ego's, moved away from it until it is apart from the others."""
    for other in others:
        near = jnp.abs(arrival - other) < separation
        arrival = jnp.where(near, other + jnp.where(arrival < 0.0, -separation, separation), arrival)
    return arrival


def _destination(share: Array, stream: Stream, roles: Array, arms: int) -> Array:
    """The arm that a vehicle of a stream leaves by."""
    if stream.destination != "any":
        return roles[ROLES.index(stream.destination)]
    others = [index for index in range(arms) if ROLES[index] != stream.origin]
    return roles[jnp.asarray(others)[(share * len(others)).astype(jnp.int32)]]


def _relations(agents: Agents, origin: Array, destination: Array, inside: Array) -> Relations:
    """Who comes from one arm follows until the lanes part; who leaves by one arm from where they meet."""
    window = inside + jnp.asarray([-7.0, 7.0])
    meets = meeting_places(agents.line, agents.width, window, 48)
    of_leader = jnp.swapaxes(meets, 0, 1)
    same_start, same_end = origin[:, None] == origin[None, :], destination[:, None] == destination[None, :]
    nowhere, always = jnp.asarray([jnp.inf, -jnp.inf]), jnp.asarray([-jnp.inf, jnp.inf])
    until_parted, once_met = of_leader.at[..., 0].set(-jnp.inf), of_leader.at[..., 1].set(jnp.inf)
    shared = jnp.where(same_end[..., None], once_met, nowhere)
    shared = jnp.where(same_start[..., None], until_parted, shared)
    shared = jnp.where((same_start & same_end)[..., None], always, shared)
    shift = jnp.where(same_end & ~same_start, inside[:, None, 1] - inside[None, :, 1], 0.0)
    return Relations(shift=shift, shared=shared, meets=jnp.where(same_start[..., None], nowhere, meets))


def lanelet_links(arms: int) -> tuple[LaneletLinks, ...]:
    """How the lanelets of a junction hang together: inwards and outwards per arm, then one per pair of arms."""
    pairs = _pairs(arms)
    through = {pair: 2 * arms + index for index, pair in enumerate(pairs)}
    links = []
    for arm in range(arms):
        into = tuple(through[pair] for pair in pairs if pair[0] == arm)
        links += [LaneletLinks(into, left=2 * arm + 1), LaneletLinks((), left=2 * arm)]
    return (*links, *(LaneletLinks((2 * second + 1,), left=through[second, first]) for first, second in pairs))


def _pairs(arms: int) -> list[tuple[int, int]]:
    return [(first, second) for first in range(arms) for second in range(arms) if first != second]


def _lanelets(lines: JunctionLines, lane_width: Array) -> list[tuple[Array, Array]]:
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


def _goal_lanelet(lanelets: list[tuple[Array, Array]], roles: Array, in_junction: Array) -> tuple[Array, Array]:
    """Which lanelet is the goal `[lanelets]`, and the ring around it."""
    arms = roles.shape[0]
    own, leaves = roles[0], roles[1]
    through = 2 * arms + own * (arms - 1) + leaves - (leaves > own).astype(jnp.int32)
    goal = jnp.where(in_junction, through, 2 * leaves + 1)
    left, right = (jnp.stack([borders[side] for borders in lanelets])[goal] for side in range(2))
    return jnp.arange(len(lanelets)) == goal, jnp.concatenate([right, left[::-1]])
