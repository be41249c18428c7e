"""Options that say what is driven and how, and what they mean for the planner."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tqdm import tqdm

import jaxfrenet as jf
import scenarios
from experiments._cli import UserError

BUILTIN = Path("builtin")
"""Stands for the scenarios that come with the project."""


@dataclass(frozen=True)
class DrivingOptions:
    """What is driven, by which planner."""

    scenarios: tuple[Path, ...] = (BUILTIN,)
    """CommonRoad files, folders or .tar.xz/.zip archives of them, .npz sets, or `builtin`."""
    planning_problem: int | None = None
    """Identifier of the planning problem to drive; the first of each file where it is not given."""
    planner: Literal["default"] = "default"
    """The planner that drives: `default` has fixed cost weights."""
    predictor: Literal["constant_velocity", "ground_truth"] = "constant_velocity"
    """How the planner predicts the traffic."""
    weights: tuple[str, ...] = ()
    """Cost weights as NAME=VALUE, in place of the default ones; a wrong name lists all."""
    curvature_rate_limit: float | Literal["vehicle"] = 0.4
    """Limit of the curvature's rate of change [1/(m s)], or `vehicle` for the steering rate and the friction circle of
    the single-track model, as CommonRoad's feasibility check has them."""
    seed: int = 0
    """Seed of everything random; the default planner draws nothing."""


def planner_config(options: DrivingOptions) -> jf.PlannerConfig:
    """The planner's configuration that the options ask for.

    Raises:
      UserError: the curvature rate limit is not positive.
    """
    limit = options.curvature_rate_limit
    if limit != "vehicle" and not 0.0 < limit < math.inf:
        raise UserError(f"--curvature-rate-limit {limit}: give a positive number or 'vehicle'")
    return jf.PlannerConfig(predictor=options.predictor, curvature_rate_limit=limit)


def cost_weights(assignments: tuple[str, ...]) -> jf.CostWeights:
    """Cost weights from `name=value` words; terms that are not named keep their default weight.

    Raises:
      UserError: a word without `=`, an unknown term, or a weight that is no finite number ≥ 0.
    """
    weights = {}
    for assignment in assignments:
        name, _, value = assignment.partition("=")
        if name not in jf.COST_TERMS:
            raise UserError(f"--weights {assignment}: unknown cost term {name!r}; known: {', '.join(jf.COST_TERMS)}")
        if name in weights:
            raise UserError(f"--weights {assignment}: {name} is given twice; give each cost term once")
        weights[name] = _weight(assignment, value)
    return jf.CostWeights(**weights)


def _weight(assignment: str, value: str) -> float:
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0.0 <= weight < math.inf:
        raise UserError(
            f"--weights {assignment}: {value!r} is not a finite number ≥ 0; write for example prediction=200"
        )
    return weight


def load_scenarios(options: DrivingOptions) -> scenarios.ScenarioSet:
    """Read the scenarios that the options name.

    Raises:
      UserError: they name none.
      ScenarioError: nothing that can be driven was found.
      OSError: a file cannot be read.
    """
    if not options.scenarios:
        raise UserError("--scenarios: no file named; name at least one, or leave the option out")
    paths = scenario_paths(options.scenarios)
    with tqdm(desc="importing", unit=" files", delay=5.0) as bar:
        return scenarios.load_set(paths, options.planning_problem, partial(_show_progress, bar))


def scenario_paths(sources: Iterable[Path]) -> list[Path]:
    """The paths that `--scenarios` names; `builtin` stands for the project's own files."""
    return [path for source in sources for path in (scenarios.builtin_paths() if source == BUILTIN else [source])]


def _show_progress(bar: tqdm, done: int, total: int) -> None:
    bar.total = total
    bar.update(done - bar.n)
