"""CommonRoad 2020a documents from commonroad-io objects, always the same bytes for the same content."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from jaxfrenet import DT

DATE = "2025-01-01"
"""Written into the files in place of today, so that they can be reproduced."""


def document(
    benchmark_id: str,
    lanelets: Sequence[Any],
    obstacles: Sequence[Any],
    problem: Any,
    *,
    source: str,
    tag: str,
    decimals: int = 4,
) -> bytes:
    """A CommonRoad file's content, without white space.

    Args:
      benchmark_id: the scenario's name by CommonRoad's rules.
      lanelets: of the road network.
      obstacles: other road users.
      problem: the planning problem.
      source: where the scenario comes from.
      tag: one of CommonRoad's tags.
      decimals: digits after the point.
    """
    from commonroad.common.file_writer import CommonRoadFileWriter
    from commonroad.common.writer.file_writer_interface import OverwriteExistingFile
    from commonroad.planning.planning_problem import PlanningProblemSet
    from commonroad.scenario.lanelet import LaneletNetwork
    from commonroad.scenario.scenario import Location, Scenario, ScenarioID, Tag

    scenario = Scenario(DT, ScenarioID.from_benchmark_id(benchmark_id, "2020a"))
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        scenario.add_objects(LaneletNetwork.create_from_lanelet_list(list(lanelets)))
        scenario.add_objects(list(obstacles))
        problems = PlanningProblemSet([problem])
        about = "jaxfrenet", "", source, {Tag(tag)}, Location()
        writer = CommonRoadFileWriter(scenario, problems, *about, decimal_precision=decimals)
        file = str(Path(folder) / "scenario.xml")
        writer.write_to_file(file, OverwriteExistingFile.ALWAYS)
        tree = ElementTree.parse(file).getroot()
    tree.set("date", DATE)
    for node in tree.iter():
        node.text, node.tail = (node.text or "").strip() or None, None
    return ElementTree.tostring(tree, encoding="utf-8", xml_declaration=True)
