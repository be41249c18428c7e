"""What the neural predictor sees of each obstacle, in the obstacle's own frame: past, neighbours, lanes ahead."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._angles import wrapped
from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.config import DT
from jaxfrenet.prediction import lane_paths
from jaxfrenet.prediction.lane_paths import LanePaths
from jaxfrenet.scenario import LaneMap, ObstacleKind, Obstacles

HISTORY = 31
"""Steps of the past that are seen, the current one among them: 3 s."""
NEIGHBORS = 8
"""Most neighbours that are seen, the nearest ones."""
NEIGHBORHOOD = 60.0
"""Farthest distance [m] of a neighbour."""
AHEAD = np.array([3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0, 65.0, 80.0], np.float32)
"""Arc lengths [m] at which the lanes ahead are seen."""
ON_PATH = 2.0
"""A neighbour within this distance [m] of a path is on it."""
KINDS = np.array(
    [
        *(ObstacleKind.CAR, ObstacleKind.TRUCK, ObstacleKind.BUS),
        *(ObstacleKind.MOTORCYCLE, ObstacleKind.BICYCLE, ObstacleKind.PEDESTRIAN),
    ],
    np.int32,
)
"""Kinds that are told apart; all others look the same."""
RECENT = 5
"""Steps over which acceleration and yaw rate are taken."""


@pytree_dataclass
class Features:
    """Inputs of the network, of order 1; what does not exist is 0."""

    own: Float[Array, "*batch obstacles own"]
    """`[obstacles, features]`, motion, size and kind."""
    history: Float[Array, "*batch obstacles past"]
    """`[obstacles, HISTORY * 6]`, how the past differs from motion at the current speed and heading."""
    neighbor: Int[Array, "*batch obstacles neighbors"]
    """`[obstacles, neighbours]`, which obstacles these are."""
    relation: Float[Array, "*batch obstacles neighbors relation"]
    """`[obstacles, neighbours, features]`, their motion relative to the obstacle's."""
    neighbor_valid: Bool[Array, "*batch obstacles neighbors"]
    """`[obstacles, neighbours]`."""
    lane: Float[Array, "*batch obstacles paths lane"]
    """`[obstacles, PATHS, features]`, the lane paths ahead and who is on them."""


@pytree_dataclass
class Scene:
    """The obstacles at one step, and the paths that they may follow."""

    position: Float[Array, "*batch obstacles 2"]
    """`[obstacles, 2]`, m."""
    heading: Float[Array, "*batch obstacles"]
    """`[obstacles]`, rad."""
    direction: Float[Array, "*batch obstacles 2"]
    """`[obstacles, 2]`, unit vector along the heading."""
    speed: Float[Array, "*batch obstacles"]
    """`[obstacles]`, m/s."""
    present: Bool[Array, "*batch obstacles"]
    """`[obstacles]`."""
    paths: LanePaths
    """`[obstacles, PATHS]`."""


def observe(
    obstacles: Obstacles, lane_map: LaneMap, step: Int[Array, ""], first_step: Int[Array, ""] | int = 0
) -> tuple[Scene, Features]:
    """What is seen at `step`; nothing later is read.

    Args:
      obstacles: recorded obstacles.
      lane_map: the lanes around them.
      step: the current step.
      first_step: steps before this one are not seen either.
    """
    last = obstacles.valid.shape[1] - 1
    steps = step + jnp.arange(1 - HISTORY, 1)
    index = jnp.clip(steps, 0, last)
    seen = obstacles.valid[:, index] & (steps >= jnp.maximum(first_step, 0)) & (steps <= last)
    position, heading, speed = obstacles.position[:, index], obstacles.heading[:, index], obstacles.speed[:, index]
    now = position[:, -1], heading[:, -1], speed[:, -1]
    present = seen[:, -1]
    direction = jnp.stack([jnp.cos(now[1]), jnp.sin(now[1])], axis=-1)
    find = jax.vmap(lane_paths.find, in_axes=(None, 0, 0, 0))
    paths = find(lane_map, now[0], direction[:, 0], direction[:, 1])
    scene = Scene(now[0], now[1], direction, now[2], present, paths)
    history, motion = _history(scene, position, heading, speed, seen)
    neighbor, neighbor_valid = _nearest(scene)
    return scene, Features(
        own=jnp.concatenate([motion, _sizes_and_kind(obstacles)], axis=-1),
        history=history,
        neighbor=neighbor,
        relation=jnp.where(neighbor_valid[..., None], _relations(scene, obstacles, neighbor), 0.0),
        neighbor_valid=neighbor_valid,
        lane=_lanes(scene, lane_map, obstacles, neighbor, neighbor_valid),
    )


def in_frame(vector: Float[Array, "*#shape 2"], direction: Float[Array, "*#shape 2"]) -> Float[Array, "*shape 2"]:
    """Vectors seen in frames whose first axis points along `direction`; broadcast."""
    cos, sin = direction[..., 0], direction[..., 1]
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def _history(scene: Scene, position: Array, heading: Array, speed: Array, seen: Array) -> tuple[Array, Array]:
    """The past `[obstacles, HISTORY * 6]` and a summary of it `[obstacles, 5]`."""
    time = DT * jnp.arange(1 - HISTORY, 1, dtype=jnp.float32)
    away = in_frame(position - scene.position[:, None], scene.direction[:, None])
    excess = away - jnp.stack([scene.speed[:, None] * time, jnp.zeros_like(speed)], axis=-1)
    turn = wrapped(heading - scene.heading[:, None])
    gain = speed - scene.speed[:, None]
    columns = [
        *(excess[..., 0] / 5.0, excess[..., 1] / 5.0, turn, gain / 5.0),
        *(speed / 10.0, jnp.ones_like(speed)),
    ]
    past = jnp.where(seen[..., None], jnp.clip(jnp.stack(columns, axis=-1), -10.0, 10.0), 0.0)
    recent = seen[:, -1 - RECENT] & seen[:, -1]
    acceleration = jnp.where(recent, -gain[:, -1 - RECENT] / (RECENT * DT), 0.0)
    yaw_rate = jnp.where(recent, -turn[:, -1 - RECENT] / (RECENT * DT), 0.0)
    known = jnp.mean(seen.astype(jnp.float32), axis=1)
    summary = [scene.speed / 10.0, jnp.minimum(scene.speed, 2.0), acceleration / 3.0, 3.0 * yaw_rate, known]
    return past.reshape(len(past), -1), jnp.clip(jnp.stack(summary, axis=-1), -10.0, 10.0)


def _sizes_and_kind(obstacles: Obstacles) -> Array:
    kind = (obstacles.kind[:, None] == jnp.asarray(KINDS)).astype(jnp.float32)
    return jnp.concatenate([obstacles.length[:, None] / 5.0, obstacles.width[:, None] / 2.0, kind], axis=-1)


def _nearest(scene: Scene) -> tuple[Array, Array]:
    """The nearest neighbours of each obstacle and which of them exist, both `[obstacles, neighbours]`."""
    away = scene.position[None] - scene.position[:, None]
    distance = jnp.sum(away**2, axis=-1)
    other = scene.present & ~jnp.eye(len(distance), dtype=bool)
    distance = jnp.where(other & (distance < NEIGHBORHOOD**2), distance, jnp.inf)
    nearest = jnp.argsort(distance, axis=1)[:, :NEIGHBORS].astype(jnp.int32)
    return nearest, jnp.isfinite(jnp.take_along_axis(distance, nearest, axis=1))


def _relations(scene: Scene, obstacles: Obstacles, neighbor: Array) -> Array:
    """Place, velocity, heading and size of the neighbours, `[obstacles, neighbours, 9]`."""
    direction = scene.direction[:, None]
    away = in_frame(scene.position[neighbor] - scene.position[:, None], direction)
    ahead = in_frame(scene.direction[neighbor], direction)
    velocity = scene.speed[neighbor][..., None] * ahead
    distance = jnp.sqrt(jnp.sum(away**2, axis=-1, keepdims=True) + 1.0)
    columns = [away / 20.0, 3.0 / distance, velocity / 10.0, ahead, obstacles.length[neighbor][..., None] / 5.0]
    return jnp.concatenate([*columns, (scene.speed[:, None] - velocity[..., 0])[..., None] / 10.0], axis=-1)


def _lanes(scene: Scene, lane_map: LaneMap, obstacles: Obstacles, neighbor: Array, neighbor_valid: Array) -> Array:
    """Each lane path's course, how the obstacle lies to it, and who is on it, `[obstacles, PATHS, features]`."""
    paths = scene.paths
    places = jnp.broadcast_to(jnp.asarray(AHEAD), (*paths.valid.shape, len(AHEAD)))
    position, tangent = jax.vmap(lane_paths.look_up, in_axes=(None, 0, 0))(lane_map, paths, places)
    direction = scene.direction[:, None, None]
    seen = in_frame(position - scene.position[:, None, None], direction)
    turned = in_frame(tangent, direction)
    course = [(seen[..., 0] - AHEAD) / 20.0, seen[..., 1] / 20.0, turned[..., 1], 1.0 - turned[..., 0]]
    way = jnp.broadcast_to(jnp.tile(jnp.eye(lane_paths.WAYS), (lane_paths.STARTS, 1)), (*paths.valid.shape, 3))
    rank = jnp.asarray(np.repeat(np.arange(lane_paths.STARTS), lane_paths.WAYS), jnp.float32)
    speed = scene.speed[:, None]
    relation = [
        *(paths.offset, paths.sin, 1.0 - paths.cos, paths.sin * speed / 3.0),
        *(jnp.minimum(paths.end, 100.0) / 50.0, jnp.minimum(paths.fork, 100.0) / 50.0),
        *(jnp.minimum(paths.fork, 20.0) / 10.0, jnp.broadcast_to(rank, paths.valid.shape)),
    ]
    others = _on_paths(scene, obstacles, neighbor, neighbor_valid, position, tangent)
    features = jnp.concatenate([*course, jnp.stack(relation, axis=-1), way, others], axis=-1)
    return jnp.where(paths.valid[..., None], features, 0.0)


def _on_paths(
    scene: Scene, obstacles: Obstacles, neighbor: Array, neighbor_valid: Array, position: Array, tangent: Array
) -> Array:
    """The first neighbour on each path that goes along it, and the first that goes across, `[obstacles, PATHS, 8]`."""
    other = scene.position[neighbor][:, None, :, None]
    away = other - position[:, :, None]
    nearest = jnp.argmin(jnp.sum(away**2, axis=-1), axis=-1)

    def at_nearest(table: Array) -> Array:
        return jnp.take_along_axis(table, nearest[..., None, None], axis=3)[..., 0, :]

    at_place = jnp.broadcast_to(tangent[:, :, None], away.shape)
    along = in_frame(at_nearest(away), at_nearest(at_place))
    heading = in_frame(scene.direction[neighbor][:, None], at_nearest(at_place))
    arc_length = jnp.asarray(AHEAD)[nearest] + along[..., 0]
    near = neighbor_valid[:, None] & (jnp.abs(along[..., 1]) < ON_PATH)
    near = near & (jnp.abs(along[..., 0]) < 10.0) & (arc_length > 0.5)
    speed = scene.speed[neighbor][:, None]
    bumper = 0.5 * (obstacles.length[neighbor] + obstacles.length[:, None])[:, None]
    columns = []
    for kind in (near & (heading[..., 0] > 0.5), near & (heading[..., 0] <= 0.5)):
        gap = jnp.where(kind, arc_length - bumper, jnp.inf)
        first = jnp.argmin(gap, axis=-1, keepdims=True)
        gap = jnp.take_along_axis(gap, first, axis=-1)[..., 0]
        exists = jnp.isfinite(gap)
        gap = jnp.where(exists, gap, 100.0)
        other_speed = jnp.take_along_axis(jnp.broadcast_to(speed, kind.shape), first, axis=-1)[..., 0]
        closing = jnp.where(exists, scene.speed[:, None] - other_speed, 0.0)
        columns += [exists.astype(jnp.float32), jnp.clip(gap, -5.0, 100.0) / 30.0]
        columns += [closing / 10.0, 3.0 / jnp.maximum(gap + 2.0, 1.0)]
    return jnp.stack(columns, axis=-1)
