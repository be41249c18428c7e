"""The risk of driving a trajectory: how probable a collision is, times how badly it would hurt.

The risk of one encounter is p · H; a trajectory's is the largest over its points and all obstacles (Geisslinger et al.
2023, maximum risk).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.collision_check import swept_boxes
from jaxfrenet.config import PlannerConfig
from jaxfrenet.gaussian import LARGEST_CORRELATION, Gaussian, Quadrature, rectangle_mass
from jaxfrenet.harm import Party, boundary_harm, harm, obstacle_mass
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.road import sweeps_edge
from jaxfrenet.scenario import Obstacles, Scenario
from jaxfrenet.trajectories import Bundle, EgoState
from jaxfrenet.vehicle import Vehicle

FARTHEST = 5.0
"""An obstacle whose centre, front and rear are all farther [m] from the ego's centre has no probability."""
PAIRS = 32
"""Pairs of a trajectory's point and an obstacle that are evaluated at once."""
RULE = Quadrature(10, steep=True)
"""What computes each mass."""
TRAJECTORIES = 64
"""Trajectories of a bundle that are assessed at once."""


@pytree_dataclass
class Risk:
    """What driving a trajectory risks."""

    ego: Float[Array, "*batch"]
    """`[]`, of the ego's passengers, from collisions with obstacles."""
    third_party: Float[Array, "*batch"]
    """`[]`, of the others."""
    boundary_harm: Float[Array, "*batch"]
    """`[]`, harm to the ego where it first leaves the road, 0 if it stays on it."""

    @property
    def total(self) -> Float[Array, "*batch"]:
        """`[]`, of all together; the road's edge counts as an obstacle that is hit with certainty."""
        return jnp.maximum(self.ego, self.boundary_harm) + self.third_party


def assess(config: PlannerConfig, scenario: Scenario, prediction: Prediction, trajectory: EgoState) -> Risk:
    """The risk of one trajectory.

    Args:
      config: the vehicle, its horizon and the model of harm.
      scenario: the obstacles' kinds and sizes as recorded, and the road.
      prediction: point i of a trajectory meets entry i - 1; shapes are enlarged already.
      trajectory: `[points]`.
    """
    return _assess(config, scenario, prediction, trajectory, jnp.cos(trajectory.heading), jnp.sin(trajectory.heading))


def assess_bundle(config: PlannerConfig, scenario: Scenario, prediction: Prediction, bundle: Bundle) -> Risk:
    """The risk of every trajectory in a bundle, fields `[trajectories]`; the other arguments as in `assess`."""
    count = bundle.valid.shape[0]
    places = jnp.minimum(jnp.arange(-(-count // TRAJECTORIES) * TRAJECTORIES), count - 1).reshape(-1, TRAJECTORIES)
    motions = bundle.motion, bundle.pose.cos, bundle.pose.sin

    def assess_some(index: Array) -> Risk:
        some = jax.tree.map(lambda leaf: leaf[index], motions)
        return jax.vmap(lambda one: _assess(config, scenario, prediction, *one))(some)

    return jax.tree.map(lambda leaf: leaf.reshape(-1)[:count], jax.lax.map(assess_some, places))


def collision_probability(vehicle: Vehicle, ego: Party, partner: Party, covariance: Array, length: Array) -> Array:
    """How probable it is that an obstacle, predicted as a Gaussian, stands where the ego is.

    The ego is covered by three boxes along its heading, each a third of its length by its width and parallel to the
    map's axes; the obstacle by three points: centre, front and rear. The sum of the nine masses over 3, which exceeds
    1 slightly where the boxes overlap; 0 where all three points are farther than `FARTHEST` from the ego's centre.
    Correct to 2e-5 for correlations up to 0.99.

    Args:
      vehicle: the ego's size.
      ego: where its centre is; any shape, which the other arguments share or broadcast to.
      partner: the obstacle's mean position and heading.
      covariance: `[..., 2, 2]`, m², of the obstacle's position.
      length: of the obstacle [m].
    """
    third = vehicle.length / 3
    sigma_x, sigma_y = (jnp.sqrt(jnp.maximum(covariance[..., i, i], 1e-12)) for i in (0, 1))
    correlation = covariance[..., 0, 1] / (sigma_x * sigma_y)
    along = jnp.asarray([-third, 0.0, third], jnp.float32)[:, None]
    box_x = ego.x[..., None, None] + along * jnp.cos(ego.heading)[..., None, None]
    box_y = ego.y[..., None, None] + along * jnp.sin(ego.heading)[..., None, None]
    x, y = _points(partner, length)
    spread = (value[..., None, None] for value in (sigma_x, sigma_y, correlation))
    seen = Gaussian(x[..., None, :] - box_x, y[..., None, :] - box_y, *spread)
    total = jnp.sum(rectangle_mass(seen, 0.5 * third, 0.5 * vehicle.width, RULE), axis=(-2, -1))
    return jnp.where(_is_near(ego, partner, length), total / 3, 0.0)


def surrogate_probability(x: Array, y: Array, mean: Array, covariance: Array) -> Array:
    """The cheap stand-in 1 / (d²)² for a collision probability; d is the Mahalanobis distance, 1 within one of it.

    Args:
      x: of the ego's centre [m]; also `y`. Any shape, which the other arguments share or broadcast to.
      y: see `x`.
      mean: `[..., 2]`, m, of the obstacle's position.
      covariance: `[..., 2, 2]`, m², of the obstacle's position.
    """
    sigma_x, sigma_y = (jnp.sqrt(jnp.maximum(covariance[..., i, i], 1e-12)) for i in (0, 1))
    correlation = jnp.clip(covariance[..., 0, 1] / (sigma_x * sigma_y), -LARGEST_CORRELATION, LARGEST_CORRELATION)
    u, v = (mean[..., 0] - x) / sigma_x, (mean[..., 1] - y) / sigma_y
    squared = u**2 + (v - correlation * u) ** 2 / (1.0 - correlation**2)
    return (1.0 / jnp.maximum(squared, 1.0)) ** 2


def _points(partner: Party, length: Array) -> tuple[Array, Array]:
    """Positions x and y [m] of an obstacle's centre, front and rear; the three are a new last axis."""
    ahead = 0.5 * length[..., None] * jnp.asarray([0.0, 1.0, -1.0])
    return (
        partner.x[..., None] + ahead * jnp.cos(partner.heading)[..., None],
        partner.y[..., None] + ahead * jnp.sin(partner.heading)[..., None],
    )


def _is_near(ego: Party, partner: Party, length: Array) -> Array:
    """Whether any of an obstacle's three points lies within `FARTHEST` of the ego's centre."""
    x, y = _points(partner, length)
    squared = (x - ego.x[..., None]) ** 2 + (y - ego.y[..., None]) ** 2
    return jnp.any(squared <= FARTHEST**2, axis=-1)


def _assess(
    config: PlannerConfig, scenario: Scenario, prediction: Prediction, trajectory: EgoState, cos: Array, sin: Array
) -> Risk:
    """As `assess`, with the unit vector along the heading `[points]`."""
    vehicle, obstacles, road = config.vehicle, scenario.obstacles, scenario.road
    x, y = trajectory.x + vehicle.rear_axle_to_center * cos, trajectory.y + vehicle.rear_axle_to_center * sin
    mass = jnp.full_like(x, vehicle.mass)
    ego = jax.tree.map(lambda leaf: leaf[1:], Party(x, y, trajectory.heading, trajectory.speed, mass))
    ego_risk, third_party_risk = _largest(config, obstacles, prediction.first(config.horizon_steps), ego)
    leaves = sweeps_edge(road, swept_boxes(vehicle, x, y, cos, sin), trajectory.arc_length[:-1], trajectory.offset[:-1])
    off_road = boundary_harm(ego.speed[jnp.argmax(leaves)])
    return Risk(ego_risk, third_party_risk, jnp.where(jnp.any(leaves), off_road, 0.0))


def _largest(
    config: PlannerConfig, obstacles: Obstacles, prediction: Prediction, ego: Party
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Largest p · H of the ego `[steps]` and of the others, over all steps and obstacles.

    Pairs of a step and an obstacle that are near each other are numbered, and evaluated `PAIRS` at a time for as long
    as there are any.
    """
    mass = obstacle_mass(obstacles.kind, obstacles.length, obstacles.width)
    mass = jnp.broadcast_to(mass[:, None], prediction.heading.shape)
    mean = prediction.mean
    others = Party(mean[..., 0], mean[..., 1], prediction.heading, prediction.speed, mass)
    near = _is_near(ego, others, prediction.length[:, None]) & prediction.valid
    number = jnp.cumsum(near.reshape(-1), dtype=jnp.int32)

    def encounter(wanted: Array) -> tuple[Array, Array]:
        """The pair with a number from 1 on; the last one if there are fewer."""
        place = jnp.searchsorted(number, jnp.minimum(wanted, number[-1]), method="compare_all")
        obstacle, step = place // near.shape[1], place % near.shape[1]
        pose = jax.tree.map(lambda leaf: leaf[step], ego)
        partner = jax.tree.map(lambda leaf: leaf[obstacle, step], others)
        covariance, length = prediction.covariance[obstacle, step], prediction.length[obstacle]
        p = collision_probability(config.vehicle, pose, partner, covariance, length)
        harmed = harm(config.harm_model, pose, partner, obstacles.kind[obstacle])
        return p * harmed.ego, p * harmed.third_party

    def evaluate(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        start, *largest = carry
        found = jax.vmap(encounter)(start + 1 + jnp.arange(PAIRS, dtype=jnp.int32))
        ego_risk, third_party_risk = (jnp.maximum(old, jnp.max(new)) for old, new in zip(largest, found, strict=True))
        return start + PAIRS, ego_risk, third_party_risk

    none = jnp.int32(0), jnp.float32(0.0), jnp.float32(0.0)
    return jax.lax.while_loop(lambda carry: carry[0] < number[-1], evaluate, none)[1:]
