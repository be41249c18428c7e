"""A study that processes share through a database: which trials there are, who runs them, what came of them."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

import optuna
from optuna.distributions import BaseDistribution
from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, Trial, TrialState

HEARTBEAT, GRACE = 15, 90
"""Seconds between signs of life of a trial, and without one until it counts as abandoned."""
CURVE, SECONDS, ENDED = "curve", "seconds", "ended"
"""What is kept about a trial: `[steps, score]` of each validation, how long it took, and why it ended early."""
GIVEN = "fixed_params"
"""What Optuna calls the settings of trials that are begun again."""
FINISHED = TrialState.COMPLETE, TrialState.PRUNED
COUNTED = (*FINISHED, TrialState.RUNNING, TrialState.WAITING)


class SharedStudy:
    """Hands out trials, each to one process only, until there are as many as there are to be.

    As long as it is open, a thread tells the database that this process is alive. Trials of a process that has died
    are handed out again.
    """

    def __init__(
        self, study: optuna.Study, storage: RDBStorage, distributions: Mapping[str, BaseDistribution], total: int
    ) -> None:
        """Join a study.

        Args:
          study: in the storage.
          storage: with heartbeats.
          distributions: the settings of a trial.
          total: trials that the study is to have, over all processes.
        """
        self.study = study
        self.total = total
        self._storage, self._distributions = storage, dict(distributions)
        self._running: dict[int, Trial] = {}
        self._seen: set[int] = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._show_life, daemon=True)
        self._thread.start()

    def ask(self) -> Trial | None:
        """Begin a trial; None if the study has all that it is to have."""
        with quiet():
            optuna.storages.fail_stale_trials(self.study)
            trials = self.study.get_trials(deepcopy=False)
            self._show_life_of_others(trials)
            states = [one.state for one in trials]
            if TrialState.WAITING not in states and sum(state in COUNTED for state in states) >= self.total:
                return None
            trial = self.study.ask(self._distributions)
        self._running[trial.number] = trial
        self._storage.record_heartbeat(trial._trial_id)
        if self._is_surplus(trial):
            self._tell(trial, TrialState.FAIL)
            return None
        return trial

    def _show_life_of_others(self, trials: Sequence[FrozenTrial]) -> None:
        """Give each trial of another process one sign of life: a process that died before the first is never missed."""
        for one in trials:
            if one.state == TrialState.RUNNING and one.number not in self._seen | self._running.keys():
                self._storage.record_heartbeat(one._trial_id)
                self._seen.add(one.number)

    def _is_surplus(self, trial: Trial) -> bool:
        """Whether processes that asked at the same moment have begun one trial too many; the last of them leaves it."""
        counted = self.study.get_trials(deepcopy=False, states=COUNTED)
        if any(one.number == trial.number and GIVEN in one.system_attrs for one in counted):
            return False  # it is begun once more, and has been counted
        return sum(one.number < trial.number for one in counted) >= self.total

    def report(self, trial: Trial, curve: Sequence[tuple[int, float]], seconds: float) -> bool:
        """Keep how a trial goes.

        Args:
          trial: that this process runs.
          curve: environment steps and score of each of its validations so far.
          seconds: since it was begun.

        Returns:
          False if it is no longer this process's: it was silent for so long that another one has begun it anew.
        """
        try:
            trial.set_user_attr(CURVE, [list(point) for point in curve])
            trial.set_user_attr(SECONDS, round(seconds, 1))
            trial.report(curve[-1][1], len(curve))
        except UpdateFinishedTrialError:
            del self._running[trial.number]
            return False
        return True

    def complete(self, trial: Trial, score: float) -> None:
        """End a trial that was trained to its end."""
        self._tell(trial, TrialState.COMPLETE, score)

    def prune(self, trial: Trial, why: str) -> None:
        """End a trial before its time."""
        with suppress(UpdateFinishedTrialError):
            trial.set_user_attr(ENDED, why)
        self._tell(trial, TrialState.PRUNED)

    def give_back(self) -> None:
        """Leave the trials that this process runs to whoever asks next."""
        for trial in list(self._running.values()):
            self._tell(trial, TrialState.FAIL)
            with quiet():
                self.study.enqueue_trial(trial.params)

    def _tell(self, trial: Trial, state: TrialState, score: float | None = None) -> None:
        self.study.tell(trial, score, state, skip_if_finished=True)
        self._running.pop(trial.number, None)

    def is_awaited(self) -> bool:
        """Whether other processes have trials that are not finished."""
        unfinished = self.study.get_trials(deepcopy=False, states=(TrialState.RUNNING, TrialState.WAITING))
        return any(one.number not in self._running for one in unfinished)

    def finished(self) -> list[FrozenTrial]:
        """Trials of all processes that are complete or pruned."""
        return self.study.get_trials(deepcopy=False, states=FINISHED)

    def close(self) -> None:
        """Show no more signs of life."""
        self._stop.set()
        self._thread.join()

    def _show_life(self) -> None:
        while not self._stop.wait(self._storage.heartbeat_interval):
            for trial in list(self._running.values()):
                try:
                    self._storage.record_heartbeat(trial._trial_id)
                except StorageInternalError:  # the database is busy or away; it is told the next time
                    break


@contextmanager
def quiet() -> Iterator[None]:
    """Without Optuna's warnings of what is experimental, and of heartbeats that it does not send by itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
