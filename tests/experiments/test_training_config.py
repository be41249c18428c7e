"""Settings that one run leaves to another."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import tyro

from experiments import train
from experiments._planners import SHIPPED
from experiments._presets import PRESETS
from experiments._training_config import command_line, settle_config, with_config
from experiments._training_options import TrainOptions, environment_config, settings
from jaxfrenet.environment import PAPER_ADJUSTMENTS, SAMPLING_ADJUSTMENTS, RewardFactors
from scenarios.command_line import UserError

CHANGED = TrainOptions(
    preset="quick",
    total_steps=5000,
    scenarios=(Path("a.xml"), Path("b c.xml")),
    generate=7,
    sampling="full",
    rewards=("collision=-500.5", "weights=0.0"),
    hyperparameters=("learning_rate=0.001",),
    sizes=("environments=8", "lstm_size=32"),
    actions=("velocity_offset.scale=0.05",),
    seeds=2,
    seed=3,
)


def parsed(arguments: list[str]) -> TrainOptions:
    return tyro.cli(TrainOptions, args=with_config(TrainOptions, arguments))


def test_a_run_begins_with_the_settings_of_another(tmp_path):
    settle_config(tmp_path, CHANGED, settings(CHANGED))
    file = tmp_path / "config.json"
    assert replace(parsed(["--config", str(file)]), config=None) == CHANGED
    more = parsed(["--seed", "0", f"--config={file}", "--scenarios", "--sampling", "fast", "--generate", "9"])
    assert replace(more, config=None) == replace(CHANGED, seed=0, scenarios=(), sampling="fast", generate=9)
    assert command_line(parsed(["--config", str(file)])) == command_line(CHANGED)


def test_the_trained_policys_settings_can_be_used():
    options = parsed(["--config", str(SHIPPED / "config.json")])
    kept = json.loads((SHIPPED / "config.json").read_text())
    assert settings(options).total_steps == kept["preset"]["total_steps"]
    assert vars(settings(options).hyperparameters) == kept["preset"]["hyperparameters"]


def test_a_run_that_knew_fewer_options_can_be_resumed(tmp_path):
    settle_config(tmp_path, TrainOptions(), settings(TrainOptions()))
    document = json.loads((tmp_path / "config.json").read_text())
    del document["options"]["sizes"]
    (tmp_path / "config.json").write_text(json.dumps(document))
    settle_config(tmp_path, TrainOptions(resume=True), settings(TrainOptions()))
    resumed = TrainOptions(resume=True, sizes=("epochs=2",))
    (tmp_path / "config.json").write_text(json.dumps(document))
    with pytest.raises(UserError, match="the run had --sizes"):
        settle_config(tmp_path, resumed, settings(resumed))


def test_sizes_and_actions_take_effect():
    preset = settings(CHANGED)
    assert (preset.ppo.environments, preset.ppo.network.lstm_size, preset.ppo.rollout_steps) == (8, 32, 74)
    changed = environment_config(CHANGED, preset)
    assert changed.planner.sampling_level == 2
    expected = [replace(one, scale=0.05) if one.term == "velocity_offset" else one for one in PAPER_ADJUSTMENTS]
    assert list(changed.adjustments) == expected
    wider = replace(CHANGED, action_space="sampling", actions=("braking_range.low=0.5",))
    assert environment_config(wider, settings(wider)).adjustments[6] == replace(SAMPLING_ADJUSTMENTS[6], low=0.5)


def test_the_papers_preset_has_the_papers_numbers():
    paper = settings(TrainOptions(preset="paper"))
    assert (paper.ppo.environments, paper.ppo.rollout_steps, paper.ppo.epochs, paper.total_steps) == (16, 147, 5, 7e6)
    chosen = paper.hyperparameters
    assert (chosen.learning_rate, chosen.discount, chosen.gae_lambda, chosen.clip_epsilon) == (3e-4, 0.99, 0.97, 0.1)
    assert paper.rewards == RewardFactors() and paper.adjustments == PAPER_ADJUSTMENTS and not paper.conflicts


def test_options_go_before_what_a_preset_has():
    preset = PRESETS["cpu"]
    assert settings(TrainOptions(preset="cpu")) == preset
    options = TrainOptions(
        preset="cpu",
        keep="all",
        kinds=("crossing",),
        rewards=("timeout=-1",),
        actions=("prediction.scale=9",),
        action_space="paper",
    )
    changed = settings(options)
    assert (changed.conflicts, changed.kinds) == (False, ("crossing",))
    assert changed.rewards == replace(preset.rewards, timeout=-1.0)
    assert changed.adjustments == (replace(PAPER_ADJUSTMENTS[0], scale=9.0), *PAPER_ADJUSTMENTS[1:])
    assert settings(TrainOptions(preset="paper", keep="conflicts")).conflicts


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file or directory; name the config.json of a run"),
        ("not JSON", "holds no settings of a run"),
        ('{"preset": {}}', "holds no settings of a run"),
        ('{"options": {"speed": 1}, "preset": {"total_steps": 1}}', "training has no option 'speed'"),
        ('{"options": {"preset": "huge"}, "preset": {"total_steps": 1}}', "invalid choice"),
    ],
)
def test_bad_files(tmp_path, capsys, content, message):
    file = tmp_path / "config.json"
    if content is not None:
        file.write_text(content)
    assert message in complaint(["--config", str(file), "--out", str(tmp_path / "out")], capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sizes", "depth=3"], "--sizes depth=3: there is no 'depth'; there are environments, "),
        (["--sizes", "epochs=1.5"], "--sizes: epochs 1.5: give a positive integer"),
        (["--sizes", "minibatches=7", "--preset", "quick"], "--sizes: environments 16 cannot be divided"),
        (["--actions", "speed.scale=1"], "there is no 'speed.scale'; there are prediction.scale, "),
        (
            ["--actions", "braking_range.low=0.5", "--preset", "paper"],
            "not in this action space; add --action-space sampling",
        ),
        (["--actions", "prediction.low=300"], "--actions: adjustment of 'prediction': choose finite numbers"),
        (["--config"], "--config"),
    ],
)
def test_bad_options(tmp_path, capsys, arguments, message):
    assert message in complaint([*arguments, "--out", str(tmp_path / "out")], capsys)
    assert not (tmp_path / "out").exists()


def complaint(arguments: list[str], capsys) -> str:
    with pytest.raises(SystemExit) as stop:
        train.main(arguments)
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line
