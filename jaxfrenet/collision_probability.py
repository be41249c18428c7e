"""How probable it is that an obstacle, predicted as a Gaussian, stands where the ego is.

The work is cut into tiles: one end speed at one point with one obstacle, for all end times and end offsets, whose
poses lie close together. Tiles whose mass is negligible are left out; the others are put in a queue and evaluated
some at a time for as long as there are any, so the work follows the traffic and nothing is ever dropped.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from jaxfrenet._compilation import merging_batches
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.config import PlannerConfig
from jaxfrenet.gaussian import ANY_CORRELATION, Gaussian, Quadrature, Rule, Series, in_ego_frame, rectangle_mass
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.trajectories import Rows, Track, place
from jaxfrenet.vehicle import Vehicle

T = TypeVar("T")

NEGLIGIBLE_DISTANCE = 5.3
"""Beyond this many standard deviations to the side a Gaussian has less than 6e-8 of its mass."""
FEWEST_AT_ONCE, MOST_AT_ONCE = 128, 512
"""Tiles evaluated at once: enough to keep a processor busy, few enough to stay in its caches."""
FEWEST_ROUNDS, MOST_ROUNDS = 64, 256
"""In how many rounds all tiles would be evaluated: in small batches few wait for the last to fill up, and batches of
thousands, which only accelerators get, are evaluated with wider rounds."""
CORRELATION_CLASSES = (
    (0.1, Series(6)),
    (0.3, Series(11)),
    (0.6, Series(20)),
    (0.9, Quadrature(8)),
    (1.0, ANY_CORRELATION),
)
"""Largest |correlation| of a class of tiles, and what computes their masses."""


@pytree_dataclass
class _Work:
    """What the tiles of a batch of scenarios are made of."""

    track: Track
    """`[scenarios, points, end speeds, end times]`."""
    shift: Array
    """`[scenarios, end offsets]`, m."""
    prediction: Prediction
    """`[scenarios, obstacles, points]`."""


@pytree_dataclass
class _Queue:
    """Numbers of the tiles that are waiting, `count` of them; filled up to a multiple of what is taken at once."""

    numbers: Array
    count: Array


def collision_probability_cost(
    config: PlannerConfig, rows: Rows, prediction: Prediction
) -> Float[Array, "end_offsets rows"]:
    """1000 · Σ over obstacles and points i ≥ 1 of p(centre) + 0.5 · Σ p(four corners).

    p is the mass of the obstacle's predicted position at that time inside the ego's box, for the obstacle's centre
    and for its four corners as if each were the position.

    Args:
      config: the vehicle, and how many end times the rows have.
      rows: the bundle.
      prediction: point i of a trajectory meets entry i - 1.
    """
    steps, end_times = config.horizon_steps, len(config.end_steps)
    track = jax.tree.map(lambda leaf: leaf[1:].reshape(steps, -1, end_times), rows.points.track)
    total = _summer(config.vehicle)(_Work(track, rows.shift, prediction.first(steps)))
    return 1000.0 * jnp.moveaxis(total, 1, 0).reshape(rows.lateral_jerk.shape)


@functools.cache
def _summer(vehicle: Vehicle) -> Callable[[_Work], Array]:
    """`_sum_tiles` for one scenario; in a batch, the tiles of all scenarios share a queue."""
    return merging_batches(functools.partial(_sum_tiles, vehicle))


def _sum_tiles(vehicle: Vehicle, work: _Work) -> Array:
    """Sums `[scenarios, end speeds, end offsets, end times]` over obstacles and points."""
    scenarios, _, end_speeds, end_times = work.track.x.shape
    near = _near_tiles(vehicle, work)
    most = max(MOST_AT_ONCE, near.size // MOST_ROUNDS)
    at_once = min(max(near.size // FEWEST_ROUNDS, FEWEST_AT_ONCE), most)
    filling = -near.size % at_once
    every = jnp.arange(near.size + filling, dtype=jnp.int32)
    queue = _enqueue(jnp.pad(near.reshape(-1), (0, filling)), every)
    strongest = _strongest_correlations(vehicle, work, queue, near.shape, at_once)
    total, lowest = jnp.zeros((scenarios, end_speeds, work.shift.shape[1], end_times)), -1.0
    for highest, rule in CORRELATION_CLASSES:
        chosen = _enqueue((strongest > lowest) & (strongest <= highest), queue.numbers)

        def add(number: Array, exists: Array, total: Array, rule: Rule = rule) -> Array:
            tiles = _look_at(vehicle, work, number, near.shape)
            mass = jnp.where(exists[:, None, None], _weighted_mass(vehicle, tiles, rule), 0.0)
            return total.at[tiles.scenario, tiles.end_speed].add(mass)

        total = _serve(chosen, at_once, add, total)
        lowest = highest
    return total


def _near_tiles(vehicle: Vehicle, work: _Work) -> Array:
    """Which tiles `[scenarios, obstacles, points, end speeds]` may have any mass.

    The rear axles of a row's poses lie on a line across the path; obstacles farther from it than the ego, the obstacle
    and `NEGLIGIBLE_DISTANCE` reach are out of the question.
    """
    track, predicted = work.track, work.prediction
    low, high = (limit(work.shift, axis=1)[:, None, None, None] for limit in (jnp.min, jnp.max))
    middle, half = track.base + track.gain * 0.5 * (low + high), jnp.abs(track.gain) * 0.5 * (high - low)
    covariance = predicted.covariance
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    largest = 0.5 * (xx + yy) + jnp.hypot(0.5 * (xx - yy), xy)
    body = 0.5 * jnp.hypot(predicted.length, predicted.width)[..., None]
    ego = vehicle.rear_axle_to_center + 0.5 * (vehicle.length**2 + vehicle.width**2) ** 0.5
    reach = (ego + body + NEGLIGIBLE_DISTANCE * jnp.sqrt(largest))[..., None, None]
    dx = predicted.mean[..., 0, None, None] - track.x[:, None]
    dy = predicted.mean[..., 1, None, None] - track.y[:, None]
    along = dx * track.cos[:, None] + dy * track.sin[:, None]
    across = jnp.abs(dy * track.cos[:, None] - dx * track.sin[:, None] - middle[:, None]) - half[:, None]
    near = along**2 + jnp.maximum(across, 0.0) ** 2 < reach**2
    return jnp.any(near, axis=-1) & predicted.valid[..., None]


def _enqueue(chosen: Array, numbers: Array) -> _Queue:
    """Queue those numbers `[tiles]` that are chosen."""
    place = jnp.where(chosen, jnp.cumsum(chosen) - 1, chosen.size)
    return _Queue(jnp.zeros_like(numbers).at[place].set(numbers, mode="drop"), jnp.sum(chosen))


def _serve(queue: _Queue, at_once: int, work: Callable[[Array, Array, T], T], carry: T) -> T:
    """What `work(numbers, exist, carry)` makes of `carry`, some `at_once` after the other until the queue is empty."""

    def body(state: tuple[Array, T]) -> tuple[Array, T]:
        start, carry = state
        number = jax.lax.dynamic_slice(queue.numbers, (start,), (at_once,))
        return start + at_once, work(number, start + jnp.arange(at_once) < queue.count, carry)

    return jax.lax.while_loop(lambda state: state[0] < queue.count, body, (jnp.int32(0), carry))[1]


@pytree_dataclass
class _Tiles:
    """Some tiles; poses are `[tiles, end offsets, end times]`, the rest broadcasts to them."""

    scenario: Array
    """`[tiles]`."""
    end_speed: Array
    """`[tiles]`, which of them."""
    seen: Gaussian
    """The obstacle's centre from the ego."""
    turn_cos: Array
    """Direction of the obstacle's heading from the ego's."""
    turn_sin: Array
    length: Array
    """m, of the obstacle."""
    width: Array


def _look_at(vehicle: Vehicle, work: _Work, number: Array, shape: tuple[int, ...]) -> _Tiles:
    """The tiles with some numbers, in a batch whose tiles have the axes `shape`."""
    scenario, obstacle, point, end_speed = jnp.unravel_index(number, shape)
    track = jax.tree.map(lambda leaf: leaf[scenario, point, end_speed][:, None], work.track)
    obstacle = jax.tree.map(lambda leaf: leaf[..., None, None], work.prediction.at(scenario, obstacle, point))
    pose = place(track, work.shift[scenario][:, :, None])
    x, y = pose.center(vehicle)
    mean, covariance = jnp.moveaxis(obstacle.mean, 1, -1), jnp.moveaxis(obstacle.covariance, (1, 2), (-2, -1))
    heading_cos, heading_sin = jnp.cos(obstacle.heading), jnp.sin(obstacle.heading)
    return _Tiles(
        scenario=scenario,
        end_speed=end_speed,
        seen=in_ego_frame(x, y, pose.cos, pose.sin, mean, covariance),
        turn_cos=pose.cos * heading_cos + pose.sin * heading_sin,
        turn_sin=pose.cos * heading_sin - pose.sin * heading_cos,
        length=obstacle.length,
        width=obstacle.width,
    )


def _strongest_correlations(
    vehicle: Vehicle, work: _Work, queue: _Queue, shape: tuple[int, ...], at_once: int
) -> Array:
    """The largest |correlation| among each queued tile's pairs that have any mass; -1 if none has."""

    def look(number: Array, exists: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        start, strongest = found
        tiles = _look_at(vehicle, work, number, shape)
        seen, cos, sin = tiles.seen, jnp.abs(tiles.turn_cos), jnp.abs(tiles.turn_sin)
        body_along = 0.5 * (vehicle.length + tiles.length * cos + tiles.width * sin)
        body_across = 0.5 * (vehicle.width + tiles.length * sin + tiles.width * cos)
        near_along = jnp.abs(seen.x) < body_along + NEGLIGIBLE_DISTANCE * seen.sigma_x
        near_across = jnp.abs(seen.y) < body_across + NEGLIGIBLE_DISTANCE * seen.sigma_y
        correlation = jnp.minimum(jnp.abs(seen.correlation), 1.0)
        largest = jnp.max(jnp.where(near_along & near_across, correlation, -1.0), axis=(1, 2))
        largest = jnp.where(exists, largest, -1.0)
        return start + at_once, jax.lax.dynamic_update_slice(strongest, largest, (start,))

    return _serve(queue, at_once, look, (jnp.int32(0), jnp.full(queue.numbers.shape, -1.0)))[1]


def _weighted_mass(vehicle: Vehicle, tiles: _Tiles, rule: Rule) -> Array:
    """p(centre) + 0.5 Σ p(corners) of every pose in the tiles."""
    seen, half_length, half_width = tiles.seen, 0.5 * tiles.length, 0.5 * tiles.width
    mass = jnp.zeros_like(seen.x)
    for weight, along, across in ((1.0, 0, 0), (0.5, 1, 1), (0.5, 1, -1), (0.5, -1, 1), (0.5, -1, -1)):
        ahead, left = along * half_length, across * half_width
        point = Gaussian(
            seen.x + ahead * tiles.turn_cos - left * tiles.turn_sin,
            seen.y + ahead * tiles.turn_sin + left * tiles.turn_cos,
            seen.sigma_x,
            seen.sigma_y,
            seen.correlation,
        )
        mass += weight * rectangle_mass(point, 0.5 * vehicle.length, 0.5 * vehicle.width, rule)
    return mass
