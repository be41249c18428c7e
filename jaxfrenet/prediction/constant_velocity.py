"""Prediction that every obstacle keeps its speed and heading."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxfrenet._typing import Array, Float
from jaxfrenet.config import DT
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.scenario import Obstacles

INITIAL_VARIANCE = 0.1
"""Position variance [m²] at the current step."""
LONGITUDINAL_ACCELERATION = 0.35
"""Standard deviation [m/s²] of an unforeseen acceleration along the heading."""
LATERAL_ACCELERATION = 0.2
"""Standard deviation [m/s²] of an unforeseen acceleration across the heading."""
STATIC_VARIANCE = 0.02
"""Position variance [m²] of obstacles that never move."""


def predict(obstacles: Obstacles, step: Array, horizon_steps: int) -> Prediction:
    """Constant velocity, with a Gaussian that an unknown constant acceleration widens by (½ a t²)².

    Args:
      obstacles: recorded obstacles, of which only the current step is read.
      step: `[]`, int, the current step.
      horizon_steps: number of coming steps to predict.
    """
    time = jnp.asarray(DT * np.arange(1, horizon_steps + 1), jnp.float32)
    step = jnp.minimum(step, obstacles.valid.shape[1] - 1)
    position, heading, speed = obstacles.position[:, step], obstacles.heading[:, step], obstacles.speed[:, step]
    speed = jnp.where(obstacles.static, 0.0, speed)
    direction = jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1)
    mean = position[:, None] + (speed[:, None] * time)[..., None] * direction[:, None]
    shape = mean.shape[:2]
    return Prediction(
        mean=mean,
        covariance=_covariance(obstacles, direction, time),
        heading=jnp.broadcast_to(heading[:, None], shape),
        speed=jnp.broadcast_to(speed[:, None], shape),
        valid=jnp.broadcast_to(obstacles.valid[:, step, None] | obstacles.static[:, None], shape),
        length=obstacles.length,
        width=obstacles.width,
    )


def _covariance(obstacles: Obstacles, direction: Array, time: Array) -> Float[Array, "obstacles steps 2 2"]:
    """Variances along and across each obstacle's heading, turned into the map's axes."""
    travelled = 0.5 * time**2
    static = obstacles.static[:, None]
    along = jnp.where(static, STATIC_VARIANCE, INITIAL_VARIANCE + (LONGITUDINAL_ACCELERATION * travelled) ** 2)
    across = jnp.where(static, STATIC_VARIANCE, INITIAL_VARIANCE + (LATERAL_ACCELERATION * travelled) ** 2)
    left = jnp.stack([-direction[:, 1], direction[:, 0]], axis=-1)

    def spread(variance: Array, axis: Array) -> Array:
        return variance[..., None, None] * (axis[:, :, None] * axis[:, None, :])[:, None]

    return spread(along, direction) + spread(across, left)
