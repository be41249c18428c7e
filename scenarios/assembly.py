"""From a generated world to the arrays that the planner reads, in fixed shapes and by the importer's rules."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from jaxfrenet.collision import Box
from jaxfrenet.road import BIN_LENGTH, CORRIDOR, REACH
from scenarios.lines import Line, look_up
from scenarios.route_path import EXTENSION, SPACING

GOAL_GRID = 0.5
"""The goal's end is looked for in steps of this [m]."""
EARLIEST_GOAL = 40
"""No goal's time has its middle before this step."""


@pytree_dataclass
class World:
    """A scenario in the ego's frame, before it is cut into tables."""

    route: Line
    """The middle of the ego's lane, from the lane's first point on."""
    ego_arc_length: Float[Array, ""]
    """m, of the ego's centre on the route."""
    goal_arc_length: Float[Array, "2"]
    """m, where the route enters and leaves the goal's region."""
    goal_ring: Float[Array, "goal_corners 2"]
    """`[corners, 2]`, m, around the goal's region."""
    goal_steps: Int[Array, "2"]
    goal_speed: Float[Array, "2"]
    """m/s."""
    lane_map: jf.LaneMap
    road_ring: Float[Array, "corners 2"]
    """`[corners, 2]`, m, around the road, counter-clockwise."""
    obstacles: jf.Obstacles
    initial_state: jf.InitialState


def path_capacity(distance: float, goal_length: float, speed: float) -> int:
    """Nodes of a path to a goal region at most `distance` [m] ahead and `goal_length` [m] long, at most this fast."""
    return math.ceil((EXTENSION + distance + goal_length + max(EXTENSION, 3.0 * speed)) / SPACING) + 2


def assemble(world: World, lanes: Callable[[Array], jf.Lanes], nodes: int, nearby: int) -> jf.Scenario:
    """The scenario in fixed shapes.

    Args:
      world: what is in it.
      lanes: the ego's lane and its neighbours as a function of arc length on the route, `[nodes]`, m.
      nodes: of the path, see `path_capacity`.
      nearby: most road edge segments near one stretch of the path; the tests hold that there never are more.
    """
    path = _path(world, nodes)
    exists = (path.arc_length <= path.length)[:, None]
    along = lanes(path.arc_length + world.ego_arc_length - EXTENSION)
    enters, leaves = world.goal_arc_length - world.ego_arc_length + EXTENSION
    goal_ring = ring_edges(world.goal_ring)
    start = world.initial_state
    turns = jnp.round((path.heading[round(EXTENSION / SPACING)] - start.heading) / (2 * jnp.pi))
    return jf.Scenario(
        path=path,
        lanes=jax.tree.map(lambda leaf: jnp.where(exists, leaf, jnp.zeros((), leaf.dtype)), along),
        lane_map=world.lane_map,
        road=_road(world.road_ring, path, nearby),
        obstacles=world.obstacles,
        goal=jf.Goal(
            edges=goal_ring[None],
            edge_valid=jnp.ones((1, goal_ring.shape[0]), bool),
            has_position=jnp.ones(1, bool),
            steps=world.goal_steps[None],
            speed=world.goal_speed[None],
            has_speed=jnp.ones(1, bool),
            heading=jnp.asarray([[0.0, 4.0]]),
            arc_length=SPACING * jnp.stack([jnp.ceil(enters / SPACING), jnp.floor(leaves / SPACING)])[None],
            valid=jnp.ones(1, bool),
        ),
        initial_state=replace(start, heading=start.heading + 2 * jnp.pi * turns),
        origin=jnp.zeros(2),
    )


def goal_interval(distance: Array, speed: Array, window: int, steps: int) -> tuple[Array, Array]:
    """When to be at the goal: first and last step, and the mean speed [m/s] that it takes.

    Args:
      distance: to the middle of the goal's region [m].
      speed: mean speed that is wished for [m/s]; a time outside the record is moved into it.
      window: steps before and after.
      steps: recorded ones.
    """
    middle = jnp.clip(jnp.round(distance / speed / jf.DT).astype(jnp.int32), EARLIEST_GOAL, steps - 2 - window)
    return middle + jnp.asarray([-window, window], jnp.int32), distance / (jf.DT * middle.astype(jnp.float32))


def start_of(heading: Array, speed: Array, curvature: Array) -> jf.InitialState:
    """The ego in its own frame's origin, on a line of that curvature [1/m]."""
    return jf.InitialState(
        position=jnp.zeros(2), heading=heading, speed=speed, acceleration=jnp.zeros(()), yaw_rate=speed * curvature
    )


def ego_box(heading: Array) -> Box:
    """The ego's box at its start."""
    size = jnp.float32(jf.BMW_320I.length), jnp.float32(jf.BMW_320I.width)
    return Box.from_heading(jnp.zeros(()), jnp.zeros(()), heading, *size)


def ring_edges(ring: Float[Array, "corners 2"]) -> Float[Array, "corners 2 2"]:
    """A ring's edges `[edges, end, xy]`, m, from its corner with the smallest x on."""
    ring = jnp.roll(ring, -jnp.argmin(ring[:, 0]), axis=0)
    return jnp.stack([ring, jnp.roll(ring, -1, axis=0)], axis=1)


def _path(world: World, nodes: int) -> jf.ReferencePath:
    """From 30 m before the ego's start to 30 m, or 3 s, behind the goal; padding goes on straight."""
    goal_end = GOAL_GRID * jnp.floor(world.goal_arc_length[1] / GOAL_GRID)
    duration = jf.DT * world.goal_steps[1].astype(jnp.float32)
    speed = jnp.maximum(world.initial_state.speed, (goal_end - world.ego_arc_length) / duration)
    reach = goal_end - world.ego_arc_length + EXTENSION + jnp.maximum(EXTENSION, 3.0 * speed)
    length = SPACING * (jnp.ceil(reach / SPACING) - 1.0)
    arc_length = SPACING * jnp.arange(nodes, dtype=jnp.float32)
    within = jnp.minimum(arc_length, length)
    at = look_up(world.route, within + world.ego_arc_length - EXTENSION)
    beyond, exists = arc_length - within, arc_length <= length
    turns = 2 * jnp.pi * jnp.round(at.heading[0] / (2 * jnp.pi))
    return jf.ReferencePath(
        arc_length=arc_length,
        x=at.x + beyond * jnp.cos(at.heading),
        y=at.y + beyond * jnp.sin(at.heading),
        heading=at.heading - turns,
        curvature=jnp.where(exists, at.curvature, 0.0),
        curvature_derivative=jnp.where(exists, at.curvature_derivative, 0.0),
        length=length,
    )


def _road(ring: Float[Array, "corners 2"], path: jf.ReferencePath, nearby: int) -> jf.Road:
    segments = ring_edges(ring)
    return jf.Road(
        segments=segments,
        valid=jnp.ones(segments.shape[0], bool),
        nearby=nearby_segments(path, segments, nearby),
    )


def nearby_segments(path: jf.ReferencePath, segments: Float[Array, "segments 2 2"], count: int) -> Array:
    """For each stretch of the path the segments near it, `[bins, count]`, -1 is padding; see `jaxfrenet.scenario.Road`.

    Args:
      path: with nodes every 0.25 m.
      segments: the road's edge [m].
      count: most segments near one stretch; further ones would be missing.
    """
    step = 0.5 * BIN_LENGTH
    stride = round(step / SPACING)
    bins = math.ceil(path.x.shape[0] * SPACING / BIN_LENGTH)
    samples = jnp.arange(2 * bins + 1) * stride
    samples = jnp.minimum(samples, path.x.shape[0] - 1)
    x, y = path.x[samples, None], path.y[samples, None]
    (x0, y0), (dx, dy) = segments[:, 0].T, (segments[:, 1] - segments[:, 0]).T
    share = jnp.clip(((x - x0) * dx + (y - y0) * dy) / jnp.maximum(dx**2 + dy**2, 1e-12), 0.0, 1.0)
    distance = (x - x0 - share * dx) ** 2 + (y - y0 - share * dy) ** 2
    near = distance <= (CORRIDOR + REACH + 0.5 * step) ** 2
    used = (BIN_LENGTH * jnp.arange(bins, dtype=jnp.float32) <= path.length)[:, None]
    near = (near[0:-1:2] | near[1::2] | near[2::2]) & used
    seen = jnp.cumsum(near, axis=1)
    wanted = jnp.arange(1, count + 1)
    index = jax.vmap(lambda row: jnp.searchsorted(row, wanted, side="left", method="scan_unrolled"))(seen)
    return jnp.where(wanted <= seen[:, -1:], index, -1).astype(jnp.int32)
