"""Traffic that drives along lines: car-following, right of way, and nobody through anybody.

Everybody follows their line; speed follows the Intelligent Driver Model (IDM; Treiber, Hennecke and Helbing 2000,
"Congested traffic states in empirical observations and microscopic simulations", equations 1 to 4). Who has to yield
treats the place where two lines meet as an obstacle that stands there until the other one has passed. Who still
overlaps another one, by the exact test, is left out.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.collision import Box, boxes_overlap
from jaxfrenet.config import DT
from jaxfrenet.scenario import ObstacleKind, Obstacles
from scenarios.lines import Line, look_up

MAX_ACCELERATION = 1.5
"""IDM's a [m/s²]."""
COMFORTABLE_DECELERATION = 2.0
"""IDM's b [m/s²]."""
TIME_HEADWAY = 1.2
"""IDM's T [s]."""
STANDSTILL_GAP = 2.0
"""IDM's s0 [m]."""
HARDEST_BRAKING = 8.0
"""No deceleration beyond this [m/s²]."""
HARD_TO_STOP = 6.0
"""Who would have to brake harder than this [m/s²] to yield drives on."""
LATERAL_ACCELERATION = 3.0
"""Curves are taken at no more than this [m/s²]."""
CLEARANCE = 0.5
"""Lines meet where boxes on them come nearer to each other than this [m]."""
TIME_MARGIN = 1.0
"""Who yields stays away for this long [s] after the other one."""
SPACE_BETWEEN = 0.2
"""Least distance [m] at which boxes count as apart."""


@pytree_dataclass
class Agents:
    """Who takes part, at step 0; the leading axis of every field is `agents`."""

    line: Line
    """`[agents, nodes]`, the line that each follows with its centre."""
    arc_length: Float[Array, "agents"]
    """`[agents]`, m, where on it."""
    speed: Float[Array, "agents"]
    """`[agents]`, m/s."""
    desired_speed: Float[Array, "agents"]
    """`[agents]`, m/s, where nothing is in the way."""
    length: Float[Array, "agents"]
    """`[agents]`, m."""
    width: Float[Array, "agents"]
    """`[agents]`, m."""
    kind: Int[Array, "agents"]
    """`[agents]`, an `ObstacleKind`."""
    exists: Bool[Array, "agents"]
    """`[agents]`."""
    rank: Float[Array, "agents"]
    """`[agents]`, who has the smaller one goes first where lines meet."""
    yields: Bool[Array, "agents"]
    """`[agents]`, whether it lets those with a smaller rank go first; everybody lets pedestrians."""


@pytree_dataclass
class Relations:
    """How the lines of each two agents lie to each other; `[follower, leader]`."""

    shift: Float[Array, "agents agents"]
    """m, what to add to the leader's arc length to have it on the follower's line."""
    shared: Float[Array, "agents agents 2"]
    """m, between which of the leader's arc lengths it is in the follower's way, as one ahead in the same lane."""
    meets: Float[Array, "agents agents 2"]
    """m, between which of the follower's own arc lengths its line and the leader's meet; empty (inf, -inf) if nowhere,
    or where one follows the other instead."""


def comfortable_speed(line: Line, desired_speed: Array) -> Float[Array, "nodes"]:
    """Speed [m/s] at each node of a line that slows down in time for its curves."""
    curve = jnp.sqrt(LATERAL_ACCELERATION / jnp.maximum(jnp.abs(line.curvature), 1e-4))
    energy = jnp.minimum(curve, desired_speed) ** 2 + 2.0 * COMFORTABLE_DECELERATION * line.arc_length
    ahead = jax.lax.cummin(energy, axis=0, reverse=True)
    return jnp.sqrt(jnp.maximum(ahead - 2.0 * COMFORTABLE_DECELERATION * line.arc_length, 1e-2))


def drive(agents: Agents, relations: Relations, steps: int, slow_in_curves: bool) -> tuple[Array, Array]:
    """Arc lengths [m] and speeds [m/s] `[steps, agents]`, from step 0 on.

    Args:
      agents: at step 0.
      relations: between their lines.
      steps: how many, of 0.1 s.
      slow_in_curves: whether curves are taken at a comfortable speed.
    """
    limits = jax.vmap(comfortable_speed)(agents.line, agents.desired_speed)
    end = agents.line.arc_length[:, -1]
    both = agents.exists[:, None] & agents.exists[None, :] & ~jnp.eye(len(end), dtype=bool)
    walks = agents.kind == ObstacleKind.PEDESTRIAN
    goes_first = both & (agents.yields[:, None] | walks[None, :]) & (agents.rank[None, :] < agents.rank[:, None])
    own, others = relations.meets, jnp.swapaxes(relations.meets, 0, 1)
    reach = 0.5 * (agents.length[:, None] + agents.length[None, :])

    def gap_term(speed: Array, leader_speed: Array, gap: Array) -> Array:
        """IDM's (s* / s)²."""
        approach = speed * (speed - leader_speed) / (2.0 * (MAX_ACCELERATION * COMFORTABLE_DECELERATION) ** 0.5)
        wanted = STANDSTILL_GAP + jnp.maximum(speed * TIME_HEADWAY + approach, 0.0)
        return (wanted / jnp.maximum(gap, 0.1)) ** 2

    def advance(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        position, speed = carry
        here = position < end
        ahead = position[None, :] + relations.shift - position[:, None]
        inside = (position >= relations.shared[..., 0]) & (position <= relations.shared[..., 1])
        leads = both & here[None, :] & inside & (ahead > 0.0)
        follow = jnp.where(leads, gap_term(speed[:, None], speed[None, :], ahead - reach), 0.0)
        stop = own[..., 0] - 0.5 * agents.length[:, None] - position[:, None]
        cleared = others[..., 1] + 0.5 * agents.length - position
        arrives = jnp.maximum(stop, 0.0) / jnp.maximum(speed[:, None], 0.5)
        clears = cleared / jnp.maximum(speed, 0.5)
        can_stop = speed[:, None] ** 2 <= 2.0 * HARD_TO_STOP * jnp.maximum(stop, 0.0)
        waits = goes_first & here & (cleared > 0.0) & (stop > 0.0) & can_stop & (clears + TIME_MARGIN > arrives)
        wait = jnp.where(waits, gap_term(speed[:, None], jnp.zeros_like(speed), stop + STANDSTILL_GAP), 0.0)
        obstacle = jnp.max(jnp.maximum(follow, wait), axis=1)
        free = agents.desired_speed
        if slow_in_curves:
            free = jnp.minimum(free, jax.vmap(jnp.interp)(position, agents.line.arc_length, limits))
        acceleration = MAX_ACCELERATION * (1.0 - (speed / jnp.maximum(free, 0.1)) ** 4 - obstacle)
        acceleration = jnp.clip(acceleration, -HARDEST_BRAKING, MAX_ACCELERATION)
        faster = jnp.maximum(speed + DT * acceleration, 0.0)
        return (position + 0.5 * DT * (speed + faster), faster), (position, speed)

    _, (positions, speeds) = jax.lax.scan(advance, (agents.arc_length, agents.speed), None, length=steps)
    return positions, speeds


def as_obstacles(
    agents: Agents, arc_length: Float[Array, "steps agents"], speed: Float[Array, "steps agents"], ego: Box
) -> Obstacles:
    """The agents' boxes over time, those that exist first; nobody overlaps anybody else at any step.

    Of two that would overlap the later one is left out, as is who overlaps the ego at step 0.

    Args:
      agents: who, at step 0.
      arc_length: where on their lines [m].
      speed: how fast [m/s].
      ego: where the ego starts.
    """
    poses = jax.vmap(look_up)(agents.line, arc_length.T)
    half = 0.5 * agents.length[:, None]
    on_line = (arc_length.T + half <= agents.line.arc_length[:, -1:]) & agents.exists[:, None]
    heading = poses.heading - 2 * jnp.pi * jnp.round(poses.heading / (2 * jnp.pi))
    size = agents.length[:, None] + SPACE_BETWEEN, agents.width[:, None] + SPACE_BETWEEN
    boxes = Box.from_heading(poses.x, poses.y, heading, *size)
    crash = jax.vmap(jax.vmap(_ever_overlap, (None, None, 0, 0)), (0, 0, None, None))(boxes, on_line, boxes, on_line)
    at_start = Box.from_heading(poses.x[:, 0], poses.y[:, 0], heading[:, 0], *(one[:, 0] for one in size))
    stays = agents.exists & ~boxes_overlap(at_start, ego)
    count = len(agents.length)
    kept = jnp.zeros(count, bool)
    for index in range(count):
        kept = kept.at[index].set(stays[index] & ~jnp.any(crash[index] & kept))
    exists = kept
    order = jnp.argsort(~exists, stable=True)
    valid = (on_line & exists[:, None])[order]

    def sorted_or(values: Array, otherwise: float | int) -> Array:
        mask = valid if values.ndim == 2 else exists[order]
        return jnp.where(mask, values[order], jnp.asarray(otherwise, values.dtype))

    return Obstacles(
        position=jnp.stack([sorted_or(poses.x, 0.0), sorted_or(poses.y, 0.0)], axis=-1),
        heading=sorted_or(heading, 0.0),
        speed=sorted_or(speed.T, 0.0),
        valid=valid,
        length=sorted_or(agents.length, 1.0),
        width=sorted_or(agents.width, 1.0),
        kind=sorted_or(agents.kind, 0),
        static=jnp.zeros(count, bool),
    )


def _ever_overlap(first: Box, first_there: Array, second: Box, second_there: Array) -> Array:
    """Whether two boxes over time, `[steps]`, overlap at any step at which both are there."""
    return jnp.any(boxes_overlap(first, second) & first_there & second_there)


def meeting_places(
    line: Line, width: Float[Array, "agents"], window: Float[Array, "agents 2"], samples: int
) -> Float[Array, "agents agents 2"]:
    """Where each line comes near each other one, within a window of its own arc lengths: `[line, other, 2]`, m.

    Args:
      line: `[agents, nodes]`.
      width: of who drives there [m].
      window: between which arc lengths [m] to look.
      samples: how many places of each window to look at.

    Returns:
      First and last arc length on `line`; (inf, -inf) where the two do not come near.
    """
    share = jnp.linspace(0.0, 1.0, samples)
    along = window[:, :1] + share * (window[:, 1:] - window[:, :1])
    points = jax.vmap(look_up)(line, along).points
    x, y = points[..., 0], points[..., 1]
    distance = (x[:, None, :, None] - x[None, :, None, :]) ** 2 + (y[:, None, :, None] - y[None, :, None, :]) ** 2
    near = 0.5 * (width[:, None] + width[None, :]) + CLEARANCE
    close = jnp.min(distance, axis=-1) < (near**2)[..., None]
    first = jnp.min(jnp.where(close, along[:, None, :], jnp.inf), axis=-1)
    last = jnp.max(jnp.where(close, along[:, None, :], -jnp.inf), axis=-1)
    return jnp.stack([first, last], axis=-1)
