"""The reward (paper, "Reward Design"): what an episode's end is worth, and what each step is."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float
from jaxfrenet.environment.action import Adjustment, default_weights
from jaxfrenet.simulation import StepReport
from jaxfrenet.state import Outcome, SimulationState


@pytree_dataclass
class RewardFactors:
    """What each term counts; all are traced, so a sweep can vary them. The defaults are the published release's."""

    goal_reached_in_time: Array | float = 1000.0
    """At the end of an episode, as the next six."""
    goal_reached_faster: Array | float = 300.0
    goal_reached_late: Array | float = 300.0
    collision: Array | float = -10000.0
    """With an obstacle, or with the road's edge."""
    infeasible: Array | float = -8000.0
    timeout: Array | float = -8000.0
    past_goal: Array | float = -8000.0
    speed: Array | float = -0.12
    """Per m/s between the speed and the desired speed, in each step."""
    ego_risk: Array | float = -3000.0
    """Per unit of the driven trajectory's risk to the ego, in each step."""
    third_party_risk: Array | float = -3000.0
    """Per unit of its risk to others."""
    risk_magnitude: Array | float = 0.0
    """Per decade of both risks' sum above `LEAST_RISK`, in each step: small risks count too. Not in the paper."""
    weights: Array | float = -0.1
    """Per unit by which the cost weights, except for `prediction`, are away from the default ones, in each step."""
    prediction_weight: Array | float = -0.0005
    """The same for the weight of `prediction`."""
    offset: Array | float = 0.0
    """Per m between the ego and the reference path, in each step."""
    progress: Array | float = 0.0
    """Per m driven along the reference path."""


LEAST_RISK = 1e-6
"""A risk far below this adds nothing to the term `risk_magnitude`."""
_ENDS = {
    "goal_reached_in_time": (Outcome.GOAL_REACHED_IN_TIME,),
    "goal_reached_faster": (Outcome.GOAL_REACHED_FASTER,),
    "goal_reached_late": (Outcome.GOAL_REACHED_LATE,),
    "collision": (Outcome.COLLISION_OBSTACLE, Outcome.COLLISION_ROAD),
    "infeasible": (Outcome.INFEASIBLE,),
    "timeout": (Outcome.TIMEOUT,),
    "past_goal": (Outcome.PAST_GOAL,),
}
REWARD_TERMS = tuple(field.name for field in dataclasses.fields(RewardFactors))


def reward_terms(
    factors: RewardFactors,
    adjustments: tuple[Adjustment, ...],
    weights: Float[Array, "actions"],
    before: SimulationState,
    after: SimulationState,
    report: StepReport,
) -> dict[str, Float[Array, ""]]:
    """Every term of one step's reward by name, weighted; the reward is their sum.

    Args:
      factors: what each term counts.
      adjustments: the table of what the agent may change.
      weights: `[actions]`, the cost weights of the step.
      before: the state before the step.
      after: the state after it.
      report: what the step told.
    """
    away = jnp.abs(weights - default_weights(adjustments))
    is_prediction = np.asarray([one.term == "prediction" for one in adjustments])
    risk = report.ego_risk + report.third_party_risk
    measured = {
        "speed": jnp.abs(after.ego.speed - report.desired_speed),
        "ego_risk": report.ego_risk,
        "third_party_risk": report.third_party_risk,
        "risk_magnitude": jnp.log1p(risk / LEAST_RISK) / jnp.log(10.0),
        "weights": jnp.sum(jnp.where(is_prediction, 0.0, away)),
        "prediction_weight": jnp.sum(jnp.where(is_prediction, away, 0.0)),
        "offset": jnp.abs(after.ego.offset),
        "progress": after.ego.arc_length - before.ego.arc_length,
    }
    for name, outcomes in _ENDS.items():
        ended = jnp.any(after.outcome == jnp.asarray(outcomes, jnp.int32))
        measured[name] = ended.astype(jnp.float32)
    return {name: jnp.asarray(getattr(factors, name), jnp.float32) * measured[name] for name in REWARD_TERMS}
