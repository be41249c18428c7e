"""The record of a training run: `metrics.jsonl` for programs, TensorBoard events for people."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files import written_whole

METRICS = "metrics.jsonl"


class TrainingLog:
    """Writes one line per update, and one per validation; a run that is resumed drops what came after its checkpoint.

    Every line has `step` (environment steps so far), `seed` (number of the run) and `kind`: "update" or "validation".
    """

    def __init__(self, folder: Path, resumed_step: int | None) -> None:
        """Open the record.

        Args:
          folder: of the run.
          resumed_step: the checkpoint's step that a run goes on from; None begins anew.
        """
        from tensorboardX import SummaryWriter

        lines = read_metrics(folder) if resumed_step is not None else []
        kept = [line for line in lines if line["step"] <= (resumed_step or 0)]
        with written_whole(folder / METRICS) as file:
            file.write("".join(json.dumps(line) + "\n" for line in kept).encode())
        self._file = (folder / METRICS).open("a")
        self._events = SummaryWriter(str(folder / "tensorboard"), purge_step=resumed_step or 0)

    def write(self, kind: str, step: int, seed: int, values: Mapping[str, Any]) -> None:
        """Add a line.

        Args:
          kind: "update" or "validation".
          step: environment steps so far.
          seed: number of the run.
          values: names and scalars; what is not finite is written as null, as JSON knows no such numbers.
        """
        plain = {name: _number(value) for name, value in values.items()}
        self._file.write(json.dumps({"kind": kind, "step": step, "seed": seed} | plain) + "\n")
        prefix = "" if kind == "update" else "validation/"
        for name, value in plain.items():
            if value is not None:
                self._events.add_scalar(f"seed_{seed}/{prefix}{name}", value, step)

    def flush(self) -> None:
        """Make sure that what was written is in the files."""
        self._file.flush()
        self._events.flush()

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        self._events.close()


def read_metrics(folder: Path) -> list[dict[str, Any]]:
    """The lines of a run's record; a last line that was cut short is left out."""
    file = folder / METRICS
    lines = []
    for line in file.read_text().splitlines() if file.is_file() else []:
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return lines


def _number(value: Any) -> float | int | None:
    number = np.asarray(value).item()
    return number if math.isfinite(number) else None
