"""A study that several processes share; they wait in place of training."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from optuna.trial import TrialState

sys.path.insert(0, str(Path(__file__).parent))

from search_worker import SPACE, join  # noqa: E402

from experiments._search_results import draw_search, print_best  # noqa: E402
from experiments._search_slots import Round, Search  # noqa: E402
from experiments._search_storage import open_study  # noqa: E402
from experiments._search_study import SharedStudy, quiet  # noqa: E402
from scenarios.command_line import UserError  # noqa: E402

ROOT = Path(__file__).parents[2]
Start = Callable[..., subprocess.Popen]


@pytest.fixture
def storage(tmp_path) -> str:
    return f"sqlite:///{tmp_path / 'study.db'}"


@pytest.fixture
def notes(tmp_path) -> Path:
    (tmp_path / "notes").touch()
    return tmp_path / "notes"


@pytest.fixture
def start(storage, notes) -> Iterator[Start]:
    """Starts a process that shares the study, with a number of trials and seconds for a round."""
    begun = []

    def run(trials: int, seconds: float | str) -> subprocess.Popen:
        words = [sys.executable, str(Path(__file__).parent / "search_worker.py"), storage, str(notes)]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
        begun.append(subprocess.Popen([*words, str(trials), str(seconds)], env=environment, stderr=subprocess.PIPE))
        return begun[-1]

    yield run
    for process in begun:
        process.kill()
        process.communicate()


@pytest.fixture
def study(storage) -> Iterator[SharedStudy]:
    found = join(storage, 6)
    yield found
    found.close()


def begun(notes: Path) -> list[tuple[int, float]]:
    """Process and setting of each trial that was begun."""
    lines = [line.split() for line in notes.read_text().splitlines()]
    return [(int(line[0]), float(line[2])) for line in lines if line[1] == "begin"]


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def end_of(process: subprocess.Popen) -> None:
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 0, complaint.decode()


def test_a_trial_is_begun_by_one_process_only(start, study, notes):
    """Half of them wait already, which is what two processes could both lay hands on."""
    for number in range(20):
        study.study.enqueue_trial({"x": -0.01 * number})
    processes = [start(40, "ask"), start(40, "ask")]
    for process in processes:
        end_of(process)
    assert Counter(x for _, x in begun(notes)) == {trial.params["x"]: 1 for trial in study.finished()}
    assert len(study.finished()) == 40
    assert {process for process, _ in begun(notes)} == {process.pid for process in processes}


def test_the_trials_of_a_process_that_dies_are_begun_again(start, storage, notes):
    doomed = start(6, 1000.0)
    wait_for(lambda: len(begun(notes)) == 2)
    survivor = start(6, 0.1)
    wait_for(lambda: len(begun(notes)) >= 4)
    os.kill(doomed.pid, signal.SIGKILL)
    end_of(survivor)
    shared = join(storage, 6)
    trials, every = shared.finished(), shared.study.get_trials()
    shared.close()
    lost = {x for process, x in begun(notes) if process == doomed.pid}
    assert len(lost) == 2 and lost <= {x for process, x in begun(notes) if process == survivor.pid}
    assert Counter(x for process, x in begun(notes) if process == survivor.pid) == {
        trial.params["x"]: 1 for trial in trials
    }
    assert len(trials) == 6 and [trial.state for trial in every].count(TrialState.FAIL) == 2


def test_a_trial_whose_process_died_before_any_sign_of_life_is_begun_again(study):
    with quiet():
        lost = study.study.ask(SPACE).params["x"]
    trainer = Scripted(lambda x, done: x)
    run(study, trainer)
    assert lost in {x for chosen in trainer.placed.values() for x in chosen}
    assert len(study.finished()) == 6


class Scripted:
    """A trainer of two slots whose scores are told by a function of the trial's setting and the round."""

    slots, rounds, steps = 2, 3, 10

    def __init__(self, score: Callable[[float, int], Any]) -> None:
        self._score = score
        self.placed: dict[int, list[float]] = {}
        self.done: dict[int, int] = {}

    def begin(self, placed: Mapping[int, Any]) -> None:
        for slot, chosen in placed.items():
            self.placed.setdefault(slot, []).append(chosen["x"])
            self.done[slot] = 0

    def advance(self, used: int) -> list[Round]:
        rounds = []
        for slot in range(self.slots):
            self.done[slot] = self.done.get(slot, 0) + 1
            found = self._score(self.placed.get(slot, [0.0])[-1], self.done[slot])
            rounds.append(found if isinstance(found, Round) else Round(found, None))
        return rounds


def run(study: SharedStudy, trainer: Any) -> None:
    Search(study, dict, lambda options: None, lambda options: trainer, wait_seconds=0.1).run()


def test_slots_are_filled_again_while_others_go_on(study):
    """The second trial cannot go on after its first round: its slot trains three others until the first one ends."""
    for x in (0.1, 0.2, 0.3):
        study.study.enqueue_trial({"x": x})
    trainer = Scripted(lambda x, done: Round(0.0, "not finite") if x == 0.2 and done == 1 else 10.0 * x + done)
    run(study, trainer)
    assert trainer.placed[0][0] == 0.1 and trainer.placed[1][:2] == [0.2, 0.3]
    by_setting = {trial.params["x"]: trial for trial in study.finished()}
    assert by_setting[0.2].state == TrialState.PRUNED and by_setting[0.2].user_attrs["ended"] == "not finite"
    assert by_setting[0.3].user_attrs["curve"] == [[10, 4.0], [20, 5.0], [30, 6.0]]
    assert by_setting[0.1].value == 4.0 and len(study.finished()) == 6


def test_the_best_validation_counts(study):
    run(study, Scripted(lambda x, done: [1.0, 7.0, 2.0][done - 1]))
    assert {trial.value for trial in study.finished()} == {7.0}


def test_hopeless_trials_make_way(storage):
    study = open_study(storage, "sweep", SPACE, {}, 8, "median", heartbeat=1, grace=2)
    for number in range(8):
        study.study.enqueue_trial({"x": float(number < 6)})
    run(study, Scripted(lambda x, done: x + 0.1 * done))
    study.close()
    trials = study.finished()
    assert {trial.state for trial in trials if trial.params["x"] == 0.0} == {TrialState.PRUNED}
    assert {trial.state for trial in trials if trial.params["x"] == 1.0} == {TrialState.COMPLETE}
    assert {len(trial.user_attrs["curve"]) for trial in trials if trial.params["x"] == 0.0} == {2}


def test_what_is_interrupted_is_gone_on_with(study, storage):
    class Interrupted(Scripted):
        def advance(self, used: int) -> list[Round]:
            if sum(map(len, self.placed.values())) == 4:
                raise KeyboardInterrupt
            return super().advance(used)

    first, second = Interrupted(lambda x, done: x), Scripted(lambda x, done: x)
    with pytest.raises(KeyboardInterrupt):
        run(study, first)
    left = {chosen[-1] for chosen in first.placed.values()}
    assert len(study.finished()) == 2
    again = join(storage, 6)
    run(again, second)
    again.close()
    assert left <= {x for chosen in second.placed.values() for x in chosen}
    assert len({trial.params["x"] for trial in again.finished()}) == 6 == len(again.finished())


def test_only_trials_of_one_program_are_trained_side_by_side(study):
    trainers: dict[bool, list[Scripted]] = {False: [], True: []}

    def is_large(options: Mapping[str, Any]) -> bool:
        return options["x"] > 0.5

    def make(options: Mapping[str, Any]) -> Scripted:
        trainers[is_large(options)].append(Scripted(lambda x, done: x))
        return trainers[is_large(options)][-1]

    for x in (0.1, 0.9, 0.2, 0.8, 0.3, 0.7):
        study.study.enqueue_trial({"x": x})
    Search(study, dict, is_large, make, wait_seconds=0.1).run()
    placed = {
        kind: sorted(x for one in every for xs in one.placed.values() for x in xs) for kind, every in trainers.items()
    }
    assert placed == {False: [0.1, 0.2, 0.3], True: [0.7, 0.8, 0.9]}


def test_a_trial_that_others_have_taken_over_is_left_to_them(study):
    def score(x: float, done: int) -> float:
        if x == 0.5 and done == 2:
            (mine,) = [one for one in study.study.get_trials() if one.params.get("x") == 0.5]
            study.study.tell(mine.number, state=TrialState.FAIL)
        return x

    study.study.enqueue_trial({"x": 0.5})
    run(study, Scripted(score))
    assert 0.5 not in {trial.params["x"] for trial in study.finished()} and len(study.finished()) == 6


def test_a_study_is_gone_on_with_by_the_same_settings_only(storage):
    open_study(storage, "sweep", SPACE, {"--seed": 0}, 1).close()
    open_study(storage, "sweep", SPACE, {"--seed": 0}, 5).close()
    open_study(storage, "other", SPACE, {"--seed": 1}, 1).close()
    with pytest.raises(UserError, match="'sweep' was begun with --seed 0, not 1; go on with the same"):
        open_study(storage, "sweep", SPACE, {"--seed": 1}, 1)


def test_a_password_is_not_told():
    with pytest.raises(UserError) as error:
        open_study("mysql+nodriver://me:secret@host/sweeps", "sweep", SPACE, {}, 1)
    assert "me:***@host" in str(error.value) and "secret" not in str(error.value)


def test_settings_are_drawn_by_seed_and_number(tmp_path):
    drawn = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        study = open_study(f"sqlite:///{tmp_path / name}.db", "sweep", SPACE, {}, 3, seed=seed)
        drawn.append([trial.params["x"] for trial in iter(study.ask, None)])
        study.close()
    assert drawn[0] == drawn[1] and len({x for xs in drawn for x in xs}) == 6


def test_pictures_of_what_tells_nothing(study, tmp_path, capsys):
    """Of scores that are all the same, and before any trial is complete."""
    for trial in (study.ask(), study.ask()):
        assert trial is not None
        study.prune(trial, "not finite")
    draw_search(tmp_path, study)
    print_best(tmp_path, study)
    run(study, Scripted(lambda x, done: 1.0))
    draw_search(tmp_path, study)
    said = capsys.readouterr().out
    assert said.count("importance.png needs two complete trials or more") == 2
    assert "2 trials, 2 of them pruned" in said and "best.json" not in said
    assert (tmp_path / "parallel.png").stat().st_size > 1000 and not (tmp_path / "importance.png").exists()
