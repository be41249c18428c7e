"""What a sweep writes: its trials, the best of them as settings to train with, pictures, and a table."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial, TrialState

from experiments._search_plots import draw_importance, draw_parallel, find_importances
from experiments._search_study import CURVE, ENDED, SECONDS, SharedStudy
from experiments._training_config import config_document
from experiments._training_options import TrainOptions, settings
from scenarios.files import written_whole

TRIALS, BEST, IMPORTANCE, PARALLEL = "trials.jsonl", "best.json", "importance.png", "parallel.png"
SHOWN = 5
"""Rows of the table."""


def write_trials(
    folder: Path, study: SharedStudy, options_of: Callable[[Mapping[str, Any]], TrainOptions], validate_every: int
) -> None:
    """Write a line for each trial that has ended, and what to train the best one with.

    Args:
      folder: for the files.
      study: of all processes.
      options_of: the options of a trial, from its settings by name.
      validate_every: updates between two validations of a trial.
    """
    ended = study.finished()
    with written_whole(folder / TRIALS) as file:
        file.writelines(json.dumps(_as_plain(trial)).encode() + b"\n" for trial in ended)
    ranking = _ranked(ended)
    if ranking:
        best = ranking[0]
        options = replace(
            options_of(best.params), total_steps=best.user_attrs[CURVE][-1][0], validate_every=validate_every
        )
        about = {"trial": best.number, "score": best.value}
        with written_whole(folder / BEST) as file:
            file.write(json.dumps(config_document(options, settings(options)) | about, indent=1).encode() + b"\n")


def _as_plain(trial: FrozenTrial) -> dict[str, Any]:
    curve = trial.user_attrs.get(CURVE, [])
    return {
        "trial": trial.number,
        "state": trial.state.name.lower(),
        "ended": trial.user_attrs.get(ENDED),
        "score": max((score for _, score in curve), default=None),
        "steps": curve[-1][0] if curve else 0,
        "seconds": trial.user_attrs.get(SECONDS),
        "settings": trial.params,
        "curve": curve,
    }


def _ranked(ended: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Complete trials, the best one first."""
    complete = [trial for trial in ended if trial.state == TrialState.COMPLETE]
    return sorted(complete, key=lambda trial: trial.value or 0.0, reverse=True)


def draw_search(folder: Path, study: SharedStudy) -> None:
    """Draw how important each setting is, and what settings led to which scores."""
    importances = find_importances(study.study)
    if importances:
        draw_importance(folder / IMPORTANCE, importances)
    else:
        (folder / IMPORTANCE).unlink(missing_ok=True)
        print(f"{IMPORTANCE} needs two complete trials or more whose settings and scores differ: not drawn")
    draw_parallel(folder / PARALLEL, study.finished())


def print_best(folder: Path, study: SharedStudy) -> None:
    """Print the best trials and where they are."""
    ended = study.finished()
    ranking = _ranked(ended)
    pruned = len(ended) - len(ranking)
    print(f"{len(ended)} trials, {pruned} of them pruned; the best {min(SHOWN, len(ranking))}:")
    print(f"  {'trial':>5}  {'score':>10}  settings")
    for trial in ranking[:SHOWN]:
        chosen = " ".join(f"{_short(name)}={_told(value)}" for name, value in trial.params.items())
        print(f"  {trial.number:>5}  {trial.value:>10.2f}  {chosen}")
    if ranking:
        print(f"train with the best: python -m experiments.train --config {folder / BEST}")


def _short(name: str) -> str:
    return name.partition(".")[2]


def _told(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
