"""How probable it is that an obstacle, predicted as a Gaussian, stands where the ego is."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.config import PlannerConfig
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.vehicle import Vehicle

LARGEST_CORRELATION = 0.999999
"""Correlations are clipped to ± this; beyond it the Gaussian is a line within float32."""
NEGLIGIBLE_DISTANCE = 5.3
"""Beyond this many standard deviations to the side a Gaussian has less than 6e-8 of its mass."""
CHUNK = 1024
"""Rows (trajectories that differ in end offset only, at one point, with one obstacle) evaluated at once."""
CORRELATION_CLASSES = ((0.3, 3, False), (0.7, 6, False), (0.9, 8, False), (1.0, 16, True))
"""Largest |correlation| of a class, its quadrature nodes, and whether they are steep: see `rectangle_mass`."""


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
    gaussian: Gaussian, half_length: float, half_width: float, nodes: int = 16, steep: bool = True
) -> Float[Array, "*shape"]:
    """Probability mass inside the box ± half_length, ± half_width [m].

    Plackett's identity: the mass without correlation, a product of two intervals, plus the integral over the
    correlation of the density at the four corners (Plackett 1954; Drezner and Wesolowsky 1990), by Gauss-Legendre
    quadrature. Errors: 2e-8 with 3 nodes up to |correlation| 0.3 and with 6 up to 0.7, 1e-6 with 8 up to 0.9. Beyond,
    `steep` crowds 16 nodes towards the end, where the density rises: 3e-5.
    """
    low_x, high_x = (-half_length - gaussian.x) / gaussian.sigma_x, (half_length - gaussian.x) / gaussian.sigma_x
    low_y, high_y = (-half_width - gaussian.y) / gaussian.sigma_y, (half_width - gaussian.y) / gaussian.sigma_y
    mass = _interval_mass(low_x, high_x) * _interval_mass(low_y, high_y)
    # Mirrored so that the correlation is positive: 1 + r below would cancel near -1.
    negative = gaussian.correlation < 0
    low_y, high_y = jnp.where(negative, -high_y, low_y), jnp.where(negative, -low_y, high_y)
    final = jnp.minimum(jnp.abs(gaussian.correlation), LARGEST_CORRELATION)
    for r, cos, weight in _steep_nodes(final, nodes) if steep else _nodes(final, nodes):
        per_difference, per_product = -0.5 / cos**2, -1.0 / (1.0 + r)

        def density(h: Array, k: Array, a: Array = per_difference, b: Array = per_product) -> Array:
            return jnp.exp(a * (h - k) ** 2 + b * h * k)

        same = density(high_x, high_y) + density(low_x, low_y)
        opposite = density(low_x, high_y) + density(high_x, low_y)
        mass = mass + weight * (same - opposite)
    return jnp.clip(mass, 0.0, 1.0)


def _nodes(final: Array, nodes: int) -> Iterator[tuple[Array, Array, Array]]:
    """Correlations r, √(1 - r²) and weights of the quadrature over r from 0 to `final`: no trigonometry."""
    for x, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
        r = final * np.float32((1 + x) / 2)
        cos = jnp.sqrt(1.0 - r**2)
        yield r, cos, final * np.float32(weight / (4 * np.pi)) / cos


def _steep_nodes(final: Array, nodes: int) -> Iterator[tuple[Array, Array, Array]]:
    """As `_nodes`, over the angle asin r, with quadratically more nodes towards its end."""
    angle = jnp.arcsin(final)
    for x, weight in zip(*np.polynomial.legendre.leggauss(nodes), strict=True):
        rest = (1 - x) / 2
        at = np.float32(1 - rest**2) * angle
        yield jnp.sin(at), jnp.cos(at), np.float32(weight * rest / (2 * np.pi)) * angle


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
    prediction = prediction.first(pose.shape[2])
    near, strongest = _near_rows(config, pose, prediction)
    one_scenario = jax.tree.map(lambda leaf: leaf[None], (pose, prediction, near, strongest))
    return 1000.0 * _batch_summer(config.vehicle)(*one_scenario).reshape(-1)


def _near_rows(config: PlannerConfig, pose: Array, prediction: Prediction) -> tuple[Array, Array]:
    """Which rows `[rows, obstacles, steps]` have any mass, and the largest |correlation| within each."""
    vehicle = config.vehicle
    x, y, cos, sin = (pose[:, :, None, :, i] for i in range(4))
    seen = in_ego_frame(x, y, cos, sin, prediction.mean, prediction.covariance)
    body = 0.5 * jnp.hypot(prediction.length, prediction.width)[:, None]
    near_along = jnp.abs(seen.x) < 0.5 * vehicle.length + body + NEGLIGIBLE_DISTANCE * seen.sigma_x
    near_across = jnp.abs(seen.y) < 0.5 * vehicle.width + body + NEGLIGIBLE_DISTANCE * seen.sigma_y
    near = jnp.any(near_along & near_across, axis=1) & prediction.valid
    return near, jnp.minimum(jnp.max(jnp.abs(seen.correlation), axis=1), 1.0)


@functools.cache
def _batch_summer(vehicle: Vehicle) -> Callable[[Array, Prediction, Array, Array], Array]:
    """The sum of masses for a batch of scenarios, such that `vmap` makes the batch larger.

    Under plain `vmap` every scenario would wait for the one with the most traffic, and evaluate padding meanwhile. So
    the rule for a new batch axis is to merge it with the axis that is there: near rows of all scenarios share a queue.
    """

    @jax.custom_batching.custom_vmap
    def summed(pose: Array, prediction: Prediction, near: Array, strongest: Array) -> Array:
        cost, lowest = jnp.zeros(pose.shape[:3]), -1.0
        for highest, nodes, steep in CORRELATION_CLASSES:
            chosen = near & (strongest > lowest) & (strongest <= highest)
            cost = _accumulate(vehicle, cost, pose, prediction, chosen, nodes, steep)
            lowest = highest
        return cost

    @summed.def_vmap
    def merge_axes(size: int, batched: Any, *arguments: Any) -> tuple[Array, bool]:
        def merged(leaf: Array, has_axis: bool) -> Array:
            leaf = leaf if has_axis else jnp.broadcast_to(leaf, (size, *leaf.shape))
            return leaf.reshape(-1, *leaf.shape[2:])

        cost = summed(*jax.tree.map(merged, arguments, tuple(batched)))
        return cost.reshape(size, -1, *cost.shape[1:]), True

    return summed


def _accumulate(
    vehicle: Vehicle, cost: Array, pose: Array, prediction: Prediction, chosen: Array, nodes: int, steep: bool
) -> Array:
    """Add the masses of the chosen rows to `cost`, chunk by chunk.

    Shapes: `cost` `[scenarios, rows, end offsets]`, `pose` `[scenarios, rows, end offsets, steps, 4]`, `chosen`
    `[scenarios, rows, obstacles, steps]`.
    """
    scenarios, rows, obstacles, steps = chosen.shape
    chosen = chosen.reshape(-1)
    count = jnp.sum(chosen)
    place = jnp.where(chosen, jnp.cumsum(chosen) - 1, chosen.size + CHUNK)
    queue = jnp.full(chosen.size + CHUNK, chosen.size, jnp.int32)
    queue = queue.at[place].set(jnp.arange(chosen.size, dtype=jnp.int32), mode="drop")

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        start, total = carry
        index = jax.lax.dynamic_slice(queue, (start,), (CHUNK,))
        place = jnp.unravel_index(jnp.minimum(index, chosen.size - 1), (scenarios, rows, obstacles, steps))
        scenario, row, obstacle, step = place
        mass = _weighted_mass(
            vehicle, pose[scenario, row, :, step], prediction.at(scenario, obstacle, step), nodes, steep
        )
        return start + CHUNK, total.at[scenario, row].add(jnp.where((index < chosen.size)[:, None], mass, 0.0))

    return jax.lax.while_loop(lambda carry: carry[0] < count, body, (jnp.int32(0), cost))[1]


def _weighted_mass(vehicle: Vehicle, pose: Array, obstacle: Prediction, nodes: int, steep: bool) -> Array:
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
    return jnp.sum(weight * rectangle_mass(points, 0.5 * vehicle.length, 0.5 * vehicle.width, nodes, steep), axis=0)
