"""The goal: which speed leads to it in time, and how the ego stands to it."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float
from jaxfrenet.config import DT
from jaxfrenet.road import is_inside
from jaxfrenet.scenario import Goal

LARGEST_SPEED_CHANGE = 5.0
"""The desired speed stays within this [m/s] of the current speed."""
HIGHEST_DESIRED_SPEED = 50.0


@pytree_dataclass
class GoalStatus:
    """How a state stands to each goal state."""

    in_region: Bool[Array, "goals"]
    """Position met; always so where the goal state names no region."""
    matches: Bool[Array, "goals"]
    """Position, speed and heading met, whatever the time."""


def in_region(goal: Goal, center: Float[Array, "2"]) -> Bool[Array, "goals"]:
    """Whether a position [m] lies in each goal state's region; a goal state without one takes every position."""

    def inside(edges: Array, valid: Array) -> Array:
        return is_inside(edges[:, 0], edges[:, 1], valid, center)

    return (jax.vmap(inside)(goal.edges, goal.edge_valid) | ~goal.has_position) & goal.valid


def judge(goal: Goal, center: Float[Array, "2"], heading: Float[Array, ""], speed: Float[Array, ""]) -> GoalStatus:
    """Compare a state (vehicle centre [m], heading [rad], speed [m/s]) with every goal state."""
    reached = in_region(goal, center)
    away = heading - goal.heading[:, 0]
    away = jnp.abs(away - 2 * jnp.pi * jnp.round(away / (2 * jnp.pi)))
    in_speed = (speed >= goal.speed[:, 0]) & (speed <= goal.speed[:, 1])
    return GoalStatus(reached, reached & in_speed & (away <= goal.heading[:, 1]))


def last_step(goal: Goal) -> Array:
    """`[]`, int: the last step at which any goal state can still be reached in time."""
    return jnp.max(jnp.where(goal.valid, goal.steps[:, 1], 0))


def desired_speed(
    goal: Goal,
    step: Array,
    center: Float[Array, "2"],
    center_arc_length: Float[Array, ""],
    speed: Float[Array, ""],
) -> Float[Array, ""]:
    """The speed [m/s] that reaches the middle of the goal region in the middle of its time interval.

    The middle, not the start: an ego that aims at the start arrives at the last moment, and is late after any delay.
    Inside the goal region, or once its time has passed: the middle of its speed interval, if it names one, else the
    current speed. Clipped to the current speed ± 5 m/s and to [0, 50]. Of several goal states the first is aimed at.
    """
    inside = in_region(goal, center)[0]
    remaining = DT * (0.5 * jnp.sum(goal.steps[0]).astype(jnp.float32) - step.astype(jnp.float32))
    distance = jnp.maximum(0.5 * jnp.sum(goal.arc_length[0]) - center_arc_length, 0.0)
    approach = distance / jnp.maximum(remaining, DT)
    cruise = jnp.where(goal.has_speed[0], 0.5 * (goal.speed[0, 0] + goal.speed[0, 1]), speed)
    wanted = jnp.where(inside | (remaining <= 0), cruise, approach)
    nearby = jnp.clip(wanted, speed - LARGEST_SPEED_CHANGE, speed + LARGEST_SPEED_CHANGE)
    return jnp.clip(nearby, 0.0, HIGHEST_DESIRED_SPEED)
