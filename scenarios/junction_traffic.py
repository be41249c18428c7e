"""The traffic at a junction: columns of vehicles on its lanes, and pedestrians across its arms."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from scenarios.distributions import Dice
from scenarios.junction import JunctionLines
from scenarios.junction_task import ROLES, JunctionTask, Stream
from scenarios.lines import Line, look_up
from scenarios.traffic import Agents, Relations, meeting_places
from scenarios.vehicle_types import draw_types

CROSSWALK = (2.0, 4.0)
"""How far outside the junction pedestrians cross an arm [m]."""
CURB = 2.0
"""How far from the road's edge pedestrians are out of the way [m]."""
PEDESTRIAN_SIZE = 0.6
"""Length and width of a pedestrian's box [m]."""
NOT_ARRIVED = 8.0
"""Who does not come to the middle of the junction stays this far from it [m]."""
EARLIEST_ARRIVAL = 2.5
"""Who would have to be in the middle of the junction earlier than this [s] comes as much later than the ego instead."""
LEAST_SPEED = 0.75
"""Who would have to be slower than this share of its stream's lowest speed to arrive late enough comes earlier."""
LEAST_SPACE = 1.5
"""Between one vehicle and the next of a column [m]."""
LOOK_OUT = 7.0
"""How far around the junction lines are looked at to see where they meet [m]."""
FIRST_ANYWAY = -1e3
"""Added to the rank of those who do not yield."""
FIRST_OF_ALL = -1e4
"""Rank of pedestrians."""


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


class Placed(NamedTuple):
    """One vehicle at step 0."""

    at: Array
    """m, arc length on its lane."""
    speed: Array
    """m/s."""
    origin: Array
    """The arm it comes from."""
    destination: Array
    """The arm it leaves by."""
    expected: Array
    """s, when it can be expected in the middle of the junction."""


class Body(NamedTuple):
    """What a vehicle is, whatever it does."""

    length: Array
    """m."""
    top_speed: Array
    """m/s."""
    noise: Array
    """Factor on its speed."""


def draw_traffic(
    dice: Dice, task: JunctionTask, lines: JunctionLines, lane_width: Array, ego: Ego
) -> tuple[Agents, Relations]:
    """Everybody at step 0, and how their lines lie to each other."""
    agents, inside, origin, destination = draw_vehicles(dice, task, lines, ego)
    if task.pedestrians:
        walkers, on_the_road = draw_pedestrians(dice, task, lines, lane_width, ego)
        agents = jax.tree.map(lambda *parts: jnp.concatenate(parts), agents, walkers)
        inside = jnp.concatenate([inside, on_the_road])
        nowhere = -1 - jnp.arange(task.pedestrians)
        origin, destination = jnp.concatenate([origin, nowhere]), jnp.concatenate([destination, nowhere])
    return agents, _relations(agents, origin, destination, inside)


def draw_vehicles(dice: Dice, task: JunctionTask, lines: JunctionLines, ego: Ego) -> tuple[Agents, Array, Array, Array]:
    """The streams' vehicles at step 0.

    Returns:
      The vehicles, where each is inside the junction `[vehicles, 2]` [m], and the arms it comes from and leaves by.
    """
    count = sum(stream.vehicles for stream in task.streams)
    kind, length, width, top_speed = draw_types(dice, task.vehicle_types, count)
    noise = jnp.exp(task.speed_spread * dice.normal((count,)))
    is_there = dice.uniform((count,)) < task.density
    may_yield = np.repeat([not stream.goes_first for stream in task.streams], [one.vehicles for one in task.streams])
    yields = (dice.uniform((count,)) < task.yielding) & may_yield
    bodies = [Body(length[index], top_speed[index], noise[index]) for index in range(count)]
    placed: list[Placed] = []
    arrivals: list[Array] = []
    for stream in task.streams:
        first = len(placed)
        placed += _column(dice, task, lines, ego, stream, bodies[first : first + stream.vehicles], arrivals)
    at, speed, origin, destination, expected = (jnp.stack(values) for values in zip(*placed, strict=True))
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
        rank=expected + jnp.where(yields, 0.0, FIRST_ANYWAY),
        yields=yields,
    )
    return agents, jnp.stack([enters, exits], axis=-1), origin, destination


def _column(
    dice: Dice,
    task: JunctionTask,
    lines: JunctionLines,
    ego: Ego,
    stream: Stream,
    bodies: list[Body],
    arrivals: list[Array],
) -> list[Placed]:
    """The vehicles of one stream; `arrivals` [s] of the streams before it, relative to the ego's, gets this one's."""
    origin = ego.roles[ROLES.index(stream.origin)]
    spacing = task.gap * dice.draw(stream.spacing, (stream.vehicles,))
    factor = dice.draw(stream.follower_speed, (stream.vehicles,))
    first_speed = dice.draw(stream.speed)
    exits_by = dice.uniform((stream.vehicles,))
    placed: list[Placed] = []
    for index, body in enumerate(bodies):
        destination = _destination(exits_by[index], stream, ego.roles)
        middle = 0.5 * (lines.enters[origin, destination] + lines.leaves[origin, destination])
        if placed:
            ahead, space = placed[-1], _space(body, bodies[index - 1].length, spacing[index])
            at, speed = ahead.at - space, ahead.speed * factor[index] * body.noise
            if not stream.followers_arrive:
                speed = jnp.minimum(speed, (middle - NOT_ARRIVED - at) / (jf.DT * task.steps))
            earliest = ahead.expected + 1.0
        elif stream.arrival == "behind the ego":
            at = ego.arc_length - _space(body, jnp.float32(jf.BMW_320I.length), spacing[index])
            speed, earliest = first_speed * ego.speed, ego.arrives
        else:
            arrivals.append(_arrival(dice, task, stream, ego, arrivals))
            arrives = jnp.maximum(ego.arrives + arrivals[-1], EARLIEST_ARRIVAL)
            room = middle - 0.5 * body.length - 1.0 - jnp.sum(spacing[1:])
            if stream.distance is None:
                slowest = jnp.maximum(room / arrives, LEAST_SPEED * stream.speed[0])
                speed = jnp.minimum(jnp.minimum(first_speed * body.noise, slowest), body.top_speed)
            else:
                speed = jnp.minimum(jnp.minimum(dice.draw(stream.distance), room) / arrives, body.top_speed)
            at = jnp.maximum(middle - speed * arrives, middle - room)
            at = jnp.minimum(at, lines.enters[origin, destination] - 0.5 * body.length - 1.0)
            if stream.origin == "own":
                at = jnp.maximum(at, ego.arc_length + spacing[index])
            earliest = jnp.float32(0.0)
        speed = jnp.clip(speed, 0.0, body.top_speed)
        expected = jnp.maximum((middle - at) / jnp.maximum(speed, 0.5), earliest)
        placed.append(Placed(at, speed, origin, destination, expected))
    return placed


def _space(body: Body, length_ahead: Array, spacing: Array) -> Array:
    """Distance between the centres of a vehicle and the one ahead [m]."""
    return jnp.maximum(spacing, 0.5 * (body.length + length_ahead) + LEAST_SPACE)


def _arrival(dice: Dice, task: JunctionTask, stream: Stream, ego: Ego, others: list[Array]) -> Array:
    """When a column arrives in the middle of the junction [s], relative to the ego, apart from the others."""
    arrival = task.gap * dice.draw(stream.arrival)  # pyright: ignore[reportArgumentType]
    arrival = jnp.where(ego.arrives + arrival < EARLIEST_ARRIVAL, jnp.abs(arrival), arrival)
    for other in others:
        moved = other + jnp.where(arrival < 0.0, -task.separation, task.separation)
        arrival = jnp.where(jnp.abs(arrival - other) < task.separation, moved, arrival)
    return arrival


def _destination(share: Array, stream: Stream, roles: Array) -> Array:
    """The arm that a vehicle of a stream leaves by; where any will do, a `share` in [0, 1) chooses."""
    if stream.destination != "any":
        return roles[ROLES.index(stream.destination)]
    others = [index for index in range(roles.shape[0]) if ROLES[index] != stream.origin]
    return roles[jnp.asarray(others)[(share * len(others)).astype(jnp.int32)]]


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


def _relations(agents: Agents, origin: Array, destination: Array, inside: Array) -> Relations:
    """Who comes from one arm follows until the lanes part; who leaves by one arm from where they meet."""
    window = inside + jnp.asarray([-LOOK_OUT, LOOK_OUT])
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
