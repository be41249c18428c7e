"""Generated scenarios as CommonRoad files, read back by the importer."""

from __future__ import annotations

import importlib

import jax
import numpy as np
import pytest

import jaxfrenet as jf
from scenarios import families
from scenarios.batching import leaves_of, pad_to, sizes_of
from scenarios.commonroad import from_bytes
from scenarios.families import Draw

pytest.importorskip("commonroad")
CommonRoadFileWriter = importlib.import_module("commonroad.common.file_writer").CommonRoadFileWriter

EXACT = ("obstacles.", "goal.", "initial_state.", "origin", "lanes.direction", "road.valid")
TOLERANCES = {
    "road.segments": 2e-4,
    "path.arc_length": 1e-6,
    "path.x": 0.03,
    "path.y": 0.03,
    "path.heading": 0.015,
    "path.curvature": 0.02,
    "lanes.center": 0.15,
    "lanes.width": 0.06,
}
"""What is left of corners every few metres: the importer draws its path through them, and measures lanes between."""


@pytest.mark.parametrize("family", list(families.FAMILIES))
def test_an_exported_scenario_reads_back_to_the_same_arrays(family: str) -> None:
    draw = Draw(6, 7, family)
    generated = families.generate(draw)
    documents = dict(families.documents(draw))
    assert list(documents) == [info.name for info in generated.infos]
    for scenario, info in zip(generated.scenarios, generated.infos, strict=True):
        assert CommonRoadFileWriter.check_validity_of_commonroad_file(documents[info.name])
        read, read_info = from_bytes(documents[info.name], f"{info.name}.xml")
        assert read_info.benchmark_id == info.benchmark_id
        assert read_info.planning_problem_id == info.planning_problem_id
        compare(scenario, read)


def compare(scenario: jf.Scenario, read: jf.Scenario) -> None:
    sizes = sizes_of(scenario)
    sizes["pieces"] = max(sizes["pieces"], sizes_of(read)["pieces"])  # cut anew; see test_lane_pieces.py
    assert all(size <= sizes[axis] for axis, size in sizes_of(read).items())
    assert abs(float(scenario.path.length) - float(read.path.length)) <= 1.0
    nodes = int(min(float(scenario.path.length), float(read.path.length)) / 0.25)
    expected, found = leaves_of(scenario), leaves_of(pad_to(read, sizes))
    for name, leaf in expected.items():
        if name.startswith(EXACT):
            np.testing.assert_allclose(
                found[name], leaf, atol=0.25 if name == "goal.arc_length" else 1e-5, err_msg=name
            )
        elif name in TOLERANCES:
            part = slice(nodes) if name.startswith(("path.", "lanes.")) else slice(None)
            np.testing.assert_allclose(found[name][part], leaf[part], atol=TOLERANCES[name], err_msg=name)


def test_the_same_seed_writes_the_same_file() -> None:
    one, again = (dict(families.documents(Draw(1, 7))) for _ in range(2))
    assert one == again


def test_the_default_planner_cannot_tell_the_file_from_the_arrays() -> None:
    draw = Draw(2, 7)
    scenario = families.generate(draw).scenarios[1]
    read, _ = from_bytes(list(families.documents(draw))[1][1], "scenario.xml")
    read = pad_to(read, sizes_of(scenario))
    config, weights = jf.PlannerConfig(sampling_level=1), jf.CostWeights()
    one, other = (jf.roll_out(config, jax.device_put(each), weights, 60) for each in (scenario, read))
    for name in ("x", "y", "speed"):
        np.testing.assert_allclose(getattr(one.ego, name)[:20], getattr(other.ego, name)[:20], atol=0.05)
