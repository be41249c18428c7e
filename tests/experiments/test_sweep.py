"""Searching settings by the command, for a task that is learned in seconds in place of driving."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest
from optuna.exceptions import StorageInternalError

import ppo
from experiments import _search_trainer, sweep
from experiments._presets import PRESETS
from experiments._search_study import SharedStudy
from experiments._search_trainer import SlotTrainer, fit_into_memory
from experiments._training_config import with_config
from experiments._training_options import TrainOptions, settings
from experiments._training_problem import Problem
from experiments._training_program import training_program
from jaxfrenet._typing import Array
from jaxfrenet.environment import EnvironmentParams, RewardFactors
from scenarios.command_line import UserError

EPISODE_STEPS, EPISODES = 8, 6
TINY = ppo.PPOConfig(
    environments=8, rollout_steps=16, epochs=2, minibatches=2, network=ppo.NetworkConfig(8, (8,), (8,))
)
STEPS = 5 * 8 * 16
"""Environment steps between validations."""
SPACE = """
[hyperparameters]
learning_rate = {low = 1e-3, high = 1e-2, log = true}
[rewards]
speed = {low = -2.0, high = -0.5}
"""
OPTIONS = ["--preset", "quick", "--validate-every", "5", "--total-steps", str(2 * STEPS)]


@dataclass(frozen=True)
class Centering:
    """A point on a line that is to stay in the middle; the factor `speed` counts its distance."""

    observation_size: int = 1
    action_size: int = 1

    def reset(self, key: Array, params: Any) -> tuple[Array, tuple[Array, Array]]:
        """Somewhere."""
        place = jax.random.uniform(key, (1,), minval=-1.0)
        return place, (place, jnp.int32(0))

    def step(self, key: Array, state: tuple[Array, Array], action: Array, params: Any) -> tuple:
        """Move, and begin anew after some steps."""
        place, steps = state[0] + 0.5 * jnp.clip(action, -1.0, 1.0), state[1] + 1
        reward = jnp.asarray(params.rewards.speed, jnp.float32) * jnp.abs(place[0])
        ended = steps == EPISODE_STEPS
        first, fresh = self.reset(key, params)
        after = jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, (place, steps))
        info = {"last_observation": place, "metrics": {"reward/speed": reward}, "episode": {"place": place[0]}}
        return jnp.where(ended, first, place), after, reward, ended, jnp.zeros_like(ended), info


@pytest.fixture(autouse=True)
def tiny_preset(monkeypatch):
    monkeypatch.setitem(PRESETS, "quick", replace(PRESETS["quick"], ppo=TINY))


def centering(rewards: RewardFactors) -> Problem:
    """The task as `make_problem` would make it."""
    factors = jax.tree.map(jnp.float32, rewards)
    each = jax.tree.map(lambda factor: jnp.full(EPISODES, factor), factors)
    train, validation = (EnvironmentParams(one, None, None, None) for one in (factors, each))
    environment: Any = Centering()
    return Problem(environment, train, validation, jnp.ones(EPISODES), EPISODE_STEPS, {"return": -1.0})


def trial(learning_rate: float, speed: float) -> TrainOptions:
    return TrainOptions(
        preset="quick",
        validate_every=5,
        total_steps=3 * STEPS,
        hyperparameters=(f"learning_rate={learning_rate}",),
        rewards=(f"speed={speed}",),
    )


def scores_alone(options: TrainOptions, rounds: int) -> list[float]:
    """Scores of a trial as `train` would train it, judged by the published factors."""
    problem, preset = centering(RewardFactors()), settings(options)
    train = replace(problem.train, rewards=jax.tree.map(jnp.float32, preset.rewards))
    state = ppo.initial_state(preset.ppo, problem.environment, preset.hyperparameters, train, jax.random.key(0))
    program = training_program(preset.ppo, problem.environment, problem.max_steps)
    found = []
    for _ in range(rounds):
        state, _, scores = program(
            state, preset.hyperparameters, train.rewards, train, problem.validation, problem.counted, True
        )
        found.append(float(scores["return"]))
    return found


@pytest.fixture(scope="module")
def compiled() -> SlotTrainer:
    """A trainer of two slots."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "quick", replace(PRESETS["quick"], ppo=TINY))
        options = trial(1e-3, -1.0)
        return SlotTrainer(options, settings(options), centering(RewardFactors()), 2)


def test_trials_side_by_side_go_as_they_would_alone(compiled):
    one, two, three = trial(3e-3, -1.0), trial(1e-2, -2.0), trial(1e-2, 2.0)
    compiled.begin({0: one, 1: two})
    rounds = [compiled.advance(2)]
    compiled.begin({1: three})
    rounds += [compiled.advance(2), compiled.advance(2)]
    assert (compiled.rounds, compiled.steps) == (3, STEPS)
    assert [each[0].score for each in rounds] == pytest.approx(scores_alone(one, 3), rel=1e-3)
    assert rounds[0][1].score == pytest.approx(scores_alone(two, 1)[0], rel=1e-3)
    alone = scores_alone(three, 2)
    assert [each[1].score for each in rounds[1:]] == pytest.approx(alone, rel=1e-3)
    assert max(alone) < min(scores_alone(two, 2))
    assert all(each.complaint is None for both in rounds for each in both)


def test_what_is_not_finite_stays_in_its_slot(compiled):
    bad, good = trial(1e30, -1.0), trial(3e-3, -1.0)
    compiled.begin({0: bad, 1: good})
    first, second = compiled.advance(2)
    assert "not finite in update" in (first.complaint or "")
    assert second.score == pytest.approx(scores_alone(good, 1)[0], rel=1e-3) and second.complaint is None
    compiled.begin({0: good})
    assert compiled.advance(2)[0].complaint is None


def test_as_many_as_fit_into_the_memory(monkeypatch, capsys):
    """A program of a fixed part and one for each slot."""
    compiled: list[int] = []

    def compile_for(slots: int) -> Any:
        compiled.append(slots)
        return 100 + 50 * slots

    monkeypatch.setattr(_search_trainer, "fresh_bytes", lambda program: program)
    for free, expected in ((10_000, [16]), (625, [16, 8]), (400, [16, 5, 4]), (190, [16, 2, 1])):
        compiled.clear()
        monkeypatch.setattr(_search_trainer, "free_memory", lambda free=free: free)
        assert fit_into_memory(compile_for, 16) == (expected[-1], 100 + 50 * expected[-1])
        assert compiled == expected
    assert "sweep: 8 trials at a time fit into the memory" in capsys.readouterr().err
    monkeypatch.setattr(_search_trainer, "free_memory", lambda: 100)
    with pytest.raises(UserError, match="a trial needs 0 MB"):
        fit_into_memory(compile_for, 16)


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Runs the command with the task in place of driving."""
    (tmp_path / "space.toml").write_text(SPACE)
    monkeypatch.setattr(sweep, "scenario_sets", lambda options, preset: ())
    monkeypatch.setattr(sweep, "make_problem", lambda sets, config, rewards: centering(rewards))

    def run(*more: str) -> Path:
        out = tmp_path / "out"
        sweep.main([*OPTIONS, "--space", str(tmp_path / "space.toml"), "--out", str(out), "--together", "2", *more])
        return out

    return run


def lines_in(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


def test_writes_what_was_promised(command, capsys):
    out = command("--trials", "5")
    assert {"trials.jsonl", "best.json", "importance.png", "parallel.png", "study.db", "space.toml"} == set(
        os.listdir(out)
    )
    lines, said = lines_in(out), capsys.readouterr().out
    assert [line["trial"] for line in lines] == [0, 1, 2, 3, 4]
    for line in lines:
        assert line["state"] == "complete" and [steps for steps, _ in line["curve"]] == [STEPS, 2 * STEPS]
        assert line["score"] == max(score for _, score in line["curve"]) and line["steps"] == 2 * STEPS
    best = max(lines, key=lambda line: line["score"])
    document = json.loads((out / "best.json").read_text())
    assert (document["trial"], document["score"]) == (best["trial"], best["score"])
    words = with_config(TrainOptions, ["--config", str(out / "best.json")])
    assert f"learning_rate={best['settings']['hyperparameters.learning_rate']!r}" in words
    assert words[words.index("--total-steps") + 1] == str(2 * STEPS)
    assert said.count("learning_rate=") == 5 and f"--config {out / 'best.json'}" in said
    alone = scores_alone(sweep_options(best["settings"]), 2)
    assert [score for _, score in best["curve"]] == pytest.approx(alone, rel=1e-3)


def sweep_options(chosen: Mapping[str, float]) -> TrainOptions:
    return trial(chosen["hyperparameters.learning_rate"], chosen["rewards.speed"])


def test_goes_on_where_it_was_stopped(command, tmp_path, monkeypatch, capsys):
    advance, calls = SlotTrainer.advance, []

    def stop(self: SlotTrainer, used: int) -> Any:
        calls.append(used)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return advance(self, used)

    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stopped:
        patch.setattr(SlotTrainer, "advance", stop)
        command("--trials", "4")
    assert stopped.value.code == 130
    before = lines_in(tmp_path / "out")
    out = command("--trials", "4")
    lines = lines_in(out)
    assert len(before) == 2 and all(line in lines for line in before)
    assert len(lines) == 4 and len({line["settings"]["rewards.speed"] for line in lines}) == 4
    capsys.readouterr()
    written = (out / "trials.jsonl").read_bytes()
    command("--trials", "4")
    assert (out / "trials.jsonl").read_bytes() == written
    with pytest.raises(SystemExit):
        command("--trials", "4", "--objective", "speed=-3")
    assert "was begun with --objective [], not ['speed=-3']" in capsys.readouterr().err


def test_a_database_that_goes_away_is_told_of(command, monkeypatch, capsys):
    def fail(self: SharedStudy) -> None:
        try:
            raise OSError("server closed the connection")
        except OSError as error:
            raise StorageInternalError("An exception is raised during the commit.") from error

    monkeypatch.setattr(SharedStudy, "ask", fail)
    with pytest.raises(SystemExit) as stopped:
        command()
    assert stopped.value.code == 2
    told = capsys.readouterr().err.strip()
    assert told == "sweep: --storage: server closed the connection; start the same command again to go on"
