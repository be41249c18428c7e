"""Synthetic inputs of planning cycles: a curved two-way road with as many other cars, and as near, as asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache, partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

import jaxfrenet as jf
from jaxfrenet._typing import Array
from jaxfrenet.sampling import sample_end_states
from jaxfrenet.trajectories import generate
from scenarios import polyline
from scenarios.arrays import float_array, goal_arrays, path_arrays
from scenarios.batching import device_array
from scenarios.goals import ANY_HEADING, GoalState
from scenarios.lanelet_map import LaneletLinks, lane_map_of
from scenarios.lines import Line, integrated, look_up
from scenarios.road import nearby_segments
from scenarios.route_path import RoutePath

Layout = Literal["near", "mixed", "far"]
"""Where the other cars are, see `planning_batch`."""
NEAR = 7.0
"""A trajectory's point and an obstacle are near each other within this distance [m] of their centres."""
LENGTH, SPACING = 300.0, 1.0
"""m, of the reference path and between its nodes."""
CURVATURE, BEND = 0.02, 30.0
"""The road's curvature is the former [1/m] times the sine of the arc length over the latter [m]."""
LANE_WIDTH, ROAD_EDGE, EDGE_SPACING = 3.5, 5.5, 4
"""m; m, from the path to either side; nodes of the path from one corner of the road's edge to the next."""
EGO_MEAN = np.array([30.0, 0.0, 9.0, 0.0, 0.0])
"""The ego's mean arc length [m], offset [m], speed [m/s], acceleration [m/s²], heading relative to the path [rad]."""
EGO_SPREAD = np.array([5.0, 0.3, 0.5, 0.3, 0.02])
"""Farthest from those means."""
GOAL, GOAL_STEPS = (180, 200), (160, 190)
"""Nodes of the path within the goal's region; steps."""
STEPS = 200
"""Recorded steps."""
CAR_LENGTH, CAR_WIDTH = 4.5, 1.8
LANE_PIECES = 10
"""Pieces of a `jaxfrenet.LaneMap` in each lane."""


class Role(NamedTuple):
    """What some of the other cars do at constant speed; pairs are the lowest and highest of what is drawn evenly."""

    heading: float
    """rad, relative to the road."""
    ahead: tuple[float, float]
    """m, along the road, at step 0 from the ego's centre."""
    offset: tuple[float, float]
    """m, to the left of the reference path, at step 0."""
    speed: tuple[float, float]
    """m/s."""


ALONG, ONCOMING, FROM_THE_RIGHT = 0.0, np.pi, 0.5 * np.pi
ROLES: dict[Layout, tuple[Role, ...]] = {
    "near": (
        Role(ALONG, (1.0, 3.0), (-3.4, -2.8), (7.0, 8.0)),
        Role(ALONG, (0.0, 3.0), (2.8, 3.6), (7.0, 8.0)),
        Role(ALONG, (6.5, 8.0), (-0.3, 0.3), (7.5, 8.5)),
    ),
    "mixed": (
        Role(ALONG, (12.0, 14.0), (-0.3, 0.3), (5.0, 6.0)),
        Role(ONCOMING, (15.0, 20.0), (3.5, 3.9), (6.0, 8.0)),
        Role(ALONG, (15.0, 19.0), (-0.3, 0.3), (4.0, 6.0)),
        Role(FROM_THE_RIGHT, (17.0, 20.0), (-15.0, -11.0), (4.0, 6.0)),
        Role(ALONG, (8.0, 10.0), (3.3, 3.7), (7.0, 8.0)),
    ),
    "far": (Role(ONCOMING, (-76.0, -54.0), (3.3, 3.7), (5.0, 9.0)),),
}
"""The cars of a layout take these roles in turn."""


class Nearness(NamedTuple):
    """How near sampled trajectories come to predicted obstacles, from centre to centre."""

    share: float | None
    """Share of the triples of trajectory, obstacle and step that are within `NEAR`; None without obstacles."""
    closest: float
    """m, least distance; infinite without predicted obstacles."""


def planning_batch(
    config: jf.PlannerConfig, layout: Layout, obstacles: int, batch: int, seed: int = 0
) -> tuple[jf.Scenario, jf.SimulationState]:
    """Scenarios with a leading batch axis, and their states at step 0.

    All are on one road, 300 m long, with the ego at about 9 m/s and a goal region 150 m ahead; the ego's start and the
    other cars differ. The first scenarios of a larger batch are those of a smaller one. Of all triples of a sampled
    trajectory, an obstacle and one of 30 coming steps, with predictions of constant velocity:

    - `near`: more than 60 % are within 7 m of each other (cars crowd around the ego, some into each other);
    - `mixed`: 20 to 30 % are (cars ahead, oncoming and crossing);
    - `far`: none is within 50 m, yet all cars are within the sensor's reach of 80 m at step 0 and so are predicted
      (oncoming cars that have passed and drive away).

    Args:
      config: of the planner; its vehicle is the ego.
      layout: where the other cars are.
      obstacles: how many; without any there is one that never exists, as in every scenario.
      batch: how many scenarios.
      seed: other seeds give other scenarios.
    """
    draws = [np.random.default_rng((seed, index)) for index in range(batch)]
    ego = np.stack([EGO_MEAN + EGO_SPREAD * draw.uniform(-1.0, 1.0, 5) for draw in draws])
    shared = jax.tree.map(lambda leaf: device_array(np.broadcast_to(leaf, (batch, *leaf.shape))), _empty_road())
    scenario = dataclasses.replace(shared, initial_state=_initial_state(ego))
    if obstacles:
        cars = np.stack([_draw_cars(draw, ROLES[layout], obstacles) for draw in draws])
        scenario = dataclasses.replace(scenario, obstacles=_driving(ego[:, :1], cars))
    return scenario, jax.jit(jax.vmap(partial(jf.reset, config)))(scenario)


def nearness(config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState) -> Nearness:
    """How near the sampled trajectories of a batch come to what is predicted of its obstacles.

    Args:
      config: sampling, predictor and horizon.
      scenario: with a leading batch axis.
      state: with a leading batch axis.
    """
    share, closest = jax.device_get(_nearness(config, scenario, state))
    exists = bool(np.any(scenario.obstacles.valid))
    return Nearness(float(np.mean(share)) if exists else None, float(np.min(closest)))


@partial(jax.jit, static_argnums=0)
def _nearness(config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState) -> tuple[Array, Array]:
    """Share of near triples `[batch]` and least distance `[batch]`, m."""

    def of_one(inputs: tuple[jf.Scenario, jf.SimulationState]) -> tuple[Array, Array]:
        scenario, state = inputs
        ego = state.ego
        end_states = sample_end_states(config, ego.speed, ego.arc_length_rate, ego.offset)
        pose = generate(config, scenario.path, ego, end_states).pose
        predicted = jf.predict(config, scenario, state.step, ego.x, ego.y)
        center = jnp.stack(pose.center(config.vehicle), axis=-1)
        distance = jnp.linalg.norm(center[:, None, 1:] - predicted.mean, axis=-1)
        distance = jnp.where(predicted.valid, distance, jnp.inf)
        return jnp.mean((distance <= NEAR).astype(jnp.float32)), jnp.min(distance)

    return jax.lax.map(of_one, (scenario, state))


@cache
def _line() -> Line:
    """The reference path: the middle of the ego's lane."""
    arc_length = np.arange(0.0, LENGTH + 0.5 * SPACING, SPACING)

    def heading(along: Array) -> Array:
        return CURVATURE * BEND * (1.0 - jnp.cos(along / BEND))

    slope = CURVATURE / BEND * np.cos(arc_length / BEND)
    curvature = CURVATURE * np.sin(arc_length / BEND)
    return integrated(jnp.zeros(2), float_array(arc_length), heading, float_array(curvature), float_array(slope))


@cache
def _empty_road() -> jf.Scenario:
    """One scenario without a batch axis, with nobody on the road and an ego yet to be placed."""
    line = _line()
    names = [field.name for field in dataclasses.fields(RoutePath)]
    path = RoutePath(**{name: np.asarray(getattr(line, name), np.float64) for name in names})
    left, right = (np.asarray(line.beside(side), np.float64)[::EDGE_SPACING] for side in (ROAD_EDGE, -ROAD_EDGE))
    segments = polyline.ring_edges(np.concatenate([right, left[::-1]]))
    nearby = nearby_segments(path.arc_length, path.points, segments)
    first, last = (node // EDGE_SPACING for node in GOAL)
    region = np.concatenate([right[first : last + 1], left[first : last + 1][::-1]])
    goal = GoalState(polyline.ring_edges(region), (), GOAL_STEPS, None, ANY_HEADING)
    return jf.Scenario(
        path=path_arrays(path),
        lanes=_lanes(len(path.x)),
        lane_map=_lane_map(line),
        road=jf.Road(float_array(segments), device_array(np.ones(len(segments), bool)), device_array(nearby)),
        obstacles=_obstacles(*np.zeros((4, 1, STEPS)), exist=False),
        goal=goal_arrays([goal], path),
        initial_state=jf.InitialState(float_array([0.0, 0.0]), *(float_array(0.0) for _ in range(4))),
        origin=float_array([0.0, 0.0]),
    )


def _lanes(nodes: int) -> jf.Lanes:
    """The ego's lane, the oncoming one to its left, and none to its right."""
    center, width = np.array([0.0, LANE_WIDTH, 0.0]), np.array([LANE_WIDTH, LANE_WIDTH, 0.0])
    return jf.Lanes(
        center=float_array(np.tile(center, (nodes, 1))),
        width=float_array(np.tile(width, (nodes, 1))),
        direction=device_array(np.tile(np.array([1, -1, 0], np.int32), (nodes, 1))),
    )


def _lane_map(line: Line) -> jf.LaneMap:
    """Both lanes, each in its driving direction."""
    right, middle, left = (line.beside(side * LANE_WIDTH) for side in (-0.5, 0.5, 1.5))
    borders = [(middle, right), (middle[::-1], left[::-1])]
    return lane_map_of(borders, (LaneletLinks(()), LaneletLinks(())), (LANE_PIECES, LANE_PIECES))


def _initial_state(ego: NDArray) -> jf.InitialState:
    """Of a batch `[batch, 5]` of arc lengths, offsets, speeds, accelerations and relative headings."""
    arc_length, offset, speed, acceleration, turn = (float_array(column) for column in ego.T)
    on_path = jax.jit(look_up)(_line(), arc_length)
    return jf.InitialState(
        position=on_path.beside(offset),
        heading=on_path.heading + turn,
        speed=speed,
        acceleration=acceleration,
        yaw_rate=speed * on_path.curvature,
    )


def _draw_cars(draw: Generator, roles: Sequence[Role], count: int) -> NDArray:
    """`[cars, 4]`: heading relative to the road [rad], distance ahead of the ego [m], offset [m], speed [m/s]."""
    cars = []
    for index in range(count):
        role = roles[index % len(roles)]
        cars.append([role.heading, *(draw.uniform(*limits) for limits in role[1:])])
    return np.array(cars)


def _driving(start: NDArray, cars: NDArray) -> jf.Obstacles:
    """Tracks of cars `[batch, cars, 4]` around egos at arc lengths `[batch, 1]`; behind its ends the road is straight.

    Cars along the road follow it; those that cross it drive straight on.
    """
    turn, ahead, offset, speed = (cars[..., index, None] for index in range(4))
    driven = speed * jf.DT * np.arange(STEPS)
    along = start[..., None] + ahead + np.cos(turn) * driven
    across = offset + np.sin(turn) * driven
    on_path = jax.device_get(jax.jit(look_up)(_line(), float_array(along)))
    x = on_path.x - across * np.sin(on_path.heading)
    y = on_path.y + across * np.cos(on_path.heading)
    return _obstacles(x, y, on_path.heading + turn, np.broadcast_to(speed, x.shape), exist=True)


def _obstacles(x: NDArray, y: NDArray, heading: NDArray, speed: NDArray, exist: bool) -> jf.Obstacles:
    """Cars with tracks, all `[..., cars, steps]`."""
    cars = x.shape[:-1]
    return jf.Obstacles(
        position=float_array(np.stack([x, y], axis=-1)),
        heading=float_array(heading),
        speed=float_array(speed),
        valid=device_array(np.full(x.shape, exist)),
        length=float_array(np.full(cars, CAR_LENGTH)),
        width=float_array(np.full(cars, CAR_WIDTH)),
        kind=device_array(np.full(cars, jf.ObstacleKind.CAR, np.int32)),
        static=device_array(np.zeros(cars, bool)),
    )
