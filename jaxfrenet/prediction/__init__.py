"""Predictors: where the obstacles will be, and how certain that is."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from jaxfrenet._typing import Array
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction import constant_velocity, ground_truth, neural
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.scenario import PredictionTable, Scenario

STEPS_AT_ONCE = 8
"""Steps of a scenario that are predicted together when its predictions are tabulated."""

__all__ = ["Prediction", "predict", "with_predictions"]


def predict(config: PlannerConfig, scenario: Scenario, step: Array, x: Array, y: Array) -> Prediction:
    """What the configured predictor says at `step` to an ego at `x`, `y` [m].

    Obstacles that do not exist at the step, or are out of the sensor's reach, are not valid; shapes are enlarged by
    the safety margins.

    Args:
      config: predictor, horizon, sensor radius and margins.
      scenario: the recorded obstacles; what the neural predictor says of them is looked up if there is a table.
      step: `[]`, int, the current step.
      x: `[]`, m; also `y`.
      y: see `x`.

    Raises:
      ValueError: the horizon is longer than the neural predictor's, or than the table's.
    """
    obstacles = scenario.obstacles
    if config.predictor == "neural" and scenario.predictions is not None:
        prediction = _look_up(config, scenario, scenario.predictions, step)
    else:
        prediction = _predict(config, scenario, step)
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


def _predict(
    config: PlannerConfig, scenario: Scenario, step: Array, parameters: neural.Parameters | None = None
) -> Prediction:
    """What the configured predictor says of all obstacles."""
    obstacles, horizon = scenario.obstacles, config.horizon_steps
    if config.predictor == "neural":
        parameters = neural.default_parameters() if parameters is None else parameters
        return neural.predict(parameters, obstacles, scenario.lane_map, step, horizon)
    predictor = {"constant_velocity": constant_velocity.predict, "ground_truth": ground_truth.predict}[config.predictor]
    return predictor(obstacles, step, horizon)


def with_predictions(
    config: PlannerConfig, scenario: Scenario, parameters: neural.Parameters | None = None
) -> Scenario:
    """The scenario with what the neural predictor says at all its steps; planning then costs no more than a look-up.

    The table takes `28 * steps * obstacles * horizon` bytes. Other predictors are so cheap that there is nothing to
    tabulate: with them the scenario is returned as it is. Padding and stacking leave predictions out: tabulate last.

    Args:
      config: predictor and horizon.
      scenario: one scenario; `jax.vmap` tabulates a batch.
      parameters: of the neural predictor, by default those that come with the package.
    """
    if config.predictor != "neural":
        return scenario

    def at(step: Array) -> PredictionTable:
        made = _predict(config, scenario, step, parameters)
        xx, xy, yy = (made.covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
        return PredictionTable(made.mean, jnp.stack([xx, xy, yy], axis=-1), made.heading, made.speed)

    count = scenario.obstacles.valid.shape[1]
    steps = jnp.arange(-(-count // STEPS_AT_ONCE) * STEPS_AT_ONCE).reshape(-1, STEPS_AT_ONCE)
    table = jax.lax.map(jax.vmap(at), steps)
    return replace(scenario, predictions=jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], table))


def _look_up(config: PlannerConfig, scenario: Scenario, table: PredictionTable, step: Array) -> Prediction:
    if config.horizon_steps > table.heading.shape[-1]:
        raise ValueError(
            f"horizon_steps is {config.horizon_steps}, the scenario's predictions have {table.heading.shape[-1]}; "
            "tabulate them anew with with_predictions"
        )
    obstacles = scenario.obstacles
    now = jnp.minimum(step, table.heading.shape[0] - 1)
    xx, xy, yy = jnp.moveaxis(table.covariance[now], -1, 0)
    covariance = jnp.stack([jnp.stack([xx, xy], axis=-1), jnp.stack([xy, yy], axis=-1)], axis=-2)
    heading = table.heading[now]
    return Prediction(
        mean=table.mean[now],
        covariance=covariance,
        heading=heading,
        speed=table.speed[now],
        valid=jnp.broadcast_to(obstacles.present(step)[:, None], heading.shape),
        length=obstacles.length,
        width=obstacles.width,
    )
