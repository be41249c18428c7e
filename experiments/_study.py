"""The paper's study: each planner drives all scenarios; what is kept of every step, and how it survives a stop."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._batches import Batch, BatchDriver
from experiments._planners import Planner
from experiments._results import driven_steps, episode_row
from scenarios.command_line import UserError
from scenarios.files import written_whole

EGO = "x", "y", "speed", "offset"
RISKS = "ego_risk", "third_party_risk"
WEIGHTS = tuple(f"weight_{name}" for name in jf.COST_TERMS)
COLUMNS = (*EGO, *RISKS, "unweighted_cost", *WEIGHTS)
"""What is kept of each step: metres in the scenario's frame, m/s, the sum of the cost terms without their weights, and
the weights; not-a-number for those of terms that are switched off."""
DIGITS = 6
"""Significant digits that are kept: about what float32 carries, so that tables of numbers say all there is."""


class Driven(NamedTuple):
    """What one planner did in all scenarios, in their order."""

    rows: list[dict[str, Any]]
    """One `episode_row` each."""
    tracks: list[np.ndarray]
    """`[steps + 1, columns]` each, see `COLUMNS`: the state at a step and what was planned there; the last state has
    no plan, and not-a-number in its columns."""
    seconds: float
    """s, driving, without compiling."""

    def column(self, name: str) -> np.ndarray:
        """A column of all tracks, end to end."""
        return column(np.concatenate(self.tracks), name)


def column(track: np.ndarray, name: str) -> np.ndarray:
    """One column of a track."""
    return track[:, COLUMNS.index(name)]


def track_of(episode: jf.Episode, terms: Sequence[str]) -> np.ndarray:
    """`[steps + 1, columns]`, see `COLUMNS`.

    Args:
      episode: without a batch axis, NumPy arrays.
      terms: the cost terms that are switched on, in the order of the reports; only the planner's own are kept.
    """
    steps, planned = int(episode.steps), driven_steps(episode)
    reports = episode.reports
    ego = np.stack([getattr(episode.ego, name)[: steps + 1] for name in EGO], axis=-1)
    plans = {name: getattr(reports, name) for name in RISKS} | {"unweighted_cost": reports.costs.sum(-1)}
    plans |= {f"weight_{term}": weight for term, weight in zip(terms, reports.weights.T, strict=True)}
    track = np.full((steps + 1, len(COLUMNS)), np.nan)
    track[:, : len(EGO)] = ego
    for name in COLUMNS[len(EGO) :]:
        if name in plans:
            track[:planned, COLUMNS.index(name)] = plans[name][:planned]
    return rounded(track)


def rounded(values: np.ndarray) -> np.ndarray:
    """Float64 with `DIGITS` significant digits."""
    exponent = np.floor(np.log10(np.where(np.isfinite(values) & (values != 0.0), np.abs(values), 1.0)))
    scale = 10.0 ** (DIGITS - 1 - exponent)
    return np.round(np.asarray(values, np.float64) * scale) / scale


@dataclass(frozen=True)
class Study:
    """A folder with the parts of a study that are done."""

    folder: Path
    batches: Sequence[Batch]
    names: Sequence[str]
    """Of the scenarios, each once."""
    found: scenarios.ScenarioSet

    def drive(self, name: str, planner: Planner, driver: BatchDriver, bar: tqdm) -> Driven:
        """Let a planner drive every scenario; batches that an earlier run has driven are read.

        Args:
          name: of the planner's part of the folder.
          planner: what drives.
          driver: of a planner that differs in its parameters at most, so that programs are shared.
          bar: counts scenarios.
        """
        rows: dict[int, dict[str, Any]] = {}
        tracks: dict[int, np.ndarray] = {}
        seconds = 0.0
        for number, batch in enumerate(self.batches):
            file = self.folder / "parts" / name / f"{number:04d}.npz"
            if not file.is_file():
                self._drive_batch(file, batch, planner, driver)
            part = _read_part(file)
            seconds += part.seconds
            rows |= dict(zip(batch.indices, part.rows, strict=True))
            tracks |= dict(zip(batch.indices, part.tracks, strict=True))
            bar.update(len(batch.indices))
        order = range(len(self.names))
        return Driven([rows[one] for one in order], [tracks[one] for one in order], seconds)

    def _drive_batch(self, file: Path, batch: Batch, planner: Planner, driver: BatchDriver) -> None:
        before = driver.seconds
        episodes = driver.drive(batch, planner.parameters)
        rows = [episode_row(self.names[one], self.found.infos[one], episodes[one]) for one in batch.indices]
        tracks = [track_of(episodes[one], planner.terms) for one in batch.indices]
        _write_part(file, Driven(rows, tracks, driver.seconds - before))


def _write_part(file: Path, part: Driven) -> None:
    written = io.BytesIO()
    np.savez_compressed(
        written,
        rows=np.frombuffer(json.dumps(part.rows).encode(), np.uint8),
        tracks=np.concatenate(part.tracks),
        lengths=np.array([len(track) for track in part.tracks]),
        seconds=np.array(part.seconds),
    )
    with written_whole(file) as handle:
        handle.write(written.getvalue())


def _read_part(file: Path) -> Driven:
    with np.load(file) as kept:
        tracks = np.split(kept["tracks"], np.cumsum(kept["lengths"])[:-1])
        return Driven(json.loads(kept["rows"].tobytes()), tracks, float(kept["seconds"]))


def settle_study(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write what a study is of, or make sure that the folder's parts are of the same.

    Raises:
      UserError: they are of another study.
    """
    file = folder / "study.json"
    plain = json.loads(json.dumps(settings))
    if file.is_file():
        earlier = json.loads(file.read_text())
        for name, value in plain.items():
            if earlier.get(name) != value:
                other = "other" if name.endswith("s") else "another"
                raise UserError(f"{folder}: holds a study with {other} {name}; name another folder with --out")
    with written_whole(file) as handle:
        handle.write(json.dumps(plain, indent=1).encode() + b"\n")


def digest(*arrays: Any) -> str:
    """A short name for the contents of arrays."""
    told = hashlib.sha256()
    for array in arrays:
        told.update(np.ascontiguousarray(array).tobytes())
    return told.hexdigest()[:16]


def telling_scenario(default: Driven, hybrid: Driven) -> int:
    """The scenario that shows the difference: one where only the default planner collides, or else comes closest to it.

    Among several, the one with the default planner's largest risk to the ego.
    """
    collided = np.array([row["outcome"].startswith("collision") for row in default.rows])
    saved = np.array([not row["outcome"].startswith("collision") for row in hybrid.rows])
    risk = np.array([row["max_ego_risk"] or 0.0 for row in default.rows])
    for candidates in (collided & saved, collided, np.ones(len(risk), bool)):
        if candidates.any():
            return int(np.argmax(np.where(candidates, risk, -1.0)))
    raise AssertionError("a study has at least one scenario")
