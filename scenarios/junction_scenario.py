"""A drive through a junction: where the ego comes from and goes to, the traffic in its way, the goal behind it."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._typing import Array
from scenarios.assembly import World, assemble, ego_box, goal_interval, start_of
from scenarios.distributions import Dice
from scenarios.junction import Junction, junction_lines, lanelet_borders, lanelet_links, lanelet_pieces, road_ring
from scenarios.junction_task import NEAREST_START, JunctionTask
from scenarios.junction_traffic import Ego, draw_traffic
from scenarios.lanelet_map import LaneletMap, lane_map_of
from scenarios.lines import look_up, moved, moved_points
from scenarios.traffic import as_obstacles, drive

NEARBY = 88
"""Most road edge segments near one stretch of a path."""


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
    agents, relations = draw_traffic(dice, task, lines, junction.lane_width, ego)
    positions, speeds = drive(agents, relations, task.steps, task.slow_in_curves)

    at = look_up(route, ego.arc_length)
    center = jnp.stack([at.x - ego.offset * jnp.sin(at.heading), at.y + ego.offset * jnp.cos(at.heading)])
    heading = dice.draw((-np.pi, np.pi))
    turn = heading - at.heading
    frame = center, turn
    seen = replace(agents, line=moved(agents.line, *frame))
    lanelets = lanelet_borders(lines, junction.lane_width)
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
        lane_map=lane_map_of(lanelets, lanelet_links(len(angle)), lanelet_pieces(len(angle))),
        road_ring=moved_points(road_ring(lines, junction.lane_width), *frame),
        obstacles=as_obstacles(seen, positions, speeds, ego_box(heading)),
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


def _goal_lanelet(lanelets: list[tuple[Array, Array]], roles: Array, in_junction: Array) -> tuple[Array, Array]:
    """Which lanelet is the goal `[lanelets]`, and the ring around it."""
    arms = roles.shape[0]
    own, leaves = roles[0], roles[1]
    through = 2 * arms + own * (arms - 1) + leaves - (leaves > own).astype(jnp.int32)
    goal = jnp.where(in_junction, through, 2 * leaves + 1)
    left, right = (jnp.stack([borders[side] for borders in lanelets])[goal] for side in range(2))
    return jnp.arange(len(lanelets)) == goal, jnp.concatenate([right, left[::-1]])
