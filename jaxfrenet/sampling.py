"""The sampling matrix: which end states a planning cycle tries (paper, section "Sampling-based Motion Planner")."""

from __future__ import annotations

import dataclasses

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


@pytree_dataclass
class SamplingRange:
    """How far the sampled end states reach, as shares of the ranges in the config; all are traced.

    Their number stays the same, so a smaller range is a denser one. The paper names these parameters as the next ones
    for an agent to adapt (section "Conclusion and Outlook").
    """

    acceleration_range: Array | float = 1.0
    """`[]`, from the current speed up to the highest end speed; 0 never accelerates, 2 is twice the range, as far as
    the config's and the vehicle's bounds allow."""
    braking_range: Array | float = 1.0
    """`[]`, from the current speed down to the lowest end speed; 0 never brakes."""
    lateral_range: Array | float = 1.0
    """`[]`, of the offsets to both sides."""


SAMPLING_TERMS = tuple(field.name for field in dataclasses.fields(SamplingRange))
"""Names of the ranges."""


def sample_end_states(
    config: PlannerConfig,
    speed: Float[Array, ""],
    arc_length_rate: Float[Array, ""],
    offset: Float[Array, ""],
    reach: SamplingRange | None = None,
) -> EndStates:
    """End speeds that braking and accelerating can reach within the horizon, and end offsets across the lanes.

    Args:
      config: the density and limits.
      speed: the ego's speed [m/s].
      arc_length_rate: its speed along the reference path [m/s].
      offset: its offset [m].
      reach: shares of the ranges; all of them if not given.
    """
    vehicle, horizon = config.vehicle, DT * config.horizon_steps
    lowest = jnp.maximum(config.lowest_end_speed, speed - vehicle.max_acceleration * horizon)
    fastest = min(config.highest_end_speed, vehicle.max_speed)
    highest = jnp.minimum(speed + vehicle.max_acceleration / 6 * horizon, fastest)
    sides = config.lateral_range
    if reach is not None:
        lowest = jnp.maximum(lowest + (1.0 - reach.braking_range) * (speed - lowest), config.lowest_end_speed)
        highest = jnp.minimum(highest + (reach.acceleration_range - 1.0) * (highest - speed), fastest)
        sides = sides * reach.lateral_range
    share = jnp.linspace(0.0, 1.0, config.samples_per_axis)
    speeds = jnp.append(lowest + share * (highest - lowest), arc_length_rate)
    offsets = jnp.append(sides * (2 * share - 1), offset)
    return EndStates(speeds, offsets)
