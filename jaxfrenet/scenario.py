"""What exists: recorded obstacles, lanes, road edge, goal and initial state of one scenario, as padded arrays.

Positions are in metres in a local frame whose origin is `Scenario.origin` in the file's own coordinates (whole
metres, so that it is exact in float32). Step 0 is the initial state's; one step is 0.1 s. Every array may be padded;
`valid` masks tell which entries exist. A batch has one more leading axis on every leaf.
"""

from __future__ import annotations

from enum import IntEnum

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.reference_path import ReferencePath


class ObstacleKind(IntEnum):
    """What an obstacle is; decides its mass and how it protects its passengers."""

    UNKNOWN = 0
    CAR = 1
    TRUCK = 2
    BUS = 3
    MOTORCYCLE = 4
    BICYCLE = 5
    PEDESTRIAN = 6
    TRAIN = 7
    PARKED_VEHICLE = 8
    STRUCTURE = 9
    """Anything that is not a road user: construction zone, building, pillar, median strip, road boundary."""


@pytree_dataclass
class Obstacles:
    """Recorded obstacles as oriented boxes over time; a scenario without any has one that is never valid."""

    position: Float[Array, "*batch obstacles steps 2"]
    """`[obstacles, steps, 2]`, m, centre of the box."""
    heading: Float[Array, "*batch obstacles steps"]
    """`[obstacles, steps]`, rad."""
    speed: Float[Array, "*batch obstacles steps"]
    """`[obstacles, steps]`, m/s, along the heading."""
    valid: Bool[Array, "*batch obstacles steps"]
    """`[obstacles, steps]`, whether the obstacle exists at the step."""
    length: Float[Array, "*batch obstacles"]
    """`[obstacles]`, m."""
    width: Float[Array, "*batch obstacles"]
    """`[obstacles]`, m."""
    kind: Int[Array, "*batch obstacles"]
    """`[obstacles]`, an `ObstacleKind`."""
    static: Bool[Array, "*batch obstacles"]
    """`[obstacles]`, whether it never moves."""

    def present(self, step: Int[Array, ""]) -> Bool[Array, "obstacles"]:
        """`[obstacles]`, whether each exists at `step`, which may lie beyond the record; static ones always do."""
        last = self.valid.shape[1] - 1
        return (self.valid[:, jnp.minimum(step, last)] & (step <= last)) | self.static


@pytree_dataclass
class Lanes:
    """The ego's lane and its neighbours at each node of the reference path; order of the axis `lane`: own, left, right.

    Offsets are along the path's left normal, so the own lane's centre is near 0.
    """

    center: Float[Array, "*batch nodes 3"]
    """`[nodes, lane]`, m, offset of the lane's centre line; 0 where there is no lane."""
    width: Float[Array, "*batch nodes 3"]
    """`[nodes, lane]`, m; 0 where there is no lane."""
    direction: Int[Array, "*batch nodes 3"]
    """`[nodes, lane]`, 1 same direction as the route, -1 oncoming, 0 no such lane."""


LANE_NODES = 17
"""Nodes of a piece of lane in `LaneMap`."""


@pytree_dataclass
class LaneMap:
    """Where the map's lanes lead, cut into pieces that follow each other: what predictors see of the road."""

    center: Float[Array, "*batch pieces nodes 2"]
    """`[pieces, LANE_NODES, 2]`, m, nodes of the lane's centre line at equal distances, in driving direction."""
    length: Float[Array, "*batch pieces"]
    """`[pieces]`, m, along the centre line."""
    successors: Int[Array, "*batch pieces 3"]
    """`[pieces, way]`, the piece that follows for who keeps to the left, goes straight on, keeps to the right; the same
    one where the lane does not fork, -1 where it ends."""
    valid: Bool[Array, "*batch pieces"]
    """`[pieces]`."""


@pytree_dataclass
class Road:
    """The road surface's edge as line segments; the surface is where an odd number of them is crossed to infinity."""

    segments: Float[Array, "*batch segments 2 2"]
    """`[segments, end, xy]`, m."""
    valid: Bool[Array, "*batch segments"]
    """`[segments]`."""
    nearby: Int[Array, "*batch bins nearby"]
    """`[bins, nearby]`, for each stretch of the reference path the segments that a vehicle there can touch; -1 is
    padding. See `jaxfrenet.road.index_segments`."""


@pytree_dataclass
class Goal:
    """Where, when, how fast and in which direction the scenario wants the ego; any one of the goal states will do."""

    edges: Float[Array, "*batch goals edges 2 2"]
    """`[goals, edges, end, xy]`, m, outline of the goal state's region (even-odd rule)."""
    edge_valid: Bool[Array, "*batch goals edges"]
    """`[goals, edges]`."""
    has_position: Bool[Array, "*batch goals"]
    """`[goals]`, False where the goal state names no region: every position will do."""
    steps: Int[Array, "*batch goals 2"]
    """`[goals, 2]`, first and last step."""
    speed: Float[Array, "*batch goals 2"]
    """`[goals, 2]`, m/s, lowest and highest speed; -1e3 and 1e3 where the goal state names none."""
    has_speed: Bool[Array, "*batch goals"]
    """`[goals]`, whether the goal state names a speed interval."""
    heading: Float[Array, "*batch goals 2"]
    """`[goals, 2]`, rad, middle and half width of the interval; half width ≥ π where the goal state names none."""
    arc_length: Float[Array, "*batch goals 2"]
    """`[goals, 2]`, m, where the reference path enters and leaves the region (0 and the path's length without one)."""
    valid: Bool[Array, "*batch goals"]
    """`[goals]`."""


@pytree_dataclass
class InitialState:
    """The ego at step 0, as CommonRoad gives it: at the vehicle's centre."""

    position: Float[Array, "*batch 2"]
    """`[2]`, m, vehicle centre."""
    heading: Float[Array, "*batch"]
    """`[]`, rad."""
    speed: Float[Array, "*batch"]
    """`[]`, m/s."""
    acceleration: Float[Array, "*batch"]
    """`[]`, m/s²."""
    yaw_rate: Float[Array, "*batch"]
    """`[]`, rad/s."""


@pytree_dataclass
class PredictionTable:
    """What a predictor says at every step of the record: recorded traffic does not react, so it can be known before."""

    mean: Float[Array, "*batch obstacles horizon 2"]
    """`[steps, obstacles, horizon, 2]`, m."""
    covariance: Float[Array, "*batch obstacles horizon 3"]
    """`[steps, obstacles, horizon, (xx, xy, yy)]`, m²."""
    heading: Float[Array, "*batch obstacles horizon"]
    """`[steps, obstacles, horizon]`, rad."""
    speed: Float[Array, "*batch obstacles horizon"]
    """`[steps, obstacles, horizon]`, m/s."""


@pytree_dataclass
class Scenario:
    """One driving task: everything that the planner and the closed loop read."""

    path: ReferencePath
    lanes: Lanes
    lane_map: LaneMap
    road: Road
    obstacles: Obstacles
    goal: Goal
    initial_state: InitialState
    origin: Float[Array, "*batch 2"]
    """`[2]`, m, the local frame's origin in the file's coordinates."""
    predictions: PredictionTable | None = None
    """Predictions that planning looks up; without them the predictor runs in each cycle. See `with_predictions`."""
