"""Predictors: where the obstacles will be, and how certain that is."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._typing import Array
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction import constant_velocity, ground_truth
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.scenario import Scenario

PREDICTORS = {"constant_velocity": constant_velocity.predict, "ground_truth": ground_truth.predict}

__all__ = ["PREDICTORS", "Prediction", "predict"]


def predict(config: PlannerConfig, scenario: Scenario, step: Array, x: Array, y: Array) -> Prediction:
    """What the configured predictor says at `step` to an ego at `x`, `y` [m].

    Obstacles that do not exist at the step, or are out of the sensor's reach, are not valid; shapes are enlarged by
    the safety margins.

    Args:
      config: predictor, horizon, sensor radius and margins.
      scenario: the recorded obstacles.
      step: `[]`, int, the current step.
      x: `[]`, m; also `y`.
      y: see `x`.
    """
    obstacles = scenario.obstacles
    prediction = PREDICTORS[config.predictor](obstacles, step, config.horizon_steps)
    now = jnp.minimum(step, obstacles.valid.shape[1] - 1)
    away = obstacles.position[:, now] - jnp.stack([x, y])
    seen = obstacles.present(step) & (jnp.sum(away**2, axis=-1) <= config.sensor_radius**2)
    valid = prediction.valid & seen[:, None]
    return Prediction(
        mean=prediction.mean,
        covariance=jnp.where(valid[..., None, None], prediction.covariance, jnp.eye(2)),
        heading=prediction.heading,
        speed=prediction.speed,
        valid=valid,
        length=prediction.length + config.safety_length,
        width=prediction.width + config.safety_width,
    )
