"""Planners beside each other on the same scenarios: outcomes and risks, with intervals where they are means."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from experiments._results import OUTCOMES, SIDES

RESAMPLES = 2000
CONFIDENCE = 0.95
Rows = Sequence[Mapping[str, Any]]


def compare(every: Mapping[str, Rows]) -> dict[str, Any]:
    """What is to be told of planners, as JSON can hold it.

    Risks are heavy-tailed: few episodes decide their means. So each mean comes with the median, the mean of those
    episodes that did not collide under any planner, and a bootstrap interval (percentiles, pairs of episodes kept).

    Args:
      every: rows of `episode_row` by planner, all of the same scenarios in the same order; the first planner is the
        one that the others are measured against.
    """
    reference = next(iter(every.values()))
    collided = np.any([[row["outcome"].startswith("collision") for row in rows] for rows in every.values()], axis=0)
    compared = {}
    for name, rows in every.items():
        told: dict[str, Any] = {"episodes": len(rows)}
        told["outcomes"] = {
            outcome: count for outcome in OUTCOMES if (count := sum(row["outcome"] == outcome for row in rows))
        }
        told["mean_speed"] = float(np.mean([row["mean_speed"] for row in rows]))
        for side in SIDES:
            mine, theirs = (_risks(some, side) for some in (rows, reference))
            told[f"{side}_risk"] = _spread(mine, collided) | _ratio(mine, theirs, collided)
        compared[name] = told
    return compared


def _risks(rows: Rows, side: str) -> np.ndarray:
    """Mean risk of each episode; an episode without a driven step has none."""
    return np.array([row[f"mean_{side}_risk"] or 0.0 for row in rows], float)


def _spread(risk: np.ndarray, collided: np.ndarray) -> dict[str, Any]:
    without = risk[~collided]
    return {
        "mean": float(np.mean(risk)),
        "mean_interval": _interval(lambda values, axis=-1: np.mean(values, axis=axis), risk),
        "median": float(np.median(risk)),
        "mean_without_collided": float(np.mean(without)) if len(without) else None,
        "largest": float(np.max(risk)),
    }


def _ratio(risk: np.ndarray, reference: np.ndarray, collided: np.ndarray) -> dict[str, Any]:
    """The mean as a share of the reference's; None where that is 0."""

    def share(mine: np.ndarray, theirs: np.ndarray, axis: int = -1) -> np.ndarray:
        below = np.mean(theirs, axis=axis)
        return np.mean(mine, axis=axis) / np.where(below > 0.0, below, np.nan)

    whole, calm = share(risk, reference), share(risk[~collided], reference[~collided]) if not collided.all() else np.nan
    return {
        "ratio": _number(whole),
        "ratio_interval": _interval(share, risk, reference) if np.isfinite(whole) else None,
        "ratio_without_collided": _number(calm),
    }


def _interval(statistic: Any, *samples: np.ndarray) -> list[float] | None:
    """The bootstrap interval of a statistic of paired samples; None of a single episode."""
    if len(samples[0]) < 2:
        return None
    random = np.random.default_rng(0)
    with warnings.catch_warnings():  # of samples that are all alike; their interval is left out below
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(
            samples, statistic, paired=True, vectorized=True, n_resamples=RESAMPLES, batch=100, method="percentile",
            confidence_level=CONFIDENCE, rng=random,
        ).confidence_interval  # fmt: skip
    return [_number(found.low), _number(found.high)] if np.isfinite(found.low) else None  # pyright: ignore[reportReturnType]


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def comparison_table(compared: Mapping[str, Any]) -> list[str]:
    """Lines for people: a column per planner."""
    names = list(compared)
    outcomes = [one for one in OUTCOMES if any(one in told["outcomes"] for told in compared.values())]
    rows: list[tuple[str, list[str]]] = [("episodes", [str(told["episodes"]) for told in compared.values()])]
    for outcome in outcomes:
        rows.append((outcome.replace("_", " "), [str(t["outcomes"].get(outcome, 0)) for t in compared.values()]))
    rows.append(("mean speed [m/s]", [f"{told['mean_speed']:.2f}" for told in compared.values()]))
    for side in SIDES:
        risks = [told[f"{side}_risk"] for told in compared.values()]
        title = f"{side.replace('_', '-')} risk"
        rows += [
            (f"{title}: mean", [f"{risk['mean']:.2e}" for risk in risks]),
            ("  95 % interval", [_span(risk["mean_interval"], ".1e") for risk in risks]),
            (f"  share of {names[0]}'s", [_share(risk["ratio"]) for risk in risks]),
            ("  95 % interval", [_span(risk["ratio_interval"], ".0%") for risk in risks]),
            ("  median", [f"{risk['median']:.1e}" for risk in risks]),
            ("  mean without collisions", [_plain(risk["mean_without_collided"]) for risk in risks]),
        ]
    wide = max(16, *(len(cell) + 2 for _, cells in rows for cell in cells), *(len(name) + 2 for name in names))
    left = max(len(title) for title, _ in rows)
    header = " " * left + "".join(f"{name:>{wide}}" for name in names)
    return [header, *(f"{title:<{left}}" + "".join(f"{cell:>{wide}}" for cell in cells) for title, cells in rows)]


def _span(interval: Sequence[float] | None, form: str) -> str:
    return "-" if interval is None else f"{format(interval[0], form)} … {format(interval[1], form)}"


def _share(ratio: float | None) -> str:
    return "-" if ratio is None else f"{ratio:.0%}"


def _plain(value: float | None) -> str:
    return "-" if value is None else f"{value:.2e}"
