"""Training and evaluation of the neural predictor, on few generated scenarios."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from experiments import evaluate_predictor, train_predictor
from experiments._disturbance import disturbed
from experiments._predictions import LEVELS, score, tally
from jaxfrenet.prediction import constant_velocity, neural
from scenarios.families import Draw, generate

KIND = ["--kinds", "tjunction:default", "--generate", "40"]
TRAIN = [*KIND, "--steps", "150", "--batch", "4", "--validate-every", "50"]


@pytest.fixture(scope="module")
def scenario() -> jf.Scenario:
    return jax.device_put(generate(Draw(1, 3, "crossing", "hard")).scenarios[0])


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    train_predictor.main([*TRAIN, "--out", str(folder)])
    return folder


def metrics(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_training_improves_on_held_out_scenarios(trained):
    lines = metrics(trained)
    assert [line["step"] for line in lines] == [50, 100, 150]
    assert lines[-1]["loss"] < lines[0]["loss"] - 0.3
    assert lines[-1]["tjunction:default nll"] < lines[0]["tjunction:default nll"]
    parameters = neural.load_parameters(trained / "predictor.npz")
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(parameters))


def test_an_interrupted_run_ends_like_an_unbroken_one(trained, tmp_path, monkeypatch):
    validated = train_predictor._validated

    def interrupted(folder, state, *rest):
        result = validated(folder, state, *rest)
        if int(state.step) == 100:
            raise KeyboardInterrupt
        return result

    arguments = [*TRAIN, "--out", str(tmp_path)]
    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stop:
        patch.setattr(train_predictor, "_validated", interrupted)
        train_predictor.main(arguments)
    assert stop.value.code == 130 and not (tmp_path / "predictor.npz").exists()
    assert [line["step"] for line in metrics(tmp_path)] == [50, 100]
    with pytest.raises(SystemExit):
        train_predictor.main(arguments)
    train_predictor.main([*arguments, "--resume"])
    assert metrics(tmp_path) == metrics(trained)
    unbroken, resumed = (neural.load_parameters(one / "predictor.npz") for one in (trained, tmp_path))
    jax.tree.map(np.testing.assert_array_equal, unbroken, resumed)


@pytest.mark.parametrize(
    ("command", "arguments", "complaint"),
    [
        (train_predictor.main, [*TRAIN, "--steps", "0"], "--steps 0: give at least 1"),
        (train_predictor.main, [*TRAIN, "--learning-rate", "-1"], "--learning-rate -1.0"),
        (train_predictor.main, ["--generate", "0"], "--generate 0 leaves nothing to train on"),
        (train_predictor.main, ["--kinds", "roundabout"], "no family 'roundabout'"),
        (train_predictor.main, [*KIND, "--generate", "1"], "too few to hold some out"),
        (evaluate_predictor.main, ["--kinds", "highway:rainy"], "no preset 'rainy'"),
        (evaluate_predictor.main, [*KIND, "--every", "0"], "--every 0"),
        (evaluate_predictor.main, [*KIND, "--parameters", "README.md"], "holds no parameters of this network"),
        (evaluate_predictor.main, [*KIND, "--parameters", "nowhere.npz"], "nowhere.npz: No such file"),
    ],
)
def test_wrong_options_get_one_clear_line(command, arguments, complaint, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        command([*arguments, "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and complaint in error[-1]


def test_a_run_is_not_mixed_with_another(trained, capsys):
    for extra, complaint in (([], "holds another run"), (["--resume", "--seed", "5"], "the run had --seed 0")):
        with pytest.raises(SystemExit) as stop:
            train_predictor.main([*TRAIN, "--out", str(trained), *extra])
        assert stop.value.code == 2 and complaint in capsys.readouterr().err


def test_evaluation_counts_what_was_recorded(tmp_path, capsys):
    evaluate_predictor.main(
        ["--kinds", "tjunction:default", "--generate", "3", "--every", "20", "--out", str(tmp_path)]
    )
    results = json.loads((tmp_path / "predictor.json").read_text())["families"]["tjunction:default"]
    errors, count = [], 0
    for scenario in generate(Draw(3, 1, "tjunction", "default")).scenarios:
        o = jax.tree.map(np.asarray, scenario.obstacles)
        for step in range(0, o.valid.shape[1] - 1, 20):
            count += int(np.sum(o.valid[:, step] & o.valid[:, step + 1]))
            if step + 30 < o.valid.shape[1]:
                there = o.valid[:, step] & o.valid[:, step + 30]
                ahead = 3.0 * o.speed[there, step, None]
                heading = o.heading[there, step]
                guess = o.position[there, step] + ahead * np.stack([np.cos(heading), np.sin(heading)], -1)
                errors += list(np.linalg.norm(o.position[there, step + 30] - guess, axis=-1))
    cv = results["constant_velocity"]
    assert cv["predictions"] == count
    assert cv["3 s"]["fde"] == pytest.approx(np.mean(errors), abs=2e-4)
    assert results["neural"]["3 s"]["fde"] < cv["3 s"]["fde"]
    assert all(0 <= one <= 1 for one in results["neural"]["all steps"]["inside"].values())
    assert results["neural"]["reliability"][-1] == 1.0
    assert (tmp_path / "reliability.png").read_bytes().startswith(b"\x89PNG")
    assert "neural" in capsys.readouterr().out


def test_scores_are_those_of_scipy(scenario):
    stats = pytest.importorskip("scipy.stats")
    prediction = constant_velocity.predict(scenario.obstacles, jnp.int32(40), 50)
    found = score(prediction, scenario.obstacles, jnp.int32(40))
    valid = np.asarray(found.valid)
    assert valid.any() and not valid.all()
    sums = jax.tree.map(np.asarray, tally(found))
    inside = np.zeros((50, 3))
    for obstacle, step in zip(*np.nonzero(valid), strict=True):
        truth = np.asarray(scenario.obstacles.position[obstacle, 41 + step], float)
        mean = np.asarray(prediction.mean[obstacle, step], float)
        covariance = np.asarray(prediction.covariance[obstacle, step], float)
        expected = -stats.multivariate_normal(mean, covariance).logpdf(truth)
        assert float(found.nll[obstacle, step]) == pytest.approx(expected, rel=1e-4, abs=1e-3)
        assert float(found.error[obstacle, step]) == pytest.approx(np.linalg.norm(truth - mean), abs=1e-3)
        square = (truth - mean) @ np.linalg.solve(covariance, truth - mean)
        inside[step] += stats.chi2(2).cdf(square) <= np.array(LEVELS)
    np.testing.assert_allclose(sums.inside, inside, atol=1)
    np.testing.assert_array_equal(sums.count, valid.sum(axis=0))
    assert not np.asarray(found.error)[~valid].any() and sums.histogram.sum() == valid.sum()


def test_calibration_finds_the_factor_that_is_missing():
    rng = np.random.default_rng(0)
    distance, weight = rng.chisquare(2, 20000), rng.uniform(0.5, 1.5, 20000)
    assert train_predictor._scale(1.7 * distance, weight) == pytest.approx(1.7, rel=0.03)
    assert train_predictor._scale(100.0 * distance, weight) == train_predictor.SCALES[1]
    assert train_predictor._scale(1.7 * distance[:400], weight[:400]) == 1.0
    of_knots = [train_predictor._nearness(np.array([0.0, 1.5, 2.0, 9.0]), np.arange(1, 4), i) for i in range(3)]
    np.testing.assert_allclose(np.array(of_knots), [[1, 0.5, 0, 0], [0, 0.5, 1, 0], [0, 0, 0, 1]])


def test_disturbed_traffic_stays_near_its_lines(scenario):
    obstacles = scenario.obstacles
    static = obstacles.static.at[0].set(True)
    obstacles = dataclasses.replace(obstacles, static=static)
    made = jax.jit(disturbed)(jax.random.key(4), obstacles, jnp.float32(1.0))
    assert made.valid.any() and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(made))
    old, new = (jax.tree.map(np.asarray, one) for one in (obstacles, made))
    np.testing.assert_allclose(new.position[0], old.position[0], atol=1e-3)
    changed = 0.0
    for index in range(1, len(new.valid)):
        line = old.position[index][old.valid[index]]
        if len(line) < 100 or not new.valid[index].any():
            continue
        places = new.position[index][new.valid[index]]
        away = np.linalg.norm(places[:, None] - line, axis=-1).min(axis=1)
        assert np.quantile(away, 0.9) < 1.5
        moved = np.linalg.norm(np.diff(places[::10], axis=0), axis=1).sum()  # noise adds up between all
        driven = 0.1 * np.abs(new.speed[index][new.valid[index]]).sum()
        assert driven == pytest.approx(moved, rel=0.35, abs=6.0)
        changed = max(changed, float(np.abs(new.position[index] - old.position[index]).max()))
    assert changed > 2.0
    same = jax.jit(disturbed)(jax.random.key(4), obstacles, jnp.float32(0.0))
    np.testing.assert_allclose(same.position, obstacles.position, atol=1e-3)
    np.testing.assert_allclose(same.speed, obstacles.speed, atol=1e-4)
