"""Generated and recorded traffic made less regular, so that a predictor learns what drivers do besides following lanes.

Each vehicle passes its recorded places at other times (it brakes, stops, hurries), drives beside its line, and is
measured with noise; nobody leaves the road, and how vehicles react to each other is kept only roughly.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._typing import Array

KNOT_EVERY = 20
"""Steps between the knots of random speeds and offsets."""
PACE_SPREAD = 0.35
"""Standard deviation of the random pace, as a share of the recorded speed."""
FASTEST_PACE = 1.6
STOPPING = 0.15
"""Share of vehicles that come to a stop somewhere."""
OFFSET_SPREAD = 0.35
"""Standard deviation of offsets from the recorded line [m]."""
POSITION_NOISE, HEADING_NOISE, SPEED_NOISE = 0.04, 0.01, 0.15
"""Largest standard deviations of measurements [m], [rad], [m/s]."""


def disturbed(key: Array, obstacles: jf.Obstacles, strength: Array) -> jf.Obstacles:
    """The obstacles of one scenario, driven differently.

    Args:
      key: random key.
      obstacles: recorded ones.
      strength: `[]`, from 0 (as recorded) to 1.
    """
    count, steps = obstacles.valid.shape
    keys = jax.random.split(key, 7)
    strength = jnp.where(obstacles.static, 0.0, strength)[:, None]
    pace = jnp.clip(1.0 + strength * PACE_SPREAD * _smooth(keys[0], count, steps), 0.0, FASTEST_PACE)
    stops = jax.random.bernoulli(keys[1], STOPPING * strength[:, 0])
    stop_at = jnp.where(stops, jax.random.uniform(keys[2], (count,), maxval=float(steps)), jnp.inf)
    braking = jnp.clip((stop_at[:, None] - jnp.arange(steps, dtype=jnp.float32)) / 30.0 + 1.0, 0.0, 1.0)
    pace = pace * braking
    origin = jnp.argmax(obstacles.valid, axis=1)[:, None].astype(jnp.float32)
    passed = jnp.cumsum(pace, axis=1) - pace
    time = passed - jnp.take_along_axis(passed, origin.astype(jnp.int32), axis=1) + origin
    moved = _at_times(obstacles, time, pace)
    offset = strength * OFFSET_SPREAD * _smooth(keys[3], count, steps)
    drift = jnp.diff(offset, axis=1, append=offset[:, -1:]) / jf.DT
    normal = jnp.stack([-jnp.sin(moved.heading), jnp.cos(moved.heading)], axis=-1)
    along = jnp.maximum(moved.speed, 2.0)
    share = jnp.clip(moved.speed / 2.0, 0.0, 1.0)
    return jf.Obstacles(
        position=moved.position
        + offset[..., None] * normal
        + (strength * POSITION_NOISE)[..., None] * jax.random.normal(keys[4], (count, steps, 2)),
        heading=moved.heading
        + share * jnp.arctan(drift / along)
        + strength * HEADING_NOISE * jax.random.normal(keys[5], (count, steps)),
        speed=moved.speed + strength * SPEED_NOISE * jax.random.normal(keys[6], (count, steps)),
        valid=moved.valid,
        length=obstacles.length,
        width=obstacles.width,
        kind=obstacles.kind,
        static=obstacles.static,
    )


def _smooth(key: Array, count: int, steps: int) -> Array:
    """Random functions of time of unit spread, linear between knots at random phases, `[count, steps]`."""
    knots = steps // KNOT_EVERY + 3
    first, second = jax.random.split(key)
    values = jax.random.normal(first, (count, knots))
    phase = jax.random.uniform(second, (count, 1))
    at = jnp.arange(steps, dtype=jnp.float32) / KNOT_EVERY + phase
    return jax.vmap(jnp.interp, in_axes=(0, None, 0))(at, jnp.arange(knots, dtype=jnp.float32), values)


def _at_times(obstacles: jf.Obstacles, time: Array, pace: Array) -> jf.Obstacles:
    """The recorded states at other times `[obstacles, steps]`, in steps, which pass at a pace."""
    last = obstacles.valid.shape[1] - 1
    lower = jnp.clip(jnp.floor(time).astype(jnp.int32), 0, last)
    upper = jnp.minimum(lower + 1, last)
    weight = jnp.clip(time - lower.astype(jnp.float32), 0.0, 1.0)

    def at(table: Array, index: Array) -> Array:
        return jnp.take_along_axis(table, index.reshape(*index.shape, *[1] * (table.ndim - 2)), axis=1)

    position = at(obstacles.position, lower), at(obstacles.position, upper)
    heading = at(obstacles.heading, lower), at(obstacles.heading, upper)
    speed = at(obstacles.speed, lower), at(obstacles.speed, upper)
    turn = heading[1] - heading[0]
    turn = turn - 2 * jnp.pi * jnp.round(turn / (2 * jnp.pi))
    valid = at(obstacles.valid, lower) & at(obstacles.valid, upper) & (time >= 0.0) & (time <= last)
    return jf.Obstacles(
        position=position[0] + weight[..., None] * (position[1] - position[0]),
        heading=heading[0] + weight * turn,
        speed=pace * (speed[0] + weight * (speed[1] - speed[0])),
        valid=valid,
        length=obstacles.length,
        width=obstacles.width,
        kind=obstacles.kind,
        static=obstacles.static,
    )
