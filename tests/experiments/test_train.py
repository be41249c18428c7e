"""Training by the command, in a problem so small that nothing is learned, but everything is written."""

from __future__ import annotations

import json
import os
import shutil
import struct
from pathlib import Path

import jax
import numpy as np
import pytest

import ppo
from experiments import average, evaluate, train
from experiments._planners import describe
from experiments._training_devices import provide_threads
from experiments._training_log import TrainingLog
from jaxfrenet.environment import EnvironmentConfig, observation_fields

SMALL = ["--preset", "quick", "--generate", "20", "--kinds", "tjunction:commonroad", "--validate-every", "5"]
SMALL += ["--predictor", "constant_velocity", "--total-steps", "11840", "--keep-policies"]
REORDERED = [*SMALL[:2], *SMALL[10:12], *SMALL[6:8], *SMALL[2:6], *SMALL[8:10], SMALL[-1]]
"""The same in the order of the options."""
STEPS_PER_UPDATE = 16 * 74


def lines_in(folder: Path) -> list[dict]:
    """The metrics, without what depends on the machine's mood."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [{name: value for name, value in line.items() if name != "steps_per_second"} for line in lines]


def last_state(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "policy" / "policy.npz") as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("train")
    train.main([*SMALL, "--out", str(out)])
    return out


def test_writes_what_was_promised(trained):
    assert {"config.json", "metrics.jsonl", "tensorboard", "checkpoints", "policy", "curve.png"} <= set(
        os.listdir(trained)
    )
    config = json.loads((trained / "config.json").read_text())
    assert config["options"]["preset"] == "quick" and config["preset"]["ppo"]["environments"] == 16


def test_metrics_tell_of_every_update_and_validation(trained):
    lines = lines_in(trained)
    updates = [line for line in lines if line["kind"] == "update"]
    assert [line["step"] for line in updates] == [STEPS_PER_UPDATE * (i + 1) for i in range(10)]
    assert [line["step"] for line in lines if line["kind"] == "validation"] == [5920, 11840]
    assert [line["kind"] for line in lines].count("baseline") == 1
    shown = updates[-1]
    for name in ("policy_loss", "value_loss", "entropy", "approximate_kl", "clip_fraction", "explained_variance"):
        assert np.isfinite(shown[name])
    terms = sum(value for name, value in shown.items() if name.startswith("environment/reward/"))
    assert terms == pytest.approx(shown["reward"], rel=1e-4, abs=1e-3)
    assert shown["environment/weight/prediction"] == pytest.approx(200.0, abs=30.0)
    ended = [line for line in updates if line["episodes"]]
    assert ended and sum(v for n, v in ended[0].items() if n.startswith("episode/outcome/") and "behind" not in n) == (
        pytest.approx(1.0)
    )


def test_tensorboard_reads_the_events(trained):
    from tensorboardX.proto.event_pb2 import Event  # pyright: ignore[reportAttributeAccessIssue]

    (file,) = (trained / "tensorboard").iterdir()
    data, found = file.read_bytes(), {}
    while data:
        (length,) = struct.unpack("<Q", data[:8])
        event = Event.FromString(data[12 : 12 + length])
        data = data[12 + length + 4 :]
        for value in event.summary.value:
            found.setdefault(value.tag, []).append((event.step, value.simple_value))
    validations = [line for line in lines_in(trained) if line["kind"] in ("baseline", "validation")]
    expected = [(line["step"], pytest.approx(line["return"], rel=1e-6)) for line in validations]
    assert found["seed_0/validation/return"] == expected


def test_best_policy_is_kept(trained):
    fields = [field.name for field in observation_fields(EnvironmentConfig())]
    _, description = ppo.load_policy(trained / "policy", observation_names=fields)
    returns = {line["step"]: line["return"] for line in lines_in(trained) if line["kind"] == "validation"}
    assert description["validation_return"] == pytest.approx(max(returns.values()))
    assert returns[description["steps"]] == max(returns.values())
    assert description["command"] == " ".join(["python -m experiments.train", *REORDERED])


def test_policies_can_be_averaged(trained, tmp_path, capsys):
    kept = [trained / "policies" / str(steps) for steps in (5920, 11840)]
    assert sorted((trained / "policies").iterdir()) == sorted(kept)
    average.main([*map(str, kept), "--out", str(tmp_path / "mean")])
    policies = [ppo.load_policy(folder)[0].parameters for folder in (*kept, tmp_path / "mean")]
    for first, second, mean in zip(*map(jax.tree.leaves, policies), strict=True):
        np.testing.assert_allclose(mean, (first + second) / 2, atol=1e-6)
    about = ppo.load_policy(tmp_path / "mean")[1]
    assert about["averaged_steps"] == [5920, 11840]
    assert about["adjustments"] == ppo.load_policy(trained / "policy")[1]["adjustments"]
    with pytest.raises(SystemExit):
        average.main([str(kept[0]), str(tmp_path / "nothing"), "--out", str(tmp_path / "new")])
    assert "there is no such folder" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_an_interrupted_run_goes_on_as_if_nothing_had_happened(trained, tmp_path, monkeypatch):
    write = TrainingLog.write

    def fail(self, kind: str, step: int, *rest) -> None:
        if step > 5920 + 2 * STEPS_PER_UPDATE:
            self._file.write('{"kind": "upd')
            self.flush()
            raise KeyboardInterrupt
        write(self, kind, step, *rest)

    with monkeypatch.context() as patch, pytest.raises(SystemExit) as stop:
        patch.setattr(TrainingLog, "write", fail)
        train.main([*SMALL, "--out", str(tmp_path)])
    assert stop.value.code == 130
    assert ppo.Checkpoints(tmp_path / "checkpoints").steps() == [5920]
    train.main([*SMALL, "--out", str(tmp_path), "--resume"])
    assert lines_in(tmp_path) == lines_in(trained)
    mine, theirs = last_state(tmp_path), last_state(trained)
    assert mine.keys() == theirs.keys()
    for name, value in theirs.items():
        np.testing.assert_array_equal(mine[name], value, err_msg=name)


def test_a_checkpoint_that_was_cut_short_is_not_used(trained, tmp_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    newest = folder / "checkpoints" / str(max(ppo.Checkpoints(folder / "checkpoints").steps()))
    for file in newest.rglob("*"):
        if file.is_file() and file.stat().st_size > 10_000:
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    train.main([*SMALL, "--out", str(folder), "--resume"])
    assert f"{newest}" in capsys.readouterr().err
    assert lines_in(folder) == lines_in(trained)


def test_what_is_not_finite_stops_the_run(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        train.main([*SMALL, "--out", str(tmp_path), "--hyperparameters", "learning_rate=1e30"])
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert stop.value.code == 2
    assert "not finite in update" in error and "is safe in" in error
    assert ppo.Checkpoints(tmp_path / "checkpoints").steps() == [0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "huge"], "invalid choice"),
        (["--rewards", "colision=1"], "there is no 'colision'; there are goal_reached_in_time, "),
        (["--rewards", "collision=much"], "'much' is not a finite number"),
        (["--hyperparameters", "discount=1.5"], "discount 1.5: give a number between 0 and 1"),
        (["--generate", "0"], "leaves nothing to train on"),
        (["--total-steps", "0"], "--total-steps 0: give at least 1"),
        (["--devices", "100"], "--devices 100: there are"),
        (["--kinds", "roundabout"], "no family 'roundabout'"),
        (["--scenarios", "nowhere.xml"], "nowhere.xml"),
        (["--distributed", "--coordinator", "nonsense"], "--distributed: "),
    ],
)
def test_bad_options(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit) as stop:
        train.main([*arguments, "--out", str(tmp_path)])
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert stop.value.code == 2
    assert error.startswith("train: ") and message in error
    assert not (tmp_path / "policy").exists()


@pytest.mark.parametrize(
    ("flags", "least"),
    [
        ("", None),
        ("--xla_force_host_platform_device_count=1", None),
        ("--x=1 --xla_force_host_platform_device_count=64", 256),
    ],
)
def test_devices_of_one_cpu_get_threads_enough(monkeypatch, flags, least):
    monkeypatch.setenv("NPROC", "")
    monkeypatch.delenv("NPROC")
    monkeypatch.setenv("XLA_FLAGS", flags)
    provide_threads()
    assert os.environ.get("NPROC") is None if least is None else int(os.environ["NPROC"]) >= least
    monkeypatch.setenv("NPROC", "3")
    provide_threads()
    assert os.environ["NPROC"] == "3", "what the user says holds"


def test_another_run_is_not_overwritten(trained, capsys):
    with pytest.raises(SystemExit):
        train.main([*SMALL, "--out", str(trained)])
    assert "holds another run; go on with --resume" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        train.main([*SMALL, "--seed", "1", "--out", str(trained), "--resume"])
    assert "the run had --seed 0; resume with the same options" in capsys.readouterr().err


def evaluated(folder: Path, *more: str) -> dict:
    evaluate.main(["--scenarios", "builtin", "--out", str(folder), *more])
    return json.loads((folder / "results.json").read_text())


@pytest.fixture(scope="module")
def idle_policy(trained, tmp_path_factory) -> Path:
    """A policy that always does nothing."""
    folder = tmp_path_factory.mktemp("policies") / "idle"
    policy, _ = ppo.load_policy(trained / "policy")
    parameters = policy.parameters | {"mean": jax.tree.map(lambda leaf: 0.0 * leaf, policy.parameters["mean"])}
    fields = {name: getattr(policy, name) for name in vars(policy)} | {"parameters": parameters}
    ppo.save_policy(folder, ppo.Policy(**fields), describe(EnvironmentConfig()))
    return folder


def test_an_idle_policy_is_the_default_planner(idle_policy, tmp_path, capsys):
    results = evaluated(tmp_path, "--planner", "hybrid", "--policy", str(idle_policy), "--compare")
    default = json.loads((tmp_path / "default" / "results.json").read_text())
    for mine, theirs in zip(results["episodes"], default["episodes"], strict=True):
        assert (mine["scenario"], mine["outcome"], mine["steps"]) == (
            theirs["scenario"], theirs["outcome"], theirs["steps"]
        )  # fmt: skip
        assert mine["mean_ego_risk"] == pytest.approx(theirs["mean_ego_risk"], rel=1e-3)
    compared = json.loads((tmp_path / "comparison.json").read_text())
    assert list(compared) == ["default", str(idle_policy)]
    assert compared[str(idle_policy)]["ego_risk"]["ratio"] == pytest.approx(1.0, rel=1e-3)
    assert "share of default's" in capsys.readouterr().out


def test_a_trained_policy_changes_the_weights(trained, tmp_path):
    results = evaluated(tmp_path, "--planner", "hybrid", "--policy", str(trained / "policy"), "--compare")
    assert results["config"]["weights"] is None and results["summary"]["scenarios"] == len(results["episodes"])
    default = json.loads((tmp_path / "default" / "results.json").read_text())
    for mine, theirs in zip(results["episodes"], default["episodes"], strict=True):
        assert mine["mean_cost"] != pytest.approx(theirs["mean_cost"], rel=1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--planner", "hybrid", "--policy", "nowhere"], "--policy nowhere: there is no such folder"),
        (["--policy", "somewhere"], "only the hybrid planner has one; add --planner hybrid"),
        (["--planner", "hybrid", "--weights", "jerk=1"], "the hybrid planner's policy sets them"),
        (["--compare"], "--compare default: is the planner itself"),
    ],
)
def test_bad_planners(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit) as stop:
        evaluate.main([*arguments, "--scenarios", "builtin", "--out", str(tmp_path)])
    assert stop.value.code == 2 and message in capsys.readouterr().err


def test_a_policy_that_sees_something_else_is_refused(trained, tmp_path, capsys):
    policy, description = ppo.load_policy(trained / "policy")
    description["observation_names"][3] = "temperature"
    ppo.save_policy(tmp_path / "other", policy, description)
    with pytest.raises(SystemExit):
        evaluate.main(["--planner", "hybrid", "--policy", str(tmp_path / "other"), "--out", str(tmp_path)])
    assert "element 3 of the policy's observations is temperature, here it is lateral_jerk" in capsys.readouterr().err


def test_the_shipped_policy_drives(tmp_path, capsys):
    results = evaluated(tmp_path, "--planner", "hybrid")
    assert {episode["outcome"] for episode in results["episodes"]} <= {"goal_reached_in_time", "goal_reached_late"}
    folder = Path(evaluate.__file__).parent / "policies" / "default"
    assert sum(file.stat().st_size for file in folder.iterdir()) < 10e6
    _, description = ppo.load_policy(folder)
    assert description["command"].startswith("python -m experiments.train ")
    assert {"policy.npz", "policy.json", "config.json", "curve.png"} <= {file.name for file in folder.iterdir()}
