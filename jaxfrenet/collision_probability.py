"""How probable it is that an obstacle, predicted as a Gaussian, stands where the ego is."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction.types import Prediction

LARGEST_CORRELATION = 0.999999
"""Correlations are clipped to ± this; beyond it the Gaussian is a line within float32."""
NEGLIGIBLE_DISTANCE = 5.3
"""Obstacles farther from the ego's box than this many standard deviations have less than 6e-8 of their mass in it."""
CHUNK = 512
"""Rows (trajectories that differ in end offset only, at one point, with one obstacle) evaluated at once."""
CORRELATION_CLASSES = ((0.5, 4, 1), (0.9, 8, 1), (1.0, 16, 2))
"""Largest |correlation| of a class, its quadrature nodes and their grading towards the end; errors below 3e-5."""


@pytree_dataclass
class Gaussian:
    """Bivariate Gaussians in the ego's frame, relative to its box's centre; fields broadcast."""

    x: Float[Array, "*#shape"]
    """Mean along the ego's heading, m."""
    y: Float[Array, "*#shape"]
    sigma_x: Float[Array, "*#shape"]
    """Standard deviation along the ego's heading, m."""
    sigma_y: Float[Array, "*#shape"]
    correlation: Float[Array, "*#shape"]


def rectangle_mass(
    gaussian: Gaussian, half_length: float, half_width: float, nodes: int = 16, grading: int = 2
) -> Float[Array, "*shape"]:
    """Probability mass inside the box ± half_length, ± half_width [m].

    Plackett's identity: the mass without correlation, a product of two intervals, plus the integral over the
    correlation r = sin θ of the density at the four corners (Plackett 1954; Drezner and Wesolowsky 1990), by
    Gauss-Legendre quadrature. `nodes` and their `grading` towards the end decide the error: 6e-9 for (4, 1) up to
    |correlation| 0.5, 1e-8 for (8, 1) up to 0.9, 2e-5 for (16, 2) beyond.
    """
    low_x, high_x = (-half_length - gaussian.x) / gaussian.sigma_x, (half_length - gaussian.x) / gaussian.sigma_x
    low_y, high_y = (-half_width - gaussian.y) / gaussian.sigma_y, (half_width - gaussian.y) / gaussian.sigma_y
    independent = _interval_mass(low_x, high_x) * _interval_mass(low_y, high_y)
    angle = jnp.arcsin(jnp.clip(gaussian.correlation, -LARGEST_CORRELATION, LARGEST_CORRELATION))
    corners = 0.0
    for share, weight in zip(*_quadrature(nodes, grading), strict=True):
        sin, cos = jnp.sin(share * angle), jnp.cos(share * angle)
        per_difference, per_product = -0.5 / cos**2, -1.0 / (1.0 + sin)

        def density(h: Array, k: Array, a: Array = per_difference, b: Array = per_product) -> Array:
            return jnp.exp(a * (h - k) ** 2 + b * h * k)

        same = density(high_x, high_y) + density(low_x, low_y)
        opposite = density(low_x, high_y) + density(high_x, low_y)
        corners = corners + weight * (same - opposite)
    return jnp.clip(independent + angle / (2 * np.pi) * corners, 0.0, 1.0)


def _quadrature(nodes: int, grading: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [0, 1], crowded towards 1 where `grading` is above 1."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    rest = (1 - x) / 2
    return 1 - rest**grading, weight / 2 * grading * rest ** (grading - 1)


def _interval_mass(low: Array, high: Array) -> Array:
    """Standard normal mass of [low, high], accurate in the tails: both ends are mirrored to the side of small mass."""
    mirrored = low + high > 0
    low, high = jnp.where(mirrored, -high, low), jnp.where(mirrored, -low, high)
    root = np.float32(np.sqrt(0.5))
    return 0.5 * (jax.lax.erfc(-high * root) - jax.lax.erfc(-low * root))


def in_ego_frame(
    x: Array, y: Array, cos: Array, sin: Array, mean: Float[Array, "*#shape 2"], covariance: Float[Array, "*#shape 2 2"]
) -> Gaussian:
    """Gaussians seen from boxes centred at `x`, `y` [m] that point along (`cos`, `sin`); broadcast."""
    dx, dy = mean[..., 0] - x, mean[..., 1] - y
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    along = xx * cos**2 + 2 * xy * cos * sin + yy * sin**2
    across = xx * sin**2 - 2 * xy * cos * sin + yy * cos**2
    mixed = (yy - xx) * cos * sin + xy * (cos**2 - sin**2)
    sigma_x, sigma_y = jnp.sqrt(jnp.maximum(along, 1e-12)), jnp.sqrt(jnp.maximum(across, 1e-12))
    return Gaussian(dx * cos + dy * sin, dy * cos - dx * sin, sigma_x, sigma_y, mixed / (sigma_x * sigma_y))


def collision_probability_cost(
    config: PlannerConfig, x: Array, y: Array, cos: Array, sin: Array, prediction: Prediction
) -> Float[Array, "trajectories"]:
    """1000 · Σ over obstacles and points i ≥ 1 of p(centre) + 0.5 · Σ p(four corners).

    p is the mass of the obstacle's predicted position at that time inside the ego's box, for the obstacle's centre
    and for its four corners as if each were the position. Pairs whose mass is negligible are left out: the others are
    gathered and evaluated `CHUNK` rows at a time for as long as there are any, so the work follows the traffic and
    nothing is ever dropped.

    Args:
      config: the vehicle.
      x: `[trajectories, points]` of the ego's centre [m]; also `y`, and `cos`, `sin` of its heading.
      y: see `x`.
      cos: see `x`.
      sin: see `x`.
      prediction: point i of a trajectory meets entry i - 1.
    """
    per_row = config.samples_per_axis + 1
    pose = jnp.stack([x, y, cos, sin], axis=-1)[:, 1:]
    pose = pose.reshape(-1, per_row, *pose.shape[1:])
    steps = pose.shape[2]
    prediction = prediction.first(steps)
    near, strongest = _near_rows(config, pose, prediction)

    cost = jnp.zeros(pose.shape[:2])
    lowest = -1.0
    for highest, nodes, grading in CORRELATION_CLASSES:
        chosen = near & (strongest > lowest) & (strongest <= highest)
        cost = _accumulate(config, cost, pose, prediction, chosen, nodes, grading)
        lowest = highest
    return 1000.0 * cost.reshape(-1)


def _near_rows(config: PlannerConfig, pose: Array, prediction: Prediction) -> tuple[Array, Array]:
    """Which rows `[rows, obstacles, steps]` have any mass, and the largest |correlation| that they can show.

    Over all headings of the ego, a Gaussian's correlation is at most (λ₁ - λ₂)/(λ₁ + λ₂) of its eigenvalues.
    """
    vehicle = config.vehicle
    xx, yy = prediction.covariance[..., 0, 0], prediction.covariance[..., 1, 1]
    xy = prediction.covariance[..., 0, 1]
    spread = jnp.sqrt((xx - yy) ** 2 + 4 * xy**2)
    sigma = jnp.sqrt(0.5 * (xx + yy + spread))
    reach = 0.5 * float(np.hypot(vehicle.length, vehicle.width))
    reach = reach + 0.5 * jnp.hypot(prediction.length, prediction.width)[:, None] + NEGLIGIBLE_DISTANCE * sigma
    dx = pose[..., None, :, 0] - prediction.mean[..., 0]
    dy = pose[..., None, :, 1] - prediction.mean[..., 1]
    distance = jnp.sqrt(jnp.min(dx**2 + dy**2, axis=1))
    near = (distance < reach) & prediction.valid
    strongest = jnp.minimum(spread / jnp.maximum(xx + yy, 1e-12), 1.0)
    return near, jnp.broadcast_to(strongest, near.shape)


def _accumulate(
    config: PlannerConfig, cost: Array, pose: Array, prediction: Prediction, chosen: Array, nodes: int, grading: int
) -> Array:
    """Add the masses of the chosen rows to `cost` `[rows, end offsets]`, chunk by chunk."""
    rows, obstacles, steps = chosen.shape
    flat = chosen.reshape(-1)
    count = jnp.sum(flat)
    place = jnp.where(flat, jnp.cumsum(flat) - 1, flat.size + CHUNK)
    queue = jnp.full(flat.size + CHUNK, flat.size, jnp.int32).at[place].set(jnp.arange(flat.size), mode="drop")

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        start, total = carry
        index = jax.lax.dynamic_slice(queue, (start,), (CHUNK,))
        row, obstacle, step = jnp.unravel_index(jnp.minimum(index, flat.size - 1), (rows, obstacles, steps))
        mass = _weighted_mass(config, pose[row, :, step], prediction.at(obstacle, step), nodes, grading)
        mass = jnp.where((index < flat.size)[:, None], mass, 0.0)
        return start + CHUNK, total.at[row].add(mass)

    return jax.lax.while_loop(lambda carry: carry[0] < count, body, (jnp.int32(0), cost))[1]


def _weighted_mass(config: PlannerConfig, pose: Array, obstacle: Prediction, nodes: int, grading: int) -> Array:
    """p(centre) + 0.5 Σ p(corners) `[chunk, end offsets]` of poses `[chunk, end offsets, 4]` with one obstacle each."""
    x, y, cos, sin = (pose[..., i] for i in range(4))
    gaussian = in_ego_frame(x, y, cos, sin, obstacle.mean[:, None], obstacle.covariance[:, None])
    heading_cos, heading_sin = jnp.cos(obstacle.heading)[:, None], jnp.sin(obstacle.heading)[:, None]
    turn_cos, turn_sin = cos * heading_cos + sin * heading_sin, cos * heading_sin - sin * heading_cos
    length, width = 0.5 * obstacle.length[:, None], 0.5 * obstacle.width[:, None]
    shifts = [(0.0, 0.0)] + [(a * length, b * width) for a in (1, -1) for b in (1, -1)]
    shift_x = jnp.stack([a * turn_cos - b * turn_sin for a, b in shifts])
    shift_y = jnp.stack([a * turn_sin + b * turn_cos for a, b in shifts])
    weight = jnp.asarray([1.0, 0.5, 0.5, 0.5, 0.5])[:, None, None]
    points = Gaussian(
        gaussian.x + shift_x, gaussian.y + shift_y, gaussian.sigma_x, gaussian.sigma_y, gaussian.correlation
    )
    vehicle = config.vehicle
    return jnp.sum(weight * rectangle_mass(points, 0.5 * vehicle.length, 0.5 * vehicle.width, nodes, grading), axis=0)
