from __future__ import annotations

import csv
import dataclasses
import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from experiments import evaluate
from experiments._driving import chosen_planner, fixed_weights, planner_config
from experiments._player_data import player_data
from experiments._recording import record
from experiments._results import episode_row, summarize, summary_table
from jaxfrenet.sampling import SAMPLING_TERMS
from scenarios.families import FAMILIES, Draw

SUMMARY = {"scenarios", "mean_ego_risk", "mean_third_party_risk", "seconds", "planning_cycles", "skipped"}
OUTCOMES = {
    "goal_reached_in_time",
    "goal_reached_faster",
    "goal_reached_late",
    "collision_obstacle",
    "collision_road",
    "infeasible",
    "timeout",
    "past_goal",
}
RISKS = {"mean_ego_risk", "max_ego_risk", "mean_third_party_risk", "max_third_party_risk"}


def read(folder):
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def read_csv(folder):
    with (folder / "episodes.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_results_have_the_promised_fields(evaluated):
    results = read(evaluated)
    assert set(results) == {"config", "summary", "episodes"}
    assert set(results["summary"]) >= SUMMARY | OUTCOMES
    for episode in results["episodes"]:
        assert {"scenario", "outcome", "steps"} | RISKS <= set(episode)
        assert episode["outcome"] in OUTCOMES
        assert episode["steps"] > 0


def test_summary_adds_up(evaluated):
    results = read(evaluated)
    summary, episodes = results["summary"], results["episodes"]
    assert summary["scenarios"] == len(episodes) == len(scenarios.builtin_paths())
    for outcome in OUTCOMES:
        assert summary[outcome] == sum(episode["outcome"] == outcome for episode in episodes)
    assert sum(summary[outcome] for outcome in OUTCOMES) == summary["scenarios"]
    assert summary["planning_cycles"] == sum(episode["steps"] for episode in episodes)
    assert summary["skipped"] == []


@pytest.mark.parametrize("side", ["ego", "third_party"])
def test_risks_of_episodes_and_their_mean(evaluated, side):
    results = read(evaluated)
    means, largest = ([row[f"{kind}_{side}_risk"] for row in results["episodes"]] for kind in ("mean", "max"))
    assert all(0.0 < mean < most <= 1.0 for mean, most in zip(means, largest, strict=True))
    assert results["summary"][f"mean_{side}_risk"] == pytest.approx(sum(means) / len(means), rel=1e-5)


def test_risks_are_unknown_where_nothing_was_driven(evaluated, builtin_file):
    found = scenarios.load_set([builtin_file])
    nowhere = dataclasses.replace(
        found.scenarios[0], path=dataclasses.replace(found.scenarios[0].path, length=jnp.float32(20.0))
    )
    episode = jax.device_get(jf.roll_out(jf.PlannerConfig(), nowhere, jf.CostWeights(), jf.max_steps(nowhere)))
    row = episode_row("nowhere", found.infos[0], episode)
    assert (row["outcome"], row["steps"]) == ("infeasible", 1)
    assert {row[risk] for risk in RISKS} == {None}
    known = read(evaluated)["episodes"]
    summary = summarize([row, *known], [], 1.0, 1.0)
    assert summary["mean_ego_risk"] == read(evaluated)["summary"]["mean_ego_risk"]
    assert summarize([row], [], 1.0, 1.0)["mean_ego_risk"] is None
    assert "mean ego risk" in dict(summary_table(summary))
    assert "mean ego risk" not in dict(summary_table(summarize([row], [], 1.0, 1.0)))


def test_csv_equals_json(evaluated):
    episodes = read(evaluated)["episodes"]
    assert read_csv(evaluated) == [
        {name: "" if value is None else str(value) for name, value in row.items()} for row in episodes
    ]


def test_results_agree_with_the_closed_loop(evaluated, builtin_file):
    scenario_set = scenarios.load_set([builtin_file])
    scenario, name = scenario_set.scenarios[0], scenario_set.infos[0].name
    episode = jf.roll_out(
        planner_config(evaluate.EvaluateOptions()), scenario, jf.CostWeights(), jf.max_steps(scenario)
    )
    row = next(row for row in read(evaluated)["episodes"] if row["scenario"] == name)
    assert row["outcome"] == jf.Outcome(int(episode.outcome)).name.lower()
    assert row["steps"] == int(episode.steps)
    assert row["final_speed"] == pytest.approx(float(episode.ego.speed[row["steps"]]), rel=1e-2)
    for side in ("ego", "third_party"):
        risk = np.asarray(getattr(episode.reports, f"{side}_risk"))[: row["steps"]]
        assert row[f"mean_{side}_risk"] == pytest.approx(risk.mean(), rel=0.05)
        assert row[f"max_{side}_risk"] == pytest.approx(risk.max(), rel=0.05)


def test_the_players_charts_tell_the_same(evaluated, builtin_file):
    scenario_set = scenarios.load_set([builtin_file])
    planner, name = chosen_planner(evaluate.EvaluateOptions()), scenario_set.infos[0].name
    recording = record(planner, "default", name, scenario_set.scenarios[0])
    shown = player_data([recording], planner.config.vehicle)
    curves = {
        (chart["title"], line["label"]): np.array(line["values"])
        for chart in shown["charts"]
        for line in chart["lines"]
    }
    (row,) = [row for row in read_csv(evaluated) if row["scenario"] == name]
    assert shown["episodes"][0]["steps"] == int(row["steps"])
    assert shown["episodes"][0]["outcome"].replace(" ", "_") == row["outcome"]
    told = {
        "mean_speed": curves["speed", "driven"].mean(),
        "final_speed": curves["speed", "driven"][-1],
        "mean_ego_risk": curves["risk", "ego"].mean(),
        "max_third_party_risk": curves["risk", "third party"].max(),
        "max_abs_offset": np.abs(curves["offset from the path", "offset"]).max(),
        "mean_cost": curves["chosen cost, by terms", "total"].mean(),
        "mean_feasible_share": curves["feasible", "share"].mean() / 100.0,
    }
    for column, value in told.items():
        assert value == pytest.approx(float(row[column]), rel=1e-3, abs=1e-9 if "risk" in column else 1e-6), column


def test_one_solution_file_per_episode(evaluated):
    names = {f"{episode['scenario']}.xml" for episode in read(evaluated)["episodes"]}
    assert {path.name for path in (evaluated / "solutions").iterdir()} == names


def test_a_step_without_a_trajectory_is_not_driven(evaluated, builtin_file):
    scenario = scenarios.load(builtin_file)
    nowhere = dataclasses.replace(scenario, path=dataclasses.replace(scenario.path, length=jnp.float32(35.0)))
    episode = jf.roll_out(jf.PlannerConfig(), nowhere, jf.CostWeights(), jf.max_steps(nowhere))
    assert jf.Outcome(int(episode.outcome)) is jf.Outcome.INFEASIBLE
    last = evaluate.driven_steps(episode)
    assert last == int(episode.steps) - 1
    assert float(episode.ego.x[last]) == float(episode.ego.x[last + 1])


def test_config_records_what_was_asked_for(evaluated):
    config = read(evaluated)["config"]
    assert (config["predictor"], config["emergency"]) == (evaluate.EvaluateOptions().predictor, "stopping")
    weights = {name: getattr(jf.CostWeights(), name) for name in jf.CostWeights().names()}
    assert config["weights"] == weights | dict.fromkeys(SAMPLING_TERMS, 1.0)
    assert config["scenarios"] == ["builtin"]
    assert not {"generate", "generator_seed", "family", "preset"} & set(config)


def test_generated_scenarios_are_driven_and_named(evaluated_generated):
    results = read(evaluated_generated)
    config, draw = results["config"], Draw(2, seed=1)
    source = {"generate": 2, "generator_seed": 1, "family": "tjunction", "preset": "default"}
    assert {name: config.get(name) for name in source} == source
    assert "scenarios" not in config
    assert [episode["scenario"] for episode in results["episodes"]] == [draw.name(0), draw.name(1)]
    assert {path.stem for path in (evaluated_generated / "solutions").iterdir()} == {draw.name(0), draw.name(1)}


def test_generated_scenarios_are_the_default():
    assert evaluate.EvaluateOptions().scenarios is None
    assert evaluate.EvaluateOptions().draw() == Draw(16, seed=0, family="tjunction", preset="default")


def test_the_emergency_is_the_planners():
    assert planner_config(evaluate.EvaluateOptions()).emergency == "stopping"
    assert planner_config(evaluate.EvaluateOptions(emergency="min_risk")).emergency == "min_risk"


def test_weights_replace_the_default_ones():
    weights, reach = fixed_weights(("prediction=50", "jerk=0.1"))
    assert (weights.prediction, weights.jerk) == (50.0, 0.1)
    assert weights.lateral_jerk == jf.CostWeights().lateral_jerk
    assert weights.acceleration is None and reach is None
    weights, reach = fixed_weights(("prediction=50", "braking_range=0.5"))
    assert weights.prediction == 50.0 and reach == jf.SamplingRange(braking_range=0.5)


def test_scenarios_of_one_name_keep_their_own_files():
    infos = scenarios.load_set(scenarios.builtin_paths()).infos
    names = evaluate.unique_names([*infos, *infos])
    assert names[: len(infos)] == [info.name for info in infos]
    assert len(set(names)) == 2 * len(infos)


def test_a_broken_file_among_good_ones_is_listed(mixed_folder, tmp_path, capsys):
    evaluate.main(["--scenarios", str(mixed_folder), "--out", str(tmp_path / "out")])
    summary = read(tmp_path / "out")["summary"]
    assert summary["scenarios"] == len(scenarios.builtin_paths())
    assert [skipped["file"].endswith("broken.xml") for skipped in summary["skipped"]] == [True]
    assert "skipped" in capsys.readouterr().out


def test_nothing_temporary_is_left(evaluated):
    assert {path.name for path in evaluated.iterdir()} == {"results.json", "episodes.csv", "solutions"}


def test_help_explains_the_options(capsys):
    with pytest.raises(SystemExit) as stop:
        evaluate.main(["--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    assert "python -m experiments.evaluate" in shown
    assert all(option in shown for option in ("--scenarios", "--weights", "--predictor", "--solutions", "--seed"))
    assert all(option in shown for option in ("--generate", "--generator-seed", "--family", "--preset"))
    assert all(name in shown for family in FAMILIES for name in (family, *FAMILIES[family].presets))


def test_a_second_run_replaces_the_solutions_of_the_first(evaluated, tmp_path):
    out = shutil.copytree(evaluated, tmp_path / "again")
    (out / "solutions" / "OLD.xml").write_text("of an earlier run")
    evaluate.main(["--scenarios", "builtin", "--out", str(out), "--solutions"])
    kept = sorted(path.name for path in (out / "solutions").iterdir())
    assert kept == sorted(path.name for path in (evaluated / "solutions").iterdir())
    assert {path.name for path in out.iterdir()} == {"results.json", "episodes.csv", "solutions"}
