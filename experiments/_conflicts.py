"""Scenarios in which the traffic is in the way: the others teach an agent that adapts to it next to nothing."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
from tqdm import tqdm

import jaxfrenet as jf
from experiments._training_sets import TOGETHER, common_sizes, one_each, zero_driver
from jaxfrenet.environment import DrivingEnvironment, EnvironmentConfig, RewardFactors, make_params
from scenarios import Dataset

CONFLICT = 1e-6
"""Mean risk, to the ego and others together, from which on a planner that disregards the traffic is in conflict."""


def with_conflicts(config: EnvironmentConfig, found: Dataset) -> Dataset:
    """Those scenarios of a set in which a planner without the cost term `prediction` comes near others.

    As this does not depend on how the default planner fares, or any planner that learns, it favours none of them: in
    what is left out all do well.

    Args:
      config: says how traffic is predicted and what the default weights are; few trajectories are enough here.
      found: the set.
    """
    if not len(found):
        return found
    blind = tuple(replace(one, default=0.0) if one.term == "prediction" else one for one in config.adjustments)
    planner = jf.PlannerConfig.preset("fast", predictor=config.planner.predictor)
    environment = DrivingEnvironment(EnvironmentConfig(planner, blind))
    max_steps = max(jf.max_steps(one) for one in found.scenarios)
    drive, common, risks = zero_driver(environment, max_steps), common_sizes(found), []
    with tqdm(total=len(found), desc="looking for conflicts", unit=" scenarios", delay=5.0) as bar:
        for first in range(0, len(found), TOGETHER):
            chosen = np.minimum(np.arange(first, first + TOGETHER), len(found) - 1).tolist()
            params = make_params(environment.config, found.part(chosen).stacked(common), RewardFactors())
            told = jax.device_get(drive(one_each(params)).episode)
            new = min(TOGETHER, len(found) - first)
            risks.append((told["mean_ego_risk"] + told["mean_third_party_risk"])[:new])
            bar.update(new)
    return found.part(np.flatnonzero(np.concatenate(risks) > CONFLICT).tolist())
