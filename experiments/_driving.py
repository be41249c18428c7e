"""Options that say what is driven and how, and what they mean for the planner."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jaxfrenet as jf
from experiments._planners import DefaultPlanner, Fixed, Planner, load_hybrid
from experiments._sources import SourceOptions
from jaxfrenet.config import Sampling
from jaxfrenet.sampling import SAMPLING_TERMS
from scenarios.command_line import UserError


@dataclass(frozen=True)
class DrivingOptions(SourceOptions):
    """What is driven, by which planner."""

    planner: Literal["default", "hybrid"] = "default"
    """The planner that drives: `default` has fixed weights, of `hybrid` a trained policy adjusts them."""
    policy: Path | None = None
    """Folder of the hybrid planner's policy, written by `train`; the one that comes with the project if not given."""
    predictor: Literal["neural", "constant_velocity", "ground_truth"] = "neural"
    """How the planner predicts the traffic."""
    sampling: Sampling = "full"
    """How many trajectories a planning cycle samples: `full` 800, `fast` 180, `dense` 3,564."""
    weights: tuple[str, ...] = ()
    """Cost weights, and shares of the sampling's ranges, as NAME=VALUE, in place of the default ones; a wrong name
    lists all."""
    curvature_rate_limit: float | Literal["vehicle"] = 0.4
    """Limit of the curvature's rate of change [1/(m s)], or `vehicle` for the steering rate and the friction circle of
    the single-track model, as CommonRoad's feasibility check has them."""
    emergency: Literal["stopping", "min_risk"] = "stopping"
    """What is driven when every trajectory collides: what stops hardest, or what risks least for all together."""
    seed: int = 0
    """Seed of everything random; the default planner draws nothing."""


def chosen_planner(options: DrivingOptions) -> Planner:
    """The planner that the options ask for.

    Raises:
      UserError: an option has no meaning, or contradicts another, or there is no such policy.
    """
    config = planner_config(options)
    if options.planner == "default":
        if options.policy is not None:
            raise UserError(f"--policy {options.policy}: only the hybrid planner has one; add --planner hybrid")
        return DefaultPlanner(config, *fixed_weights(options.weights))
    if options.weights:
        raise UserError(f"--weights {options.weights[0]}: the hybrid planner's policy sets them; leave it out")
    return load_hybrid(options.policy, config)


def own_name(options: DrivingOptions) -> str:
    """What the planner that the options ask for is called in a comparison."""
    if options.planner == "default":
        return "default, own weights" if options.weights else "default"
    return "shipped" if options.policy is None else str(options.policy)


def other_planners(options: DrivingOptions, words: Sequence[str], config: jf.PlannerConfig) -> dict[str, Planner]:
    """Planners to compare with, by names that folders can have; the default planner is the first.

    Args:
      options: ask for the planner that the others are compared with.
      words: `default`, `shipped` or folders of policies.
      config: settings of the planning cycles.

    Raises:
      UserError: a word stands for no policy, or for the planner itself.
    """
    others: dict[str, Planner] = {}
    for word in sorted(dict.fromkeys(words), key=lambda word: word != "default"):
        if word == own_name(options):
            raise UserError(f"--compare {word}: is the planner itself; name another one, or add --planner hybrid")
        if word == "default":
            others[word] = DefaultPlanner(config, jf.CostWeights())
        else:
            folder = None if word == "shipped" else Path(word)
            name = word if folder is None else "_".join(part for part in folder.parts if part.strip("./"))
            others[name] = load_hybrid(folder, config)
    return others


def planner_config(options: DrivingOptions) -> jf.PlannerConfig:
    """The planner's configuration that the options ask for.

    Raises:
      UserError: the curvature rate limit is not positive.
    """
    limit = options.curvature_rate_limit
    if limit != "vehicle" and not 0.0 < limit < math.inf:
        raise UserError(f"--curvature-rate-limit {limit}: give a positive number or 'vehicle'")
    return jf.PlannerConfig.preset(
        options.sampling, predictor=options.predictor, curvature_rate_limit=limit, emergency=options.emergency
    )


def fixed_weights(assignments: tuple[str, ...]) -> Fixed:
    """Cost weights and sampling ranges from `name=value` words; what is not named keeps its default.

    Raises:
      UserError: a word without `=`, an unknown name, or a weight or share that is no finite number ≥ 0.
    """
    found: dict[str, Any] = {}
    for assignment in assignments:
        name, _, value = assignment.partition("=")
        if name not in (*jf.COST_TERMS, *SAMPLING_TERMS):
            raise UserError(
                f"--weights {assignment}: unknown cost term {name!r}; known: {', '.join(jf.COST_TERMS)}; "
                f"and of the sampling {', '.join(SAMPLING_TERMS)}"
            )
        if name in found:
            raise UserError(f"--weights {assignment}: {name} is given twice; give each once")
        found[name] = _weight(assignment, value)
    reach = {name: found.pop(name) for name in SAMPLING_TERMS if name in found}
    return Fixed(jf.CostWeights(**found), jf.SamplingRange(**reach) if reach else None)


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
