"""Search settings of PPO, reward, actions and planner: trials side by side in one program, proposed by Optuna."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import jax
from optuna.exceptions import StorageInternalError
from tqdm import tqdm

from experiments._presets import PRESETS, PresetName
from experiments._search_results import draw_search, print_best, write_trials
from experiments._search_slots import Search
from experiments._search_space import Space, read_space
from experiments._search_storage import Pruning, open_study, reason
from experiments._search_study import SharedStudy
from experiments._search_trainer import SlotTrainer
from experiments._training_config import config_document, with_config
from experiments._training_options import LearningOptions, TrainOptions, changed_rewards, environment_config, settings
from experiments._training_problem import Problem, make_problem, scenario_sets
from experiments._training_program import CHUNK
from experiments._training_sets import TrainingSets
from jaxfrenet.environment import EnvironmentConfig, RewardFactors
from scenarios.command_line import UserError, prepare_folder, run_command
from scenarios.files import written_whole

MOST_TOGETHER = {"cpu": 8}
"""Trials at a time where there is no accelerator; one takes as many as fit into its memory."""


@dataclass(frozen=True)
class SweepOptions(LearningOptions):
    """Search good settings for training: trials.jsonl, importance.png, parallel.png, best.json for `train --config`.

    Trials are trained side by side in one compiled program. One that is worse than the median of the others at the same
    point makes way for the next. Killed and started again with the same command, the search goes on. Several
    processes, on several machines, share it if they name the same --storage.

    What is searched is in a small file (--space); without one PPO's and the reward's most telling numbers, see
    space.toml in the results::

        [hyperparameters]
        learning_rate = {low = 1e-4, high = 1e-3, log = true}
        clip_epsilon = [0.1, 0.2]
        [rewards]
        risk_magnitude = {low = -5.0, high = 0.0}
        [ppo]
        lstm_size = [64, 128]
        [actions.velocity_offset]
        scale = [0.05, 0.1]
        [planner]
        sampling = ["fast"]

    Settings of ppo, actions and planner shape the program: each combination is compiled once, and only trials that
    have them in common run side by side.
    """

    preset: PresetName = "quick"
    """Settings of everything that is not searched; see `train --help`."""
    space: Path | None = None
    """File of the settings to search, and their values."""
    trials: int = 16
    """Trials that the study is to have, of all processes together."""
    together: int | None = None
    """Trials side by side; if not given, 8 on a CPU, as many as fit into the memory of a GPU."""
    objective: tuple[str, ...] = ()
    """What trials are judged by: the mean return in validation with these factors of the reward, as NAME=VALUE in place
    of the preset's, whatever factors a trial learns from; its best validation counts."""
    pruning: Pruning = "median"
    """Which trials are given up: those below the median of the others at the same point, by successive `halving`, or
    none."""
    storage: str | None = None
    """URL of the study's database, for example postgresql://user@host/sweeps; a file study.db in the folder for the
    results if not given."""
    study: str = "sweep"
    """Name of the study in it."""
    out: Path = Path("runs/sweep")
    """Folder for the results."""


def sweep(options: SweepOptions) -> None:
    """Search, write what was found, and print the best trials."""
    for name in ("trials", "together"):
        value = getattr(options, name)
        if value is not None and value < 1:
            raise UserError(f"--{name} {value}: give at least 1")
    same = {field.name: getattr(options, field.name) for field in fields(LearningOptions)}
    base = TrainOptions(**same, relative=False)
    settings(base)
    _objective(options)
    space = read_space(options.space, base)
    folder = prepare_folder(options.out)
    storage = options.storage or f"sqlite:///{folder / 'study.db'}"
    common = _in_common(options, base, space)
    study = open_study(
        storage, options.study, space.distributions, common, options.trials, options.pruning, options.seed
    )
    with written_whole(folder / "space.toml") as file:
        file.write(space.text.encode())
    try:
        _search(options, base, space, study, folder)
    except StorageInternalError as error:
        raise UserError(f"--storage: {reason(error)}; start the same command again to go on") from None
    finally:
        study.close()


def _objective(options: SweepOptions) -> RewardFactors:
    """The factors that all trials are judged by."""
    return changed_rewards("--objective", PRESETS[options.preset], options.objective)


def _in_common(options: SweepOptions, base: TrainOptions, space: Space) -> dict[str, Any]:
    """What all trials of a study have in common, by the option that says so."""
    document = config_document(base, settings(base))
    flags = {f"--{name.replace('_', '-')}": value for name, value in document["options"].items()}
    searched = {name: str(distribution) for name, distribution in space.distributions.items()}
    total = document["preset"]["total_steps"]
    return flags | {"--total-steps": total, "--objective": sorted(options.objective), "--space": searched}


def _search(options: SweepOptions, base: TrainOptions, space: Space, study: SharedStudy, folder: Path) -> None:
    every = -(-settings(base).validate_every // CHUNK) * CHUNK
    with _Progress(study) as progress:

        def options_of(chosen: Mapping[str, Any]) -> TrainOptions:
            return space.options(base, chosen)

        def on_round(trained: float) -> None:
            progress.look(trained)
            write_trials(folder, study, options_of, every)

        on_round(0.0)
        Search(study, options_of, _program_of, _Trainers(options, progress.add), on_round).run()
        on_round(0.0)
    draw_search(folder, study)
    print_best(folder, study)


def _program_of(options: TrainOptions) -> Hashable:
    """What shapes the program: trials that have it in common are trained side by side."""
    preset = settings(options)
    return preset.ppo, environment_config(options, preset)


class _Trainers:
    """Makes a trainer for each program, and keeps it."""

    def __init__(self, options: SweepOptions, on_chunk: Callable[[float], object]) -> None:
        self._options, self._on_chunk = options, on_chunk
        self._sets: TrainingSets | None = None
        self._problems: dict[EnvironmentConfig, Problem] = {}
        self._trainers: dict[Hashable, SlotTrainer] = {}

    def __call__(self, options: TrainOptions) -> SlotTrainer:
        """The trainer of all trials that can be trained beside one with these options."""
        program = _program_of(options)
        if program not in self._trainers:
            most = self._options.together or MOST_TOGETHER.get(jax.default_backend(), self._options.trials)
            most = min(most, self._options.trials)
            problem = self._problem(options)
            self._trainers[program] = SlotTrainer(options, settings(options), problem, most, self._on_chunk)
        return self._trainers[program]

    def _problem(self, options: TrainOptions) -> Problem:
        preset = settings(options)
        config = environment_config(options, preset)
        if config not in self._problems:
            self._sets = self._sets or scenario_sets(options, preset)
            self._problems[config] = make_problem(self._sets, config, _objective(self._options))
            tqdm.write(f"the score with the default weights is {self._problems[config].baseline['return']:.2f}")
        return self._problems[config]


class _Progress:
    """A bar of trials: those that all processes have ended, and parts of those that this one trains."""

    def __init__(self, study: SharedStudy) -> None:
        self._study, self._trained = study, 0.0
        self._bar: tqdm | None = None

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def add(self, trained: float) -> None:
        """Show that parts of trials were trained."""
        if self._bar is None:  # only now are the bars of what comes before training gone
            form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
            self._bar = tqdm(total=self._study.total, desc="trials", bar_format=form, initial=int(self._trained))
        self._trained += trained
        self._bar.n = min(self._trained, self._study.total)
        self._bar.refresh()

    def look(self, trained: float) -> None:
        """Count the trials that have ended; `trained` are parts of others."""
        ended = self._study.finished()
        self._trained = len(ended) + trained
        if self._bar is not None:
            best = max((trial.value for trial in ended if trial.value is not None), default=None)
            self._bar.set_postfix_str(f"{len(ended)} ended" + ("" if best is None else f", best {best:.1f}"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(SweepOptions, sweep, "experiments.sweep", arguments, partial(with_config, SweepOptions))


if __name__ == "__main__":
    main()
