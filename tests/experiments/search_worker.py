"""Search a study with a trainer that does not train, in a process of its own; or only ask for trials.

Arguments: the storage, a file for notes, the number of trials, seconds for a round (`ask` for asking only).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna.distributions import FloatDistribution

from experiments._search_slots import Round, Search
from experiments._search_storage import open_study
from experiments._search_study import SharedStudy

SPACE = {"x": FloatDistribution(0.0, 1.0)}


class Notes:
    """A file that processes add lines to: who did what."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def write(self, *words: Any) -> None:
        """Add a line at once."""
        with self._file.open("a") as file:
            file.write(" ".join(map(str, (os.getpid(), *words))) + "\n")


class IdleTrainer:
    """Two slots of three rounds, in which nothing happens but time."""

    slots, rounds, steps = 2, 3, 10

    def __init__(self, notes: Notes, seconds: float) -> None:
        self._notes, self._seconds = notes, seconds
        self._chosen: dict[int, float] = {}

    def begin(self, placed: Mapping[int, Any]) -> None:
        """Note which trials begin."""
        for slot, chosen in placed.items():
            self._chosen[slot] = chosen["x"]
            self._notes.write("begin", chosen["x"])

    def advance(self, used: int) -> Sequence[Round]:
        """Wait; the score is the setting."""
        time.sleep(self._seconds)
        return [Round(self._chosen.get(slot, 0.0), None) for slot in range(self.slots)]


def join(storage: str, trials: int) -> SharedStudy:
    """Join the study, and leave it to others after two seconds of silence."""
    return open_study(storage, "sweep", SPACE, {}, trials, "none", heartbeat=1, grace=2)


def search(storage: str, notes: Notes, trials: int, seconds: float) -> None:
    """Search to the end."""
    study = join(storage, trials)
    Search(study, dict, lambda options: None, lambda options: IdleTrainer(notes, seconds), wait_seconds=0.2).run()
    study.close()


def ask(storage: str, notes: Notes, trials: int) -> None:
    """Begin as many trials as there are, without doing anything about them."""
    study = join(storage, trials)
    while (trial := study.ask()) is not None:
        notes.write("begin", trial.params["x"])
        study.complete(trial, 0.0)
    study.close()


if __name__ == "__main__":
    place, file, count, pace = sys.argv[1:]
    if pace == "ask":
        ask(place, Notes(Path(file)), int(count))
    else:
        search(place, Notes(Path(file)), int(count), float(pace))
