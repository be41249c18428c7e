"""Parts of training and of comparing planners that need no driving."""

from __future__ import annotations

import json

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from experiments._comparison import compare, comparison_table
from experiments._learning_curve import draw_learning_curve
from experiments._training_log import TrainingLog, read_metrics
from experiments._training_sets import baseline_of, shares


def row(ego: float | None, outcome: str = "goal_reached_in_time") -> dict:
    return {"outcome": outcome, "mean_ego_risk": ego, "mean_third_party_risk": ego, "mean_speed": 6.0}


def test_every_group_gets_its_share():
    np.testing.assert_allclose(shares((4, 0, 2, 1)), [0.25] * 4 + [0.5] * 2 + [1.0], rtol=1e-6)


def test_doing_as_the_default_planner_does_is_rewarded_with_nothing():
    rewards = np.array([[1.0, -2.0, 30.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5, -100.0]])
    baseline = baseline_of(rewards, 0.9)
    for scenario, steps in enumerate((3, 5)):
        for step in range(steps):
            term = baseline.term(jnp.int32(scenario), jnp.int32(step), jnp.asarray(step + 1 == steps))
            assert rewards[scenario, step] + float(term) == pytest.approx(0.0, abs=1e-5)
    survived = baseline.term(jnp.int32(1), jnp.int32(4), jnp.asarray(False))
    assert float(survived) == pytest.approx(100.0)
    assert float(baseline.term(jnp.int32(1), jnp.int32(70), jnp.asarray(False))) == 0.0


def test_comparison_by_hand():
    default = [row(4e-4, "collision_obstacle"), row(2e-6), row(1e-6), row(3e-6)]
    hybrid = [row(1e-6), row(1e-6), row(2e-6, "collision_obstacle"), row(None, "infeasible")]
    told = compare({"default": default, "mine": hybrid})["mine"]
    risk = told["ego_risk"]
    assert told["outcomes"] == {"goal_reached_in_time": 2, "collision_obstacle": 1, "infeasible": 1}
    assert risk["mean"] == pytest.approx(1e-6) and risk["median"] == pytest.approx(1e-6)
    assert risk["mean_without_collided"] == pytest.approx(0.5e-6)
    assert risk["ratio"] == pytest.approx(4e-6 / 406e-6)
    assert risk["ratio_without_collided"] == pytest.approx(1e-6 / 5e-6)
    assert risk["largest"] == pytest.approx(2e-6)


def test_intervals_are_those_of_the_normal_distribution_where_it_holds():
    random = np.random.default_rng(3)
    theirs = 1e-5 * (1.0 + 0.2 * random.standard_normal(800))
    mine = 0.5 * theirs * (1.0 + 0.1 * random.standard_normal(800))
    told = compare({"a": [row(one) for one in theirs], "b": [row(one) for one in mine]})
    low, high = told["a"]["ego_risk"]["mean_interval"]
    half = 1.96 * np.std(theirs) / np.sqrt(800)
    assert (low, high) == (
        pytest.approx(np.mean(theirs) - half, rel=3e-3),
        pytest.approx(np.mean(theirs) + half, rel=3e-3),
    )
    low, high = told["b"]["ego_risk"]["ratio_interval"]
    assert low < np.mean(mine) / np.mean(theirs) < high
    assert high - low == pytest.approx(2 * 1.96 * 0.5 * 0.1 / np.sqrt(800), rel=0.2)
    assert told["a"]["ego_risk"]["ratio_interval"] == [1.0, 1.0]


def test_nothing_is_divided_by_no_risk():
    told = compare({"a": [row(0.0), row(0.0)], "b": [row(1e-6), row(0.0)]})
    assert told["b"]["ego_risk"]["ratio"] is None and told["b"]["ego_risk"]["ratio_interval"] is None
    assert json.dumps(told, allow_nan=False)
    assert any(line.split()[-1] == "-" for line in comparison_table(told))


def test_all_collided():
    told = compare({"a": [row(1e-3, "collision_road")], "b": [row(2e-3)]})
    assert told["b"]["ego_risk"]["mean_without_collided"] is None
    assert told["b"]["ego_risk"]["ratio"] == pytest.approx(2.0)


def test_a_resumed_log_forgets_what_came_after_its_checkpoint(tmp_path):
    log = TrainingLog(tmp_path, None)
    for step in (10, 20, 30):
        log.write("update", step, 0, {"loss": np.float32(step), "return": np.nan})
    log.close()
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"kind": "update", "step": 40, "se')
    log = TrainingLog(tmp_path, 20)
    log.write("update", 30, 0, {"loss": np.float32(31)})
    log.close()
    lines = read_metrics(tmp_path)
    assert [(line["step"], line["loss"]) for line in lines] == [(10, 10.0), (20, 20.0), (30, 31.0)]
    assert lines[0]["return"] is None


def test_curve_shows_the_range_of_all_runs(tmp_path):
    lines = [{"kind": "baseline", "step": 0, "seed": 0, "return": 10.0, "outcome/goal_reached_in_time": 0.9}]
    for step in (100, 200):
        for seed in range(3):
            values = {"return": 10.0 + seed, "outcome/goal_reached_in_time": 0.9, "mean_ego_risk": 1e-5 * (seed + 1)}
            lines.append({"kind": "validation", "step": step, "seed": seed} | values)
    draw_learning_curve(tmp_path / "curve.png", lines)
    single = [line for line in lines if line["seed"] == 0]
    draw_learning_curve(tmp_path / "single.png", single)
    many, one = (np.asarray(Image.open(tmp_path / name).convert("RGB"), int) for name in ("curve.png", "single.png"))
    assert many.shape == one.shape and many.std() > 5.0
    shaded = [np.count_nonzero(np.abs(picture - [203, 218, 236]).max(axis=-1) < 6) for picture in (many, one)]
    assert shaded[0] > 1000 > shaded[1]
