"""Where a study is kept: a database that processes, on several machines perhaps, share."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.exceptions import StorageInternalError
from optuna.pruners import BasePruner, MedianPruner, NopPruner, SuccessiveHalvingPruner
from optuna.samplers import TPESampler
from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial
from sqlalchemy import Engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from experiments._search_study import GRACE, HEARTBEAT, SharedStudy, quiet
from scenarios.command_line import UserError

Pruning = Literal["median", "halving", "none"]
RETRIES = 3
"""How often a trial is begun again whose process has died."""
ATTEMPTS = 10
"""How often a database is tried that another process is just setting up."""
LOCKED_SECONDS = 60
"""How long to wait for a file that another process is writing to."""
COMPLETE_FIRST = 4
"""Trials that have to be complete before others are compared with their median."""
SETTINGS = "settings"


class NumberedSampler(optuna.samplers.BaseSampler):
    """Tree-structured Parzen estimation whose random numbers come from a seed and the trial's number.

    So processes that share a study never draw alike, and one that goes on with it does not draw again what it drew.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._number, self._sampler = -1, TPESampler()

    def _of(self, trial: FrozenTrial) -> TPESampler:
        if trial.number != self._number:
            seed = int(np.random.SeedSequence([self._seed, trial.number]).generate_state(1)[0])
            with quiet():
                self._number, self._sampler = trial.number, TPESampler(constant_liar=True, seed=seed)
        return self._sampler

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Which settings are drawn together."""
        return self._of(trial).infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Draw them."""
        return self._of(trial).sample_relative(study, trial, search_space)

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """Draw one of the others."""
        return self._of(trial).sample_independent(study, trial, param_name, param_distribution)


def open_study(
    url: str,
    name: str,
    distributions: Mapping[str, BaseDistribution],
    settings: Mapping[str, Any],
    total: int,
    pruning: Pruning = "median",
    seed: int = 0,
    heartbeat: int = HEARTBEAT,
    grace: int = GRACE,
) -> SharedStudy:
    """Begin a study, or join one that another process has begun.

    Args:
      url: of the database.
      name: of the study.
      distributions: the settings of a trial.
      settings: what all trials have in common, as JSON can hold it; whoever joins has to have the same.
      total: trials that the study is to have, over all processes.
      pruning: which trials are hopeless.
      seed: of what is drawn.
      heartbeat: s, between signs of life.
      grace: s, without one until trials of a process are handed out again.

    Raises:
      UserError: the database cannot be used, or the study has other settings.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = _open_storage(url, heartbeat, grace)
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        direction="maximize",
        load_if_exists=True,
        sampler=NumberedSampler(seed),
        pruner=_pruner(pruning),
    )
    _agree(study, json.loads(json.dumps(settings, default=str)))
    return SharedStudy(study, storage, distributions, total)


def _agree(study: optuna.Study, mine: dict[str, Any]) -> None:
    """Keep what all trials have in common, or make sure that it is what was kept."""
    known = study.user_attrs.get(SETTINGS)
    if known is None:
        study.set_user_attr(SETTINGS, mine)
        return
    for name, value in mine.items():
        if (had := known.get(name)) != value:
            raise UserError(
                f"the study {study.study_name!r} was begun with {name} {had}, not {value}; go on with the same, or "
                "begin another one with --study"
            )


def _pruner(pruning: Pruning) -> BasePruner:
    match pruning:
        case "median":
            return MedianPruner(n_startup_trials=COMPLETE_FIRST, n_warmup_steps=2)
        case "halving":
            return SuccessiveHalvingPruner(min_resource=1, reduction_factor=3)
        case "none":
            return NopPruner()


def _open_storage(url: str, heartbeat: int, grace: int) -> RDBStorage:
    problem = ""
    for _ in range(ATTEMPTS):
        try:
            return _connect(url, heartbeat, grace)
        except (ArgumentError, ImportError) as error:
            problem = reason(error)
            break
        except (SQLAlchemyError, StorageInternalError) as error:
            problem = reason(error)
            time.sleep(0.2)
    raise UserError(f"--storage {_without_password(url)}: {problem}; write for example sqlite:///runs/sweep/study.db")


def reason(error: Exception) -> str:
    """What a database complains of, in one line; Optuna's own errors only say that there is something."""
    return str(error.__cause__ or error).splitlines()[0]


def _connect(url: str, heartbeat: int, grace: int) -> RDBStorage:
    is_file = make_url(url).get_backend_name() == "sqlite"
    with quiet():
        storage = RDBStorage(
            url,
            engine_kwargs={"connect_args": {"timeout": LOCKED_SECONDS}} if is_file else {"pool_pre_ping": True},
            heartbeat_interval=heartbeat,
            grace_period=grace,
            heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(max_retry=RETRIES),
        )
    if is_file:
        _write_in_turn(storage.engine)
    return storage


def _write_in_turn(engine: Engine) -> None:
    """Have every transaction lock the file from its beginning.

    SQLite knows no `SELECT ... FOR UPDATE`, by which Optuna makes sure that one process only begins a trial that waits.
    """

    def leave_transactions_to_us(connection: Any, _: Any) -> None:
        connection.isolation_level = None

    def lock(connection: Any) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    event.listen(engine, "connect", leave_transactions_to_us)
    event.listen(engine, "begin", lock)
    engine.dispose()


def _without_password(url: str) -> str:
    try:
        return make_url(url).render_as_string(hide_password=True)
    except SQLAlchemyError:
        return url
