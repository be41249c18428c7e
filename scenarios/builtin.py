"""Two small CommonRoad scenarios of our own, kept in the repository: a T-junction and a slower car ahead.

`write_builtin` draws them; the files it wrote lie in `scenarios/data`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxfrenet import DT
from scenarios.document import document
from scenarios.files import written_whole
from scenarios.polyline import Points, at_arc_lengths

LANE_WIDTH = 3.5
GOAL_STEPS = (110, 120)
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9

Line = NDArray[np.float64]
"""`[points, 3]`, x, y [m] and heading [rad]: bounds of lanelets that follow each other meet exactly."""


def builtin_paths() -> tuple[Path, ...]:
    """The CommonRoad files that come with the package."""
    return tuple(sorted((Path(__file__).parent / "data").glob("*.xml")))


def write_builtin(folder: str | Path) -> tuple[Path, ...]:
    """Write the two scenarios into a folder, as `ZAM_Builtin-1_1_T-1.xml` and `ZAM_Builtin-1_2_T-1.xml`."""
    paths = []
    for number, draw in enumerate((_t_junction, _slower_car), start=1):
        name = f"ZAM_Builtin-1_{number}_T-1"
        paths.append(Path(folder) / f"{name}.xml")
        with written_whole(paths[-1]) as file:
            file.write(document(name, *draw(), source="hand-made", tag="urban"))
    return tuple(paths)


def _t_junction() -> tuple[list[Any], list[Any], Any]:
    """The ego comes from the west and turns left to the north, through oncoming traffic from the east."""
    half = 0.5 * LANE_WIDTH
    lanes = {
        1: _line((-100.0, -half), (-10.0, -half)),
        2: _line((-10.0, -half), (10.0, -half)),
        3: _turn((-10.0, -half), 0.0, 10.0 + half, left=True),
        4: _line((10.0, -half), (100.0, -half)),
        5: _line((100.0, half), (10.0, half)),
        6: _line((10.0, half), (-10.0, half)),
        7: _turn((10.0, half), np.pi, 10.0 - half, left=False),
        8: _line((-10.0, half), (-100.0, half)),
        9: _line((half, 10.0), (half, 100.0)),
        10: _line((-half, 100.0), (-half, 10.0)),
        11: _turn((-half, 10.0), -0.5 * np.pi, 10.0 - half, left=False),
        12: _turn((-half, 10.0), -0.5 * np.pi, 10.0 + half, left=True),
    }
    followers = {1: (2, 3), 2: (4,), 3: (9,), 5: (6, 7), 6: (8,), 7: (9,), 10: (11, 12), 11: (8,), 12: (4,)}
    opposite = {1: 8, 8: 1, 2: 6, 6: 2, 4: 5, 5: 4, 9: 10, 10: 9}
    lanelets = [
        _lanelet(id_, line, followers, left=opposite.get(id_), left_same_direction=False) for id_, line in lanes.items()
    ]
    oncoming = np.concatenate([lanes[5], lanes[6][1:], lanes[8][1:]])[:, :2]
    leading = np.concatenate([lanes[1], lanes[2][1:], lanes[4][1:]])[:, :2]
    cars = [_car(20 + index, oncoming, 100.0 - x, 8.0) for index, x in enumerate((24.0, 40.0, 96.0))]
    cars.append(_car(23, leading, 80.0, 8.0))
    return lanelets, cars, _problem((-40.0, -half), 0.0, 7.0, [9], (0.0, 10.0), lanelets)


def _slower_car() -> tuple[list[Any], list[Any], Any]:
    """Two lanes in the ego's direction: a slower car ahead in its own, a faster one from behind in the other."""
    along, bend, wave = np.linspace(0.0, 300.0, 301), 6.0, np.pi / 150.0
    headings = np.arctan(-bend * wave * np.sin(wave * along))
    middle = np.stack([along, bend * np.cos(wave * along), headings], axis=1)
    whole = {"right": _beside(middle, -0.5 * LANE_WIDTH), "left": _beside(middle, 0.5 * LANE_WIDTH)}
    parts = [slice(0, 61), slice(60, 126), slice(125, 301)]
    lanelets = []
    for index, part in enumerate(parts):
        right, left = 1 + 2 * index, 2 + 2 * index
        followers = {right: (right + 2,), left: (left + 2,)} if index < 2 else {}
        lanelets.append(_lanelet(right, whole["right"][part], followers, left=left, left_same_direction=True))
        lanelets.append(_lanelet(left, whole["left"][part], followers, right=right, right_same_direction=True))
    cars = [_car(20, whole["right"][:, :2], 75.0, 6.0), _car(21, whole["left"][:, :2], 18.0, 11.0)]
    x, y, heading = whole["right"][45]
    return lanelets, cars, _problem((x, y), float(heading), 8.0, [5, 6], (3.0, 13.0), lanelets)


def _line(start: tuple[float, float], end: tuple[float, float]) -> Line:
    """Points every 5 m or less from start to end."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    count = int(np.ceil(np.hypot(dx, dy) / 5.0)) + 1
    heading = np.arctan2(dy, dx)
    return np.linspace((*start, heading), (*end, heading), count)


def _turn(start: tuple[float, float], heading: float, size: float, *, left: bool) -> Line:
    """A right-angled turn that ends `size` ahead and `size` beside its start [m], with continuous curvature."""
    share = np.linspace(0.0, 1.0, 401)
    angle = 0.5 * np.pi * share**2 * (3.0 - 2.0 * share) * (1.0 if left else -1.0)
    steps = np.stack([np.cos(angle + heading), np.sin(angle + heading)], axis=1)
    curve = np.concatenate([[[0.0, 0.0]], np.cumsum(0.5 * (steps[1:] + steps[:-1]), axis=0)])
    curve *= size * np.sqrt(2.0) / np.linalg.norm(curve[-1])
    return np.column_stack([curve + start, angle + heading])[::20]


def _beside(line: Line, offset: float) -> Line:
    """The line moved by `offset` [m] to its left."""
    x, y, heading = line.T
    return np.stack([x - offset * np.sin(heading), y + offset * np.cos(heading), heading], axis=1)


def _lanelet(
    id_: int,
    line: Line,
    followers: dict[int, tuple[int, ...]],
    *,
    left: int | None = None,
    left_same_direction: bool | None = None,
    right: int | None = None,
    right_same_direction: bool | None = None,
) -> Any:
    from commonroad.scenario.lanelet import Lanelet

    return Lanelet(
        _beside(line, 0.5 * LANE_WIDTH)[:, :2],
        line[:, :2],
        _beside(line, -0.5 * LANE_WIDTH)[:, :2],
        id_,
        predecessor=[before for before, after in followers.items() if id_ in after],
        successor=list(followers.get(id_, ())),
        adjacent_left=left,
        adjacent_left_same_direction=left_same_direction if left is not None else None,
        adjacent_right=right,
        adjacent_right_same_direction=right_same_direction if right is not None else None,
    )


def _car(id_: int, line: Points, start: float, speed: float) -> Any:
    """A car that follows a line from arc length `start` [m] at constant speed [m/s] until the goal's last step."""
    from commonroad.geometry.shape import Rectangle
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
    from commonroad.scenario.state import ExtendedPMState, InitialState
    from commonroad.scenario.trajectory import Trajectory

    along = start + speed * DT * np.arange(GOAL_STEPS[1] + 1)
    points = at_arc_lengths(line, along)
    ahead, behind = at_arc_lengths(line, along + 1.0), at_arc_lengths(line, along - 1.0)
    headings = np.arctan2(*(ahead - behind).T[::-1])
    states: list[Any] = [
        ExtendedPMState(time_step=step, position=point, velocity=speed, orientation=float(heading), acceleration=0.0)
        for step, (point, heading) in enumerate(zip(points, headings, strict=True))
    ]
    initial = InitialState(
        time_step=0,
        position=points[0],
        velocity=speed,
        orientation=float(headings[0]),
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )
    shape = Rectangle(CAR_LENGTH, CAR_WIDTH)
    return DynamicObstacle(
        id_, ObstacleType.CAR, shape, initial, TrajectoryPrediction(Trajectory(1, states[1:]), shape)
    )


def _problem(
    position: tuple[float, ...],
    heading: float,
    speed: float,
    goal: list[int],
    speeds: tuple[float, float],
    lanelets: list,
) -> Any:
    """The planning problem: from a state to goal lanelets within `GOAL_STEPS` and an interval of speeds."""
    from commonroad.common.util import Interval
    from commonroad.geometry.shape import ShapeGroup
    from commonroad.planning.goal import GoalRegion
    from commonroad.planning.planning_problem import PlanningProblem
    from commonroad.scenario.state import CustomState, InitialState

    initial = InitialState(
        time_step=0,
        position=np.array(position),
        velocity=speed,
        orientation=heading,
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )
    region = ShapeGroup([lanelet.polygon for lanelet in lanelets if lanelet.lanelet_id in goal])
    wanted = CustomState(time_step=Interval(*GOAL_STEPS), position=region, velocity=Interval(*speeds))
    return PlanningProblem(100, initial, GoalRegion([wanted], {0: goal}))
