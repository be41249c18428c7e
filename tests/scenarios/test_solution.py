"""Solution files say what was driven, as commonroad-io reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios.solution import at_file_steps


@pytest.fixture
def straight_drive(t_junction: jf.Scenario) -> dict[str, np.ndarray]:
    """The ego's start and 30 steps at constant speed along its heading: states of the rear axle."""
    start, vehicle = t_junction.initial_state, jf.BMW_320I
    heading, speed = float(start.heading), float(start.speed)
    along = speed * 0.1 * np.arange(31) - vehicle.rear_axle_to_center
    center = np.asarray(start.position, float)
    return {
        "x": center[0] + along * np.cos(heading),
        "y": center[1] + along * np.sin(heading),
        "heading": np.full(31, heading),
        "speed": np.full(31, speed),
        "curvature": np.full(31, 0.05),
    }


def read(path: Path) -> Any:
    from commonroad.common.solution import CommonRoadSolutionReader

    return CommonRoadSolutionReader.open(str(path))


def test_read_back(tmp_path, t_junction_file, straight_drive):
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.common.solution import VehicleModel, VehicleType

    scenario, info = scenarios.load_with_info(t_junction_file)
    path = tmp_path / "solutions" / "one.xml"
    scenarios.write_solution(path, info, scenario, jf.BMW_320I, **straight_drive)
    solution = read(path)
    assert str(solution.scenario_id) == "ZAM_Builtin-1_1_T-1"
    problem = solution.planning_problem_solutions[0]
    assert (problem.vehicle_type, problem.vehicle_model) == (VehicleType.BMW_320i, VehicleModel.KS)
    states = problem.trajectory.state_list
    assert [state.time_step for state in states] == list(range(31))
    initial: Any = CommonRoadFileReader(t_junction_file).open()[1].planning_problem_dict[100].initial_state
    np.testing.assert_allclose(states[0].position, initial.position, atol=1e-3)
    assert states[0].orientation == pytest.approx(initial.orientation, abs=1e-3)
    assert states[0].velocity == pytest.approx(initial.velocity, abs=1e-3)
    np.testing.assert_allclose(states[-1].position, initial.position + [21.0, 0.0], atol=1e-3)
    assert states[0].steering_angle == pytest.approx(np.arctan(0.05 * jf.BMW_320I.wheelbase), abs=1e-6)
    assert [one.name for one in path.parent.iterdir()] == ["one.xml"]


def test_file_steps_and_whole_turns(tmp_path, edited, straight_drive):
    def change(root):
        root.set("timeStepSize", "0.2")
        initial = root.find("planningProblem/initialState")
        initial.find("time/exact").text = "4"
        initial.find("orientation/exact").text = "6.28318530718"

    scenario, info = scenarios.load_with_info(edited(change))
    scenarios.write_solution(tmp_path / "one.xml", info, scenario, jf.BMW_320I, **straight_drive)
    states = read(tmp_path / "one.xml").planning_problem_solutions[0].trajectory.state_list
    assert [state.time_step for state in states] == list(range(4, 20))
    assert states[0].orientation == pytest.approx(2.0 * np.pi, abs=1e-3)
    np.testing.assert_allclose(states[1].position[0] - states[0].position[0], 1.4, atol=1e-4)


def test_states_between_steps_are_interpolated():
    states = np.arange(6.0)[:, None]
    np.testing.assert_allclose(at_file_steps(states, 0.1)[:, 0], [0, 1, 2, 3, 4, 5])
    np.testing.assert_allclose(at_file_steps(states, 0.25)[:, 0], [0.0, 2.5, 5.0])
    np.testing.assert_allclose(at_file_steps(states, 0.04)[:, 0], np.arange(0.0, 5.01, 0.4))


def test_states_that_are_not_finite(tmp_path, t_junction_file, straight_drive):
    scenario, info = scenarios.load_with_info(t_junction_file)
    straight_drive["speed"][3] = np.nan
    with pytest.raises(scenarios.ScenarioError, match="not all finite"):
        scenarios.write_solution(tmp_path / "one.xml", info, scenario, jf.BMW_320I, **straight_drive)
    assert not list(tmp_path.iterdir())
