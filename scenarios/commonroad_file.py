"""Reads CommonRoad XML files with commonroad-io, and says in one line what is wrong with a bad one."""

from __future__ import annotations

import logging
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from scenarios.errors import ScenarioError
from scenarios.lanelets import Lanelet, Neighbor, Network
from scenarios.polyline import Points

OBSTACLE_TAGS = ("staticObstacle", "dynamicObstacle", "environmentObstacle", "obstacle")
"""The last one is that of the format 2018b."""
OBSTACLE_STATE = ("position", "orientation", "time")
MANDATORY_STATE = ("position", "orientation", "velocity", "time")


@dataclass(frozen=True)
class CommonRoadFile:
    """One planning problem of a CommonRoad file, as commonroad-io reads it."""

    scenario: Any
    """`commonroad.scenario.scenario.Scenario`."""
    problem: Any
    """`commonroad.planning.planning_problem.PlanningProblem`."""
    acceleration: float
    """Of the ego at its start [m/s²], 0 where the file has none."""
    yaw_rate: float
    """Of the ego at its start [rad/s], 0 where the file has none."""
    without_speed: frozenset[int]
    """Ids of obstacles whose initial state has no speed."""


def parse(data: bytes, planning_problem: int | None) -> CommonRoadFile:
    """Read the content of a CommonRoad XML file and choose a planning problem: the first, or the one with that id.

    Raises:
      ScenarioError: this is no complete CommonRoad file with numbers in it, or has no such planning problem.
    """
    root = _checked_tree(data)
    problem = _problem_node(root, planning_problem)
    with _quiet():
        scenario, problems = _read(data)
    initial = problem.find("initialState")
    assert initial is not None
    return CommonRoadFile(
        scenario=scenario,
        problem=problems.planning_problem_dict[int(problem.get("id", ""))],
        acceleration=_number(initial, "acceleration"),
        yaw_rate=_number(initial, "yawRate"),
        without_speed=frozenset(
            int(node.get("id", "-1"))
            for tag in OBSTACLE_TAGS
            for node in root.findall(tag)
            if node.find("initialState") is not None and node.find("initialState/velocity") is None
        ),
    )


def _read(data: bytes) -> tuple[Any, Any]:
    try:
        from commonroad.common.file_reader import CommonRoadFileReader
        from commonroad.common.util import FileFormat
    except ImportError as error:
        raise ScenarioError(
            f"reading CommonRoad files needs commonroad-io ({error}); install jaxfrenet[commonroad]"
        ) from None
    try:
        return CommonRoadFileReader(data, FileFormat.XML).open()
    except Exception as error:  # commonroad-io has no exception of its own for files that it cannot read
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise ScenarioError(
            f"commonroad-io cannot read it ({reason}); check it against the CommonRoad format"
        ) from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep commonroad-io's warnings and log messages off the terminal."""
    logger = logging.getLogger("commonroad")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _checked_tree(data: bytes) -> ElementTree.Element:
    """The XML tree, with what commonroad-io would trip over or overlook checked beforehand."""
    if not data.strip():
        raise ScenarioError("file is empty; give a CommonRoad XML file")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise ScenarioError(f"not a complete XML file ({error}); it may be truncated, get it again") from None
    if root.tag != "commonRoad":
        raise ScenarioError(f"not a CommonRoad scenario (its root is <{root.tag}>); give a CommonRoad XML file")
    _check_time_step(root)
    if re.search(rb">\s*[+-]?(nan|inf)", data, re.IGNORECASE):
        _refuse_not_finite(root)
    for tag in OBSTACLE_TAGS:
        for node in root.findall(tag):
            _check_obstacle(node)
    return root


def _check_obstacle(node: ElementTree.Element) -> None:
    shape, state = node.find("shape"), node.find("initialState")
    if shape is None or not len(shape):
        raise ScenarioError(f"obstacle {node.get('id')} has no shape; add one to the file")
    for field in OBSTACLE_STATE if node.tag != "environmentObstacle" else ():
        if state is None or state.find(field) is None:
            raise ScenarioError(f"obstacle {node.get('id')}: the initial state has no {field}; add it to the file")


def _check_time_step(root: ElementTree.Element) -> None:
    try:
        file_dt = float(root.get("timeStepSize", ""))
    except ValueError:
        file_dt = math.nan
    if not (math.isfinite(file_dt) and file_dt > 0.0):
        raise ScenarioError(f"timeStepSize is {root.get('timeStepSize')!r}; give the duration of a step in seconds")


def _refuse_not_finite(root: ElementTree.Element) -> None:
    """Raise an error that names the first field whose value is NaN or infinite."""

    def visit(node: ElementTree.Element, where: str) -> None:
        if re.fullmatch(r"\s*[+-]?(nan|inf(inity)?)\s*", node.text or "", re.IGNORECASE):
            raise ScenarioError(f"{where} is {(node.text or '').strip()}; every value must be finite")
        for child in node:
            id_ = f" {child.get('id')}" if child.get("id") else ""
            hidden = child.tag in ("exact", "point", "x", "y")
            visit(child, where if hidden else f"{where} {child.tag}{id_}".strip())

    visit(root, "")


def _problem_node(root: ElementTree.Element, planning_problem: int | None) -> ElementTree.Element:
    nodes = root.findall("planningProblem")
    if not nodes:
        raise ScenarioError("file has no planning problem; choose a scenario that has one")
    ids = [node.get("id", "") for node in nodes]
    if planning_problem is None:
        chosen = nodes[0]
    elif str(planning_problem) in ids:
        chosen = nodes[ids.index(str(planning_problem))]
    else:
        raise ScenarioError(f"no planning problem {planning_problem}; the file has {', '.join(ids)}")
    name = f"planning problem {chosen.get('id')}"
    for field in MANDATORY_STATE:
        if chosen.find(f"initialState/{field}") is None:
            raise ScenarioError(f"{name}: the initial state has no {field}; add it to the file")
    for goal in chosen.findall("goalState") or [None]:
        if goal is None or goal.find("time") is None:
            raise ScenarioError(f"{name} has no goal state with a time; add one to the file")
    return chosen


def _number(state: ElementTree.Element, field: str) -> float:
    """A state's exact value, 0 if it has none; commonroad-io would drop all that follow the first missing one."""
    text = state.findtext(f"{field}/exact")
    try:
        return float(text) if text is not None else 0.0
    except ValueError:
        raise ScenarioError(f"initial state's {field} is {text!r}, not a number; correct the file") from None


def network_of(scenario: Any, origin: Points) -> Network:
    """The lanelets of a commonroad-io scenario in the frame with that origin `[2]` [m]."""
    lanelets = scenario.lanelet_network.lanelets
    known = {lanelet.lanelet_id for lanelet in lanelets}

    def neighbor(id_: int | None, same_direction: bool | None) -> Neighbor | None:
        return Neighbor(id_, bool(same_direction)) if id_ is not None and id_ in known else None

    return {
        lanelet.lanelet_id: Lanelet(
            id=lanelet.lanelet_id,
            left_bound=np.asarray(lanelet.left_vertices, float)[:, :2] - origin,
            right_bound=np.asarray(lanelet.right_vertices, float)[:, :2] - origin,
            predecessors=tuple(id_ for id_ in lanelet.predecessor if id_ in known),
            successors=tuple(id_ for id_ in lanelet.successor if id_ in known),
            left=neighbor(lanelet.adj_left, lanelet.adj_left_same_direction),
            right=neighbor(lanelet.adj_right, lanelet.adj_right_same_direction),
        )
        for lanelet in lanelets
    }
