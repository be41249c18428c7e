"""What `evaluate` reports: one row per episode, their summary, and the files that hold both."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

import jaxfrenet as jf
import scenarios
from scenarios.files import written_whole

OUTCOMES = tuple(outcome.name.lower() for outcome in jf.Outcome if outcome is not jf.Outcome.RUNNING)
SIDES = "ego", "third_party"


def episode_row(name: str, info: scenarios.ScenarioInfo, episode: jf.Episode) -> dict[str, Any]:
    """One episode as the plain values of a row.

    Args:
      name: the scenario's name, of which there is no other in the set.
      info: where the scenario comes from.
      episode: without a batch axis, NumPy arrays.
    """
    steps = int(episode.steps)
    driven = slice(0, steps + 1)
    speed, reports = episode.ego.speed[driven], episode.reports
    return {
        "scenario": name,
        "planning_problem": info.planning_problem_id,
        "outcome": jf.Outcome(int(episode.outcome)).name.lower(),
        "steps": steps,
        **_risks(reports, driven_steps(episode)),
        "mean_speed": six_digits(np.mean(speed)),
        "final_speed": six_digits(speed[-1]),
        "distance": six_digits(episode.ego.arc_length[steps] - episode.ego.arc_length[0]),
        "max_abs_offset": six_digits(np.max(np.abs(episode.ego.offset[driven]))),
        "mean_cost": six_digits(np.mean(reports.cost[:steps])),
        "mean_feasible_share": six_digits(np.mean(reports.feasible_share[:steps])),
        "emergency_steps": int(np.sum(reports.mode[:steps] == jf.PlanMode.EMERGENCY)),
    }


def driven_steps(episode: jf.Episode) -> int:
    """Steps that the ego drove; an episode that ends as infeasible has one more, in which it found nothing to drive."""
    return int(episode.steps) - (int(episode.outcome) == jf.Outcome.INFEASIBLE)


def _risks(reports: jf.StepReport, steps: int) -> dict[str, float | None]:
    """Mean and largest risk to either side over the first `steps` steps; None where there are none."""
    row = {}
    for side in SIDES:
        risk = getattr(reports, f"{side}_risk")[:steps]
        row[f"mean_{side}_risk"] = six_digits(np.mean(risk, dtype=np.float64)) if steps else None
        row[f"max_{side}_risk"] = six_digits(np.max(risk)) if steps else None
    return row


def six_digits(value: SupportsFloat) -> float | None:
    """A float that JSON can hold, with the six digits that float32 carries; None for what is not finite."""
    return float(f"{float(value):.6g}") if np.isfinite(float(value)) else None


def summarize(
    rows: Sequence[dict[str, Any]], skipped: Sequence[scenarios.Skipped], seconds: float, compile_seconds: float
) -> dict[str, Any]:
    """Counts of outcomes and the totals of all episodes; times in s, without importing the scenarios."""
    counts = Counter(row["outcome"] for row in rows)
    return {
        "scenarios": len(rows),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        **{f"mean_{side}_risk": _mean([row[f"mean_{side}_risk"] for row in rows]) for side in SIDES},
        "mean_speed": six_digits(np.mean([row["mean_speed"] for row in rows])),
        "seconds": round(seconds, 3),
        "compile_seconds": round(compile_seconds, 3),
        "planning_cycles": sum(row["steps"] for row in rows),
        "skipped": [one._asdict() for one in skipped],
    }


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean of the values that are known."""
    known = [value for value in values if value is not None]
    return six_digits(np.mean(known)) if known else None


def write_results(folder: Path, config: dict[str, Any], summary: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Write `results.json` and `episodes.csv`, each whole or not at all."""
    document = {"config": config, "summary": summary, "episodes": rows}
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with written_whole(folder / "results.json") as file:
        file.write(json.dumps(document, indent=1, allow_nan=False).encode() + b"\n")
    with written_whole(folder / "episodes.csv") as file:
        file.write(table.getvalue().encode())


def summary_table(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of a summary, for people: outcomes that happened, risks, speed, time."""
    cycles = summary["planning_cycles"]
    risks = [(side, summary[f"mean_{side}_risk"]) for side in SIDES]
    return [
        ("scenarios", str(summary["scenarios"])),
        *((outcome.replace("_", " "), str(summary[outcome])) for outcome in OUTCOMES if summary[outcome]),
        ("skipped", str(len(summary["skipped"]))),
        *((f"mean {side.replace('_', '-')} risk", f"{risk:.2e}") for side, risk in risks if risk is not None),
        ("mean speed", f"{summary['mean_speed']:.2f} m/s"),
        ("planning cycles", str(cycles)),
        ("driving", f"{summary['seconds']:.1f} s"),
        ("compiling", f"{summary['compile_seconds']:.1f} s"),
        ("speed", f"{cycles / max(summary['seconds'], 1e-9):.0f} planning cycles/s"),
    ]
