"""A small world for tests: a straight road along x with boxes on it, always of the same array sizes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.road import BIN_LENGTH

LENGTH, STEPS, OBSTACLES = 300.0, 61, 3


@dataclasses.dataclass(frozen=True)
class Thing:
    """An obstacle that keeps its speed."""

    x: float
    y: float
    speed: float = 0.0
    heading: float = 0.0
    length: float = 5.0
    width: float = 2.0
    static: bool = False
    steps: tuple[int, int] = (0, STEPS)


def single(values) -> jax.Array:
    return jnp.asarray(values, jnp.float32)


def obstacles_of(things: Sequence[Thing]) -> jf.Obstacles:
    exists = [True] * len(things) + [False] * (OBSTACLES - len(things))
    things = [*things, *[Thing(0.0, 50.0)] * (OBSTACLES - len(things))]
    time = 0.1 * np.arange(STEPS)
    track = [
        np.stack([t.x + t.speed * np.cos(t.heading) * time, t.y + t.speed * np.sin(t.heading) * time], -1)
        for t in things
    ]
    step = np.arange(STEPS)
    valid = [
        np.full(STEPS, e) & (step >= t.steps[0]) & (step < t.steps[1]) for t, e in zip(things, exists, strict=True)
    ]
    return jf.Obstacles(
        position=single(track),
        heading=single([[t.heading] * STEPS for t in things]),
        speed=single([[t.speed] * STEPS for t in things]),
        valid=jnp.asarray(np.array(valid)),
        length=single([t.length for t in things]),
        width=single([t.width for t in things]),
        kind=jnp.full(OBSTACLES, jf.ObstacleKind.CAR, jnp.int32),
        static=jnp.asarray([t.static and e for t, e in zip(things, exists, strict=True)]),
    )


def rectangle(x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def straight_world(
    things: Sequence[Thing] = (),
    *,
    start: tuple[float, float] = (20.0, 0.0),
    heading: float = 0.0,
    speed: float = 10.0,
    yaw_rate: float = 0.0,
    goal: tuple[float, float] | None = (70.0, 110.0),
    goal_steps: tuple[int, int] = (50, 60),
    goal_speed: tuple[float, float] | None = None,
    goal_heading: tuple[float, float] = (0.0, 4.0),
    half_width: float = 6.0,
) -> jf.Scenario:
    """A road from x = -10 to 310 m, `half_width` to both sides of the reference path y = 0."""
    nodes = np.arange(0.0, LENGTH + 1)
    zero, one = np.zeros_like(nodes), np.ones(len(nodes))
    path = jf.ReferencePath(*(single(v) for v in (nodes, nodes, zero, zero, zero, zero)), length=single(LENGTH))
    lanes = jf.Lanes(
        center=single(np.stack([zero, 3.5 * one, -3.5 * one], -1)),
        width=single(np.full((len(nodes), 3), 3.5)),
        direction=jnp.asarray(np.stack([one, -one, 0 * one], -1), jnp.int32),
    )
    lane_map = jf.LaneMap(
        center=single([[[30.0 * piece + 30.0 * node / 16, 0.0] for node in range(17)] for piece in range(10)]),
        length=jnp.full(10, 30.0),
        successors=jnp.asarray([[piece + 1 if piece < 9 else -1] * 3 for piece in range(10)], jnp.int32),
        valid=jnp.ones(10, bool),
    )
    edge = rectangle(-10.0, LENGTH + 10, -half_width, half_width)
    bins = int(LENGTH / BIN_LENGTH) + 1
    road = jf.Road(single(edge), jnp.ones(4, bool), jnp.tile(jnp.arange(4, dtype=jnp.int32), (bins, 1)))
    region = rectangle(*(goal or (0.0, 0.0)), -half_width, half_width)
    target = jf.Goal(
        edges=single(region[None]),
        edge_valid=jnp.full((1, 4), goal is not None),
        has_position=jnp.asarray([goal is not None]),
        steps=jnp.asarray([goal_steps], jnp.int32),
        speed=single([goal_speed or (-1e3, 1e3)]),
        has_speed=jnp.asarray([goal_speed is not None]),
        heading=single([goal_heading]),
        arc_length=single([goal or (0.0, LENGTH)]),
        valid=jnp.asarray([True]),
    )
    initial = jf.InitialState(single(start), single(heading), single(speed), single(0.0), single(yaw_rate))
    return jf.Scenario(path, lanes, lane_map, road, obstacles_of(things), target, initial, single([0.0, 0.0]))


@pytest.fixture(scope="session")
def world() -> Callable[..., jf.Scenario]:
    return straight_world


@pytest.fixture(scope="session")
def thing() -> type[Thing]:
    return Thing


CONFIG = jf.PlannerConfig(sampling_level=1, predictor="ground_truth")


@pytest.fixture(scope="session")
def config() -> jf.PlannerConfig:
    return CONFIG


@pytest.fixture(scope="session")
def plan() -> Callable[..., jf.PlanningCycle]:
    """`plan(scenario, state)` with the default weights, compiled once."""
    compiled = jax.jit(partial(jf.plan, CONFIG))
    return lambda scenario, state: compiled(scenario, state, jf.CostWeights())


@pytest.fixture(scope="session")
def drive() -> Callable[..., jf.Episode]:
    """`drive(scenario)` with the default weights, compiled once."""
    return lambda scenario: jf.roll_out(CONFIG, scenario, jf.CostWeights(), 80)
