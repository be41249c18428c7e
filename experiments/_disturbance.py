"""Generated and recorded traffic made less regular, so that a predictor learns what drivers do besides following lanes.

Each vehicle passes its recorded places at other times (it brakes, stops, stands, starts, hurries), drives beside its
line, and may be measured with noise. Nobody leaves the road; reactions to others are kept only roughly, so that a
predictor does not rely on all drivers reacting like the generator's.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._angles import wrapped
from jaxfrenet._typing import Array

KNOT_EVERY = 20
"""Steps between the knots of random speeds and offsets."""
SCENE_PACE = 0.4
"""Spread of the logarithm of the pace that all vehicles of a scene share."""
PACE_SPREAD = 0.4
"""Standard deviation of each vehicle's pace over time, as a share of the recorded speed."""
SLOWEST_PACE, FASTEST_PACE = 0.4, 2.2
"""Range of the scene's pace; a vehicle's own adds to it."""
STOPPING, STARTING, STANDING, GONE = 0.15, 0.12, 0.12, 0.15
"""Shares of vehicles that stop, or start, somewhere, that stand, and that are left out."""
LONGEST_RAMP = 60
"""Most steps that stopping and starting take."""
OFFSET_SPREAD = 0.35
"""Standard deviation of offsets from the recorded line [m]."""
POSITION_NOISE, HEADING_NOISE, SPEED_NOISE = 0.06, 0.01, 0.2
"""Largest standard deviations of measurements [m], [rad], [m/s]."""
NOISY = 0.5
"""Share of scenes that are measured with noise at all."""


def disturbed(key: Array, obstacles: jf.Obstacles, strength: Array) -> jf.Obstacles:
    """The obstacles of one scenario, driven differently.

    Args:
      key: random key.
      obstacles: recorded ones.
      strength: `[]`, from 0 (as recorded) to 1.
    """
    count, steps = obstacles.valid.shape
    pace_key, offset_key, noise_key, gone_key = jax.random.split(key, 4)
    per_vehicle = jnp.where(obstacles.static, 0.0, strength)[:, None]
    pace = _pace(pace_key, per_vehicle, steps)
    origin = jnp.argmax(obstacles.valid, axis=1)[:, None]
    passed = jnp.cumsum(pace, axis=1) - pace
    time = passed - jnp.take_along_axis(passed, origin, axis=1) + origin.astype(jnp.float32)
    moved = _at_times(obstacles, time, pace)
    offset = per_vehicle * OFFSET_SPREAD * _smooth(offset_key, count, steps)
    drift = jnp.diff(offset, axis=1, append=offset[:, -1:]) / jf.DT
    normal = jnp.stack([-jnp.sin(moved.heading), jnp.cos(moved.heading)], axis=-1)
    turned = jnp.clip(moved.speed / 2.0, 0.0, 1.0) * jnp.arctan(drift / jnp.maximum(moved.speed, 2.0))
    noisy, *keys = jax.random.split(noise_key, 4)
    noise = jnp.where(jax.random.bernoulli(noisy, NOISY), per_vehicle, 0.0)
    gone = jax.random.bernoulli(gone_key, GONE * per_vehicle)
    return replace(
        obstacles,
        position=moved.position
        + offset[..., None] * normal
        + (noise * POSITION_NOISE)[..., None] * jax.random.normal(keys[0], (count, steps, 2)),
        heading=moved.heading + turned + noise * HEADING_NOISE * jax.random.normal(keys[1], (count, steps)),
        speed=moved.speed + noise * SPEED_NOISE * jax.random.normal(keys[2], (count, steps)),
        valid=moved.valid & ~gone,
    )


def _pace(key: Array, strength: Array, steps: int) -> Array:
    """How fast each vehicle passes its record, `[vehicles, steps]`: the scene's pace, its own, stops and starts."""
    count = strength.shape[0]
    scene, own, level, event, when, ramp = jax.random.split(key, 6)
    shared = jnp.exp(strength * SCENE_PACE * jax.random.normal(scene))
    spread = strength * PACE_SPREAD * jax.random.uniform(level, (count, 1))
    pace = jnp.clip(shared, SLOWEST_PACE, FASTEST_PACE) * jnp.maximum(1.0 + spread * _smooth(own, count, steps), 0.0)
    event = jax.random.uniform(event, (count, 1))
    after = jnp.arange(steps, dtype=jnp.float32) - jax.random.uniform(when, (count, 1), maxval=float(steps))
    share = jnp.clip(after / jax.random.uniform(ramp, (count, 1), minval=15.0, maxval=float(LONGEST_RAMP)), 0.0, 1.0)
    stops, starts = STOPPING * strength, (STOPPING + STARTING) * strength
    stands = (STOPPING + STARTING + STANDING) * strength
    factor = jnp.where(
        event < stops, 1.0 - share, jnp.where(event < starts, share, jnp.where(event < stands, 0.0, 1.0))
    )
    return pace * factor


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
    turn = wrapped(heading[1] - heading[0])
    valid = at(obstacles.valid, lower) & at(obstacles.valid, upper) & (time >= 0.0) & (time <= last)
    return replace(
        obstacles,
        position=position[0] + weight[..., None] * (position[1] - position[0]),
        heading=heading[0] + weight * turn,
        speed=pace * (speed[0] + weight * (speed[1] - speed[0])),
        valid=valid,
    )
