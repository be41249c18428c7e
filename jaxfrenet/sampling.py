"""The sampling matrix: which end states a planning cycle tries (paper, section "Sampling-based Motion Planner")."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.config import DT, PlannerConfig


@pytree_dataclass
class EndStates:
    """Sampled ends; with the end times of the config, every combination is one trajectory."""

    speed: Float[Array, "*batch end_speeds"]
    """`[end_speeds]`, m/s, along the reference path; the last is the current one."""
    offset: Float[Array, "*batch end_offsets"]
    """`[end_offsets]`, m; the last is the current one."""


def sample_end_states(
    config: PlannerConfig,
    speed: Float[Array, ""],
    arc_length_rate: Float[Array, ""],
    offset: Float[Array, ""],
) -> EndStates:
    """End speeds that braking and accelerating can reach within the horizon, and end offsets across the lanes.

    Args:
      config: the density and limits.
      speed: the ego's speed [m/s].
      arc_length_rate: its speed along the reference path [m/s].
      offset: its offset [m].
    """
    vehicle, horizon = config.vehicle, DT * config.horizon_steps
    lowest = jnp.maximum(config.lowest_end_speed, speed - vehicle.max_acceleration * horizon)
    fastest = min(config.highest_end_speed, vehicle.max_speed)
    highest = jnp.minimum(speed + vehicle.max_acceleration / 6 * horizon, fastest)
    share = jnp.linspace(0.0, 1.0, config.samples_per_axis)
    speeds = jnp.append(lowest + share * (highest - lowest), arc_length_rate)
    offsets = jnp.append(config.lateral_range * (2 * share - 1), offset)
    return EndStates(speeds, offsets)
