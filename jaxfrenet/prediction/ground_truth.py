"""Prediction that knows what was recorded: the bound of what any predictor can give."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._typing import Array
from jaxfrenet.prediction.constant_velocity import STATIC_VARIANCE
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.scenario import Obstacles

VARIANCE = 0.1
"""Position variance [m²] of moving obstacles."""


def predict(obstacles: Obstacles, step: Array, horizon_steps: int) -> Prediction:
    """The recorded states of the coming steps; beyond the record an obstacle is not valid.

    Args:
      obstacles: recorded obstacles.
      step: `[]`, int, the current step.
      horizon_steps: number of coming steps to predict.
    """
    coming = step + 1 + jnp.arange(horizon_steps)
    recorded = coming < obstacles.valid.shape[1]
    coming = jnp.minimum(coming, obstacles.valid.shape[1] - 1)
    variance = jnp.where(obstacles.static, STATIC_VARIANCE, VARIANCE)
    covariance = variance[:, None, None, None] * jnp.eye(2)
    return Prediction(
        mean=obstacles.position[:, coming],
        covariance=jnp.broadcast_to(covariance, (variance.size, horizon_steps, 2, 2)),
        heading=obstacles.heading[:, coming],
        speed=obstacles.speed[:, coming],
        valid=obstacles.valid[:, coming] & (recorded | obstacles.static[:, None]),
        length=obstacles.length,
        width=obstacles.width,
    )
