"""Which trial is trained where: a program trains several side by side, each in a slot that is filled again."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from optuna.trial import Trial

from experiments._search_study import SharedStudy

WAIT_SECONDS = 5.0
"""Between looks at whether other processes have left trials."""


class Round(NamedTuple):
    """How a slot fared between two validations."""

    score: float
    """Of the validation."""
    complaint: str | None
    """What made it impossible to go on; one line."""


class Trainer(Protocol):
    """A program that trains several trials side by side."""

    @property
    def slots(self) -> int:
        """How many."""
        ...

    @property
    def rounds(self) -> int:
        """Validations of a whole trial."""
        ...

    @property
    def steps(self) -> int:
        """Environment steps between two validations of a trial."""
        ...

    def begin(self, placed: Mapping[int, Any]) -> None:
        """Begin trials: options by slot; the other slots go on."""
        ...

    def advance(self, used: int) -> Sequence[Round]:
        """Train all slots, `used` of which have trials, up to the next validation."""
        ...


@dataclass
class Attempt:
    """A trial that this process trains."""

    trial: Trial
    options: Any
    begun: float = 0.0
    """s, on the clock of `time.perf_counter`."""
    curve: list[tuple[int, float]] = field(default_factory=list)
    """Environment steps and score of each validation."""


class Search:
    """Trains trials of a study until it has all."""

    def __init__(
        self,
        study: SharedStudy,
        options_of: Callable[[Mapping[str, Any]], Any],
        program_of: Callable[[Any], Hashable],
        make_trainer: Callable[[Any], Trainer],
        on_round: Callable[[float], None] = lambda trained: None,
        wait_seconds: float = WAIT_SECONDS,
    ) -> None:
        """Prepare.

        Args:
          study: hands out trials.
          options_of: what a trainer is told of a trial, from its settings by name.
          program_of: trials for which it is equal can be trained side by side.
          make_trainer: for all trials that can be trained beside one with these options.
          on_round: called after each validation with what was trained of the trials that go on, in trials.
          wait_seconds: between looks at whether other processes have left trials.
        """
        self._study, self._options_of, self._program_of = study, options_of, program_of
        self._make_trainer, self._on_round, self._wait_seconds = make_trainer, on_round, wait_seconds
        self._queue: list[Attempt] = []

    def run(self) -> None:
        """Train until the study has all its trials; what is interrupted is left to others."""
        try:
            while self._has_next():
                self._train_alike(self._queue[0].options)
        except BaseException:
            self._study.give_back()
            raise

    def _has_next(self) -> bool:
        """Whether there is a trial to train; waits for those of other processes, which may be left to this one."""
        told = False
        while not self._queue and self._ask() is None:
            if not self._study.is_awaited():
                return False
            if not told:
                print("sweep: waiting for other processes to end their trials, or to die", file=sys.stderr)
                told = True
            time.sleep(self._wait_seconds)
        return True

    def _ask(self) -> Attempt | None:
        """Begin a trial and put it at the end of the queue."""
        trial = self._study.ask()
        if trial is None:
            return None
        self._queue.append(Attempt(trial, self._options_of(trial.params)))
        return self._queue[-1]

    def _train_alike(self, options: Any) -> None:
        """Train all trials of one program, until there are no more."""
        program, trainer = self._program_of(options), self._make_trainer(options)
        running: dict[int, Attempt] = {}
        while True:
            fresh: dict[int, Attempt] = {}
            for slot in (slot for slot in range(trainer.slots) if slot not in running):
                attempt = self._next(program, trainer.slots)
                if attempt is None:
                    break
                attempt.begun = time.perf_counter()
                fresh[slot] = attempt
            running |= fresh
            if not running:
                return
            if fresh:
                trainer.begin({slot: attempt.options for slot, attempt in fresh.items()})
            self._take_in(running, trainer, trainer.advance(len(running)))

    def _next(self, program: Hashable, most: int) -> Attempt | None:
        """A trial of this program; up to `most` of others are put by while looking for one."""
        found = next((one for one in self._queue if self._program_of(one.options) == program), None)
        while found is None and len(self._queue) < most:
            asked = self._ask()
            if asked is None:
                return None
            found = asked if self._program_of(asked.options) == program else None
        if found is not None:
            self._queue.remove(found)
        return found

    def _take_in(self, running: dict[int, Attempt], trainer: Trainer, rounds: Sequence[Round]) -> None:
        """Report a validation of all trials, and end those that are complete or hopeless."""
        for slot, attempt in list(running.items()):
            score, complaint = rounds[slot]
            if complaint is None and math.isfinite(score):
                attempt.curve.append((trainer.steps * (len(attempt.curve) + 1), score))
                if not self._study.report(attempt.trial, attempt.curve, time.perf_counter() - attempt.begun):
                    del running[slot]
            else:
                self._study.prune(attempt.trial, complaint or "its validation has no score")
                del running[slot]
        for slot, attempt in list(running.items()):
            if len(attempt.curve) == trainer.rounds:
                self._study.complete(attempt.trial, max(score for _, score in attempt.curve))
                del running[slot]
            elif attempt.trial.should_prune():
                self._study.prune(attempt.trial, "worse than others at this point")
                del running[slot]
        self._on_round(sum(len(attempt.curve) for attempt in running.values()) / trainer.rounds)
