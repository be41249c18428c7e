"""The paper's study on the built-in scenarios: files, numbers, going on after a stop."""

from __future__ import annotations

import csv
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import jaxfrenet as jf
from experiments import reproduce
from experiments._planners import load_hybrid
from experiments._study import COLUMNS, Driven, rounded, telling_scenario

STUDY = ["--scenarios", "builtin", "--collision-weights", "0"]
EXHIBITS = "outcomes", "risk", "speed_and_risk", "paths", "driving", "run_time", "training", "weights"


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("reproduce")
    reproduce.main([*STUDY, "--out", str(out)])
    return out


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def numbers(rows: list[dict[str, str]], name: str, **where: str) -> np.ndarray:
    """A column of the rows that have these values, without empty cells."""
    chosen = [row[name] for row in rows if all(row[key] == value for key, value in where.items())]
    return np.array([float(cell) for cell in chosen if cell])


def told(study: Path) -> dict[str, str]:
    """Our numbers in the report, by what they are."""
    page = (study / "report.html").read_text()
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td></tr>", page)
    return {unescape(what): unescape(ours) for what, ours, _ in rows}


def test_every_exhibit_has_its_files(study):
    for name in EXHIBITS:
        assert (study / f"{name}.pdf").read_bytes().startswith(b"%PDF"), name
        assert min(Image.open(study / f"{name}.png").size) > 200, name
        assert table(study / f"{name}.csv"), name


def test_report_needs_no_other_file(study):
    page = (study / "report.html").read_text()
    assert page.count("<img ") == len(EXHIBITS)
    assert set(re.findall(r'(?:src|href)="(.{10})', page)) == {"data:image"}
    assert "python -m experiments.reproduce --scenarios builtin" in page


def test_outcomes_equal_the_episodes(study):
    episodes, report = table(study / "episodes.csv"), told(study)
    assert {row["configuration"] for row in episodes} == {"default_0", "default_200", "hybrid"}
    for row in table(study / "outcomes.csv"):
        mine = [one["outcome"] for one in episodes if one["configuration"] == row["configuration"]]
        collisions = sum(outcome.startswith("collision") for outcome in mine)
        success = sum(outcome.startswith("goal") for outcome in mine)
        assert (len(mine), success, collisions) == tuple(int(row[n]) for n in ("scenarios", "success", "collision"))
        short = "HP" if row["configuration"] == "hybrid" else f"DP {row['configuration'].removeprefix('default_')}"
        assert report[f"{short}: collisions in 2 scenarios"] == str(collisions)


def test_risks_equal_the_episodes(study):
    episodes, report = table(study / "episodes.csv"), told(study)
    for short, name in (("DP", "default_200"), ("HP", "hybrid")):
        for side in ("ego", "third_party"):
            mean = numbers(episodes, f"mean_{side}_risk", configuration=name).mean()
            assert report[f"mean {side.replace('_', '-')} risk, {short}"] == f"{mean:.3g}"
            column = f"{side}_risk_{'hybrid' if short == 'HP' else 'default'}"
            assert numbers(table(study / "risk.csv"), column).mean() == pytest.approx(mean)


def test_driving_equals_the_steps(study):
    steps, report = table(study / "steps.csv"), told(study)
    titles = {"speed": "speed [m/s]", "offset": "offset d from the reference path [m]"}
    titles["unweighted_cost"] = "unweighted cost [1]"
    for name, title in titles.items():
        for short, planner in (("DP", "default"), ("HP", "hybrid")):
            values = numbers(steps, name, planner=planner)
            expected = values.max(), values.mean(), np.median(values), values.std()
            shown = [float(one) for one in report[f"{title}, {short}: max / mean / median / σ"].split(" / ")]
            assert shown == pytest.approx(expected, abs=6e-4, rel=1e-5)


def test_steps_make_up_the_episodes(study):
    steps, episodes = table(study / "steps.csv"), table(study / "episodes.csv")
    for row in episodes:
        if row["configuration"] == "default_0":
            continue
        planner = row["configuration"].removesuffix("_200")
        risk = numbers(steps, "ego_risk", planner=planner, scenario=row["scenario"])
        assert risk.max() == pytest.approx(float(row["max_ego_risk"]), rel=1e-5)
        speed = numbers(steps, "speed", planner=planner, scenario=row["scenario"])
        assert speed.mean() == pytest.approx(float(row["mean_speed"]), rel=1e-5)


def test_shown_episode_is_in_the_steps(study):
    shown, steps = table(study / "speed_and_risk.csv"), table(study / "steps.csv")
    name = re.search(r"In (\S+), in which", (study / "report.html").read_text())
    assert name is not None
    for planner in ("default", "hybrid"):
        for quantity in ("speed", "ego_risk"):
            np.testing.assert_array_equal(
                numbers(shown, quantity, planner=planner),
                numbers(steps, quantity, planner=planner, scenario=name.group(1)),
            )


def test_run_times_equal_their_table(study):
    rows, report = table(study / "run_time.csv"), told(study)
    assert len({row["scenario"] for row in rows}) == 2
    for part, title in (("policy", "policy"), ("bundle", "trajectory bundle"), ("step", "whole step")):
        values = numbers(rows, part)
        assert (values > 0.0).all()
        assert report[f"{title}: mean (median, 95th percentile) [ms]"].startswith(f"{values.mean():.3g} (")


def test_goes_on_after_a_stop(study, tmp_path):
    again = shutil.copytree(study, tmp_path / "again")
    lost = again / "parts" / "hybrid" / "0000.npz"
    lost.unlink()
    for file in [*again.glob("*.csv"), *again.glob("*.png"), again / "report.html"]:
        file.unlink()
    kept = {file: file.stat().st_mtime_ns for file in (again / "parts").rglob("*.npz")}
    reproduce.main([*STUDY, "--out", str(again)])
    assert lost.is_file()
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert told(again) == told(study)
    for name in EXHIBITS:
        assert (again / f"{name}.csv").read_bytes() == (study / f"{name}.csv").read_bytes()


@pytest.mark.parametrize(
    "changed, says",
    [
        (["--sampling", "fast"], "another sampling; name another folder"),
        (["--no-traffic"], "other scenarios; name another folder"),
        (["--name", "nowhere"], "no such scenario"),
        (["--collision-weights", "-1"], "at least 0"),
        (["--batch", "0"], "at least 1"),
    ],
)
def test_what_cannot_be_asked(study, changed, says, capsys):
    with pytest.raises(SystemExit) as stopped:
        reproduce.main([*STUDY, *changed, "--out", str(study)])
    assert stopped.value.code == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert says in message


def test_the_papers_weights_share_a_program():
    assert {type(weight) for weight in reproduce.ReproduceOptions().collision_weights} == {float}
    assert reproduce._checked_weights(reproduce.ReproduceOptions(collision_weights=(0, 200))) == [0.0, 200.0]


def test_policies_with_other_actions_are_told_apart():
    hybrid = load_hybrid(None, jf.PlannerConfig())
    table = (replace(hybrid.environment.adjustments[0], scale=1.5), *hybrid.environment.adjustments[1:])
    other = replace(hybrid, environment=replace(hybrid.environment, adjustments=table))
    settings = [reproduce._settings(reproduce.ReproduceOptions(), one, []) for one in (hybrid, hybrid, other)]
    assert settings[0] == settings[1]
    assert {name for name in settings[0] if settings[0][name] != settings[2][name]} == {"policy"}


def driven(*ends: tuple[str, float]) -> Driven:
    rows = [{"outcome": outcome, "max_ego_risk": risk} for outcome, risk in ends]
    return Driven(rows, [np.zeros((1, len(COLUMNS)))] * len(rows), 0.0)


def test_the_scenario_that_is_shown():
    good, bad = "goal_reached_in_time", jf.Outcome.COLLISION_OBSTACLE.name.lower()
    calm = driven((good, 1e-9), (good, 1e-9), (good, 1e-9))
    assert telling_scenario(driven((good, 0.1), (bad, 1e-3), (bad, 1e-2)), calm) == 2
    assert telling_scenario(driven((good, 0.1), (bad, 1e-3), (bad, 1e-2)), driven((good, 0), (good, 0), (bad, 1))) == 1
    assert telling_scenario(driven((good, 0.1), (good, 1e-3), (good, 0.2)), calm) == 2


def test_rounding_keeps_six_digits():
    values = np.array([123456.7, -1.23456789e-9, 0.0, np.nan])
    np.testing.assert_allclose(rounded(values), [123457.0, -1.23457e-9, 0.0, np.nan], rtol=1e-12)
