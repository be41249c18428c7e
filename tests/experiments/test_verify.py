"""`verify`: CommonRoad's own verdict on what `evaluate` wrote."""

from __future__ import annotations

import json
import shutil

import pytest

from experiments import verify

pytest.importorskip("commonroad_dc")


@pytest.fixture
def results(evaluated, tmp_path):
    """A copy of an evaluation that may be tampered with."""
    return shutil.copytree(evaluated, tmp_path / "results")


def run(results, *more: str) -> list[dict]:
    verify.main(["--results", str(results), "--processes", "1", *more])
    return json.loads((results / "verify.json").read_bytes())


def refused(capfd, *arguments: str) -> str:
    with pytest.raises(SystemExit) as stop:
        verify.main(list(arguments))
    error = capfd.readouterr().err
    assert stop.value.code == 2
    assert error.count("\n") == 1 and error.startswith("verify: ")
    return error


def test_verdicts_agree_with_the_outcomes(results, capsys):
    rows = run(results, "--feasibility")
    episodes = json.loads((results / "results.json").read_bytes())["episodes"]
    assert [row["scenario"] for row in rows] == [row["scenario"] for row in episodes]
    assert all(row["agrees"] for row in rows)
    assert [row["states"] for row in rows] == [row["steps"] + 1 for row in episodes]
    assert all(isinstance(row["feasible"], bool) for row in rows)
    table = capsys.readouterr().out
    assert "agrees with outcome" in table and f"{len(rows)}/{len(rows)}" in table


def test_generated_scenarios_are_judged_too(evaluated_generated, tmp_path):
    results = shutil.copytree(evaluated_generated, tmp_path / "results")
    rows = run(results)
    episodes = json.loads((results / "results.json").read_bytes())["episodes"]
    assert [row["scenario"] for row in rows] == [row["scenario"] for row in episodes]
    assert all(row["agrees"] for row in rows)


def test_a_wrong_outcome_is_found(results):
    document = json.loads((results / "results.json").read_bytes())
    document["episodes"][0]["outcome"] = "collision_obstacle"
    document["episodes"][1]["outcome"] = "goal_reached_late"
    (results / "results.json").write_text(json.dumps(document))
    assert [row["agrees"] for row in run(results)] == [False, False]


def test_limit_judges_some(results):
    assert len(run(results, "--limit", "1")) == 1


def test_bad_input_is_one_line(results, tmp_path, capfd):
    assert "run evaluate --solutions" in refused(capfd, "--results", str(tmp_path / "nowhere"))
    assert "at least 1" in refused(capfd, "--results", str(results), "--limit", "0")
    shutil.rmtree(results / "solutions")
    assert "run evaluate with --solutions again" in refused(capfd, "--results", str(results))
    document = json.loads((results / "results.json").read_bytes())
    document["config"]["scenarios"] = ["set.npz"]
    (results / "results.json").write_text(json.dumps(document))
    assert "holds no CommonRoad files" in refused(capfd, "--results", str(results))
    document["config"] |= {"scenarios": None, "generate": 2, "generator_seed": 0, "family": "x", "preset": "default"}
    (results / "results.json").write_text(json.dumps(document))
    assert "not a complete result" in refused(capfd, "--results", str(results))
    (results / "results.json").write_text("{")
    assert "not a complete result" in refused(capfd, "--results", str(results))
    assert not (results / "verify.json").exists()
