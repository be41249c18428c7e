"""The file that says what a sweep searches."""

from __future__ import annotations

import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution

from experiments import sweep
from experiments._search_space import read_space
from experiments._training_options import TrainOptions, settings

EVERYTHING = """
[hyperparameters]
learning_rate = {low = 1e-4, high = 1e-3, log = true}
clip_epsilon = [0.1, 0.2]
discount = 0.995
[rewards]
risk_magnitude = {low = -1, high = 0}
[ppo]
lstm_size = [8, 16]
[actions.velocity_offset]
scale = [0.05, 0.1]
[planner]
sampling = ["fast", "full"]
"""
BASE = TrainOptions(preset="quick", rewards=("speed=-1", "risk_magnitude=-9"))


def test_every_section_is_read(tmp_path):
    (tmp_path / "space.toml").write_text(EVERYTHING)
    space = read_space(tmp_path / "space.toml", BASE)
    assert space.distributions == {
        "hyperparameters.learning_rate": FloatDistribution(1e-4, 1e-3, log=True),
        "hyperparameters.clip_epsilon": CategoricalDistribution([0.1, 0.2]),
        "hyperparameters.discount": CategoricalDistribution([0.995]),
        "rewards.risk_magnitude": FloatDistribution(-1.0, 0.0),
        "ppo.lstm_size": CategoricalDistribution([8, 16]),
        "actions.velocity_offset.scale": CategoricalDistribution([0.05, 0.1]),
        "planner.sampling": CategoricalDistribution(["fast", "full"]),
    }


def test_a_trial_is_trained_with_what_was_chosen(tmp_path):
    (tmp_path / "space.toml").write_text(EVERYTHING)
    chosen = {"hyperparameters.learning_rate": 0.00031415926, "hyperparameters.discount": 0.995}
    chosen |= {"rewards.risk_magnitude": -0.25, "ppo.lstm_size": 16}
    chosen |= {"actions.velocity_offset.scale": 0.05, "planner.sampling": "full"}
    options = read_space(tmp_path / "space.toml", BASE).options(BASE, chosen)
    preset = settings(options)
    assert (preset.hyperparameters.learning_rate, preset.hyperparameters.discount) == (0.00031415926, 0.995)
    assert (preset.ppo.network.lstm_size, preset.sampling) == (16, "full")
    assert {one.term: one.scale for one in preset.adjustments}["velocity_offset"] == 0.05
    rewards = preset.rewards
    assert (rewards.speed, rewards.risk_magnitude, rewards.collision) == (-1.0, -0.25, -10000.0)


def test_the_default_space_can_be_searched():
    space = read_space(None, BASE)
    assert {name.partition(".")[0] for name in space.distributions} == {"hyperparameters", "rewards"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "names no settings"),
        ("learning_rate = 1", "there is no section [learning_rate]; there are hyperparameters, rewards, "),
        ("[hyperparameter]\ndiscount = 1", "there is no section [hyperparameter]"),
        ("[hyperparameters", "is no TOML"),
        (
            "[hyperparameters]\nlearning_speed = [1]",
            "[hyperparameters] has no 'learning_speed'; it has ",
        ),
        ("[hyperparameters]\ndiscount = {low = 0.9, high = 0.8}", "discount: low 0.9 is not below high 0.8"),
        ("[hyperparameters]\nlearning_rate = {low = 0, high = 1, log = true}", "low 0 has no logarithm"),
        ("[hyperparameters]\ndiscount = {low = 0.9}", "a range has low, high and perhaps log"),
        ("[hyperparameters]\ndiscount = {low = 0.9, hihg = 1}", "a range has low, high and perhaps log"),
        ("[hyperparameters]\ndiscount = {low = 0.9, high = inf}", "are finite numbers"),
        ("[hyperparameters]\ndiscount = ['much']", "discount: 'much' is not a finite number"),
        ("[hyperparameters]\ndiscount = {low = 0.9, high = 1.5}", "discount 1.5: give a number between 0 and 1"),
        ("[hyperparameters]\ndiscount = []", "give at least one value, and each once"),
        ("[rewards]\nspeed = [true]", "True is not a finite number"),
        ("[rewards]\nspeed = [-1, -1]", "each once"),
        ("[ppo]\nlstm_size = {low = 8, high = 64}", "shapes the program; give a list"),
        ("[ppo]\nenvironments = [16, 6]", "sizes: environments 6 cannot be divided into minibatches 4"),
        (
            "[ppo]\nenvironments = [12, 16]\nminibatches = [4, 8]",
            "environments 12 cannot be divided",
        ),
        ("[actions.speed]\nscale = 1", "[actions] has no 'speed.scale'; it has prediction.scale, "),
        ("[actions.prediction]\nlow = [0, 300]", "adjustment of 'prediction'"),
        ("[planner]\nsampling = ['quick']", "sampling: 'quick' is none of fast, full, dense"),
        (f"[ppo]\nlstm_size = {list(range(1, 66))}", "have 65 combinations; give at most 64"),
    ],
)
def test_bad_spaces(tmp_path, capsys, text, message):
    file = tmp_path / "space.toml"
    file.write_text(text)
    error = complaint(["--space", str(file), "--out", str(tmp_path / "out")], capsys)
    assert error.startswith(f"sweep: --space {file}: ") and message in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--space", "nowhere.toml"], "--space nowhere.toml: No such file or directory"),
        (["--trials", "0"], "--trials 0: give at least 1"),
        (["--together", "0"], "--together 0: give at least 1"),
        (["--total-steps", "0"], "sweep: --total-steps 0: give at least 1"),
        (["--rewards", "colision=1"], "--rewards colision=1: there is no 'colision'"),
        (["--objective", "colision=1"], "--objective colision=1: there is no 'colision'"),
        (["--storage", "study.db"], "--storage study.db: Could not parse SQLAlchemy URL"),
        (["--storage", "sqlite:////nowhere/at/all.db"], "unable to open database file"),
        (["--pruning", "all"], "invalid choice"),
    ],
)
def test_bad_options(tmp_path, capsys, arguments, message):
    assert message in complaint([*arguments, "--out", str(tmp_path)], capsys)
    assert not (tmp_path / "trials.jsonl").exists()


def complaint(arguments: list[str], capsys) -> str:
    with pytest.raises(SystemExit) as stop:
        sweep.main(arguments)
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line
