"""The environment that agents are trained in: episodes one after the other, each in a scenario drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.environment.config import EnvironmentConfig
from jaxfrenet.environment.dynamics import Situation, begin, proceed
from jaxfrenet.environment.observation import observation_fields
from jaxfrenet.environment.reward import RewardFactors, reward_terms
from jaxfrenet.planner import PlanMode
from jaxfrenet.prediction import with_predictions
from jaxfrenet.scenario import PredictionTable, Scenario
from jaxfrenet.simulation import StepReport, ego_box, hits_recorded
from jaxfrenet.state import Outcome, SimulationState

TABULATED_TOGETHER = 4
"""Scenarios whose predictions are tabulated at once."""
OUTCOMES = tuple(outcome for outcome in Outcome if outcome is not Outcome.RUNNING)


@pytree_dataclass
class Baseline:
    """What the zero action gets in each scenario. Rewards relative to it have the same optimum, and less noise.

    They are r + γ Φ(s') - Φ(s), with Φ what the zero action gets from that step on in the same scenario and 0 after
    an episode's end (Ng, Harada and Russell, "Policy invariance under reward transformations", ICML 1999): the zero
    action is rewarded with nothing at all.
    """

    to_go: Float[Array, "scenarios steps"]
    """`[scenarios, steps + 1]`, discounted rewards from each step on."""
    discount: Array | float
    """γ."""

    def term(self, scenario: Int[Array, ""], step: Int[Array, ""], terminated: Bool[Array, ""]) -> Float[Array, ""]:
        """γ Φ(s') - Φ(s) for one step in a scenario, after which the episode ends or goes on."""
        to_go = self.to_go[scenario]
        now, later = (to_go[jnp.minimum(at, to_go.shape[0] - 1)] for at in (step, step + 1))
        return self.discount * jnp.where(terminated, 0.0, later) - now


@pytree_dataclass
class EnvironmentParams:
    """What the environment reads but does not change; every leaf is traced."""

    rewards: RewardFactors
    scenarios: Scenario | None
    """`[scenarios]` on every leaf; None if scenarios come straight from a generator."""
    starts: Situation | None
    """`[scenarios]`, how an episode begins in each."""
    chances: Float[Array, "*batch scenarios"] | None
    """`[scenarios]`, cumulative: how often each is drawn."""
    baseline: Baseline | None = None
    """What rewards are relative to, if they are."""


@pytree_dataclass
class EpisodeSums:
    """What an episode's summary is made of."""

    steps: Int[Array, "*batch"]
    ego_risk: Float[Array, "*batch"]
    third_party_risk: Float[Array, "*batch"]
    largest_ego_risk: Float[Array, "*batch"]


@pytree_dataclass
class EnvironmentState:
    """Where an episode stands, and which scenario it is in."""

    situation: Situation
    sums: EpisodeSums
    scenario: Int[Array, "*batch"] | Scenario
    """Which scenario of the set, or the scenario itself if it was generated."""


def make_params(
    config: EnvironmentConfig,
    scenarios: Scenario,
    rewards: RewardFactors | None = None,
    shares: Float[Array, "scenarios"] | None = None,
    progress: Callable[[int], object] = lambda count: None,
) -> EnvironmentParams:
    """A set of scenarios to draw from; what is predicted in them is tabulated.

    Args:
      config: static settings.
      scenarios: `[scenarios]`, stacked.
      rewards: what the reward's terms count; the published factors if not given.
      shares: `[scenarios]`, how often each is drawn, relative to the others; all alike if not given.
      progress: called with the number of scenarios that were tabulated since the last time.

    Raises:
      ValueError: there are not as many shares as scenarios, or they cannot be drawn by.
    """
    count = scenarios.origin.shape[0]
    shares = jnp.ones(count) if shares is None else shares
    if shares.shape != (count,) or not (jnp.all(shares >= 0.0) & (jnp.sum(shares) > 0.0) & (jnp.sum(shares) < jnp.inf)):
        raise ValueError(f"shares of {count} scenarios: give as many numbers of at least 0, not all of them 0")
    tabulated, starts = _in_chunks(_preparation(config), scenarios, min(TABULATED_TOGETHER, count), progress)
    chances = jnp.cumsum(shares / jnp.sum(shares))
    return EnvironmentParams(_as_arrays(rewards), tabulated, starts, chances)


def _as_arrays(rewards: RewardFactors | None) -> RewardFactors:
    return jax.tree.map(jnp.float32, rewards or RewardFactors())


@cache
def _preparation(config: EnvironmentConfig) -> Callable[[Scenario], tuple[Scenario, Situation]]:
    def prepared(scenario: Scenario) -> tuple[Scenario, Situation]:
        return with_predictions(config.planner, scenario), begin(config, scenario)

    return jax.jit(jax.vmap(prepared))


def _in_chunks(function: Callable[[Any], Any], batch: Any, size: int, progress: Callable[[int], object]) -> Any:
    """`function` of a batch, of `size` elements at a time; the last ones are filled up with those before them."""
    count, parts = jax.tree.leaves(batch)[0].shape[0], []
    for first in range(0, count, size):
        begin, known = min(first, count - size), max(first + size - count, 0)
        made = function(jax.tree.map(lambda leaf, begin=begin: leaf[begin : begin + size], batch))
        parts.append(jax.tree.map(lambda leaf, known=known: leaf[known:], made))
        jax.block_until_ready(parts[-1])
        progress(size - known)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


@dataclass(frozen=True)
class DrivingEnvironment:
    """Drives with adjusted cost weights; the contract is gymnax's (`reset`, `step`, both pure, for one environment).

    Episodes end by themselves (`terminated`); `truncated` is always False: running out of time is an outcome with a
    reward of its own, and the remaining time is observed.
    """

    config: EnvironmentConfig = EnvironmentConfig()
    generator: Callable[[Array], Scenario] | None = None
    """Draws a scenario from a random key, in place of a set of scenarios."""

    @property
    def observation_size(self) -> int:
        """Fields of an observation."""
        return len(observation_fields(self.config))

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return len(self.config.adjustments)

    def generator_params(self, rewards: RewardFactors | None = None) -> EnvironmentParams:
        """Parameters where scenarios come from `generator`."""
        return EnvironmentParams(_as_arrays(rewards), None, None, None)

    def reset(self, key: Array, params: EnvironmentParams) -> tuple[Float[Array, "fields"], EnvironmentState]:
        """Draw a scenario and begin an episode in it.

        Args:
          key: random key.
          params: what is drawn from.
        """
        state = self._begin(key, params)
        return state.situation.observation, state

    def step(
        self, key: Array, state: EnvironmentState, action: Float[Array, "actions"], params: EnvironmentParams
    ) -> tuple[
        Float[Array, "fields"], EnvironmentState, Float[Array, ""], Bool[Array, ""], Bool[Array, ""], dict[str, Any]
    ]:
        """Drive one step; an episode that ends is followed by the next one at once.

        Args:
          key: random key, which draws the next scenario.
          state: where the episode stands.
          action: `[actions]`, clipped to [-1, 1].
          params: as for `reset`.

        Returns:
          Observation, state, reward, terminated, truncated, info. If the episode has ended, observation and state are
          the next one's; `info["last_observation"]` always is this one's. `info["metrics"]` tells of the step,
          `info["episode"]` of the whole episode up to it.
        """
        scenario = self._scenario(state, params)
        before = state.situation.simulation
        situation, _, report = proceed(self.config, scenario, state.situation, action)
        after = situation.simulation
        weights = situation.weights
        terminated = after.outcome != Outcome.RUNNING
        terms = reward_terms(params.rewards, self.config.adjustments, weights, before, after, report)
        if params.baseline is not None and not isinstance(state.scenario, Scenario):
            terms["baseline"] = params.baseline.term(state.scenario, before.step, terminated)
        reward = sum(terms.values(), jnp.zeros(()))
        sums = _added(state.sums, report)
        info = {
            "last_observation": situation.observation,
            "metrics": self._metrics(terms, report, weights, before),
            "episode": self._summary(scenario, after, sums),
        }
        going_on = replace(state, situation=situation, sums=sums)
        following = self._begin_if(terminated, key, going_on, params)
        return following.situation.observation, following, reward, terminated, jnp.zeros_like(terminated), info

    def _begin(self, key: Array, params: EnvironmentParams) -> EnvironmentState:
        sums = EpisodeSums(jnp.int32(0), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        if params.starts is None or params.chances is None:
            if self.generator is None:
                raise ValueError("params hold no scenarios: make them with make_params, or give a generator")
            scenario = self.generator(key)
            return EnvironmentState(begin(self.config, scenario), sums, scenario)
        drawn = jnp.searchsorted(params.chances, jax.random.uniform(key) * params.chances[-1], side="right")
        index = jnp.minimum(drawn, params.chances.shape[0] - 1).astype(jnp.int32)
        return EnvironmentState(jax.tree.map(lambda leaf: leaf[index], params.starts), sums, index)

    def _begin_if(
        self, ended: Array, key: Array, state: EnvironmentState, params: EnvironmentParams
    ) -> EnvironmentState:
        """The next episode's begin where one has ended; a scenario is generated only there."""
        if params.starts is not None:
            fresh = self._begin(key, params)
            return jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, state)

        @jax.custom_batching.sequential_vmap
        def one_by_one(ended: Array, key: Array, state: EnvironmentState) -> EnvironmentState:
            return jax.lax.cond(ended, lambda: self._begin(key, params), lambda: state)

        return one_by_one(ended, key, state)

    def _scenario(self, state: EnvironmentState, params: EnvironmentParams) -> Scenario:
        """The scenario that the episode is in, with the predictions of the present step only."""
        if isinstance(state.scenario, Scenario):
            return state.scenario
        assert params.scenarios is not None
        index, table = state.scenario, params.scenarios.predictions
        scenario = jax.tree.map(lambda leaf: leaf[index], replace(params.scenarios, predictions=None))
        if table is None:
            return scenario
        now = jnp.minimum(state.situation.simulation.step, table.heading.shape[1] - 1)
        present: PredictionTable = jax.tree.map(lambda leaf: leaf[index, now][None], table)
        return replace(scenario, predictions=present)

    def _metrics(
        self, terms: dict[str, Array], report: StepReport, weights: Array, before: SimulationState
    ) -> dict[str, Array]:
        adjusted = {f"weight/{one.term}": weights[place] for place, one in enumerate(self.config.adjustments)}
        return {
            **{f"reward/{name}": value for name, value in terms.items()},
            **adjusted,
            "ego_risk": report.ego_risk,
            "third_party_risk": report.third_party_risk,
            "feasible_share": report.feasible_share,
            "emergency": (report.mode == PlanMode.EMERGENCY).astype(jnp.float32),
            "speed": before.ego.speed,
        }

    def _summary(self, scenario: Scenario, state: SimulationState, sums: EpisodeSums) -> dict[str, Array]:
        steps = sums.steps.astype(jnp.float32)
        struck = _struck_from_behind(self.config, scenario, state)
        return {
            **{f"outcome/{one.name.lower()}": (state.outcome == one).astype(jnp.float32) for one in OUTCOMES},
            "outcome/collision_from_behind": struck.astype(jnp.float32),
            "mean_ego_risk": sums.ego_risk / steps,
            "mean_third_party_risk": sums.third_party_risk / steps,
            "max_ego_risk": sums.largest_ego_risk,
        }


def _added(sums: EpisodeSums, report: StepReport) -> EpisodeSums:
    return EpisodeSums(
        sums.steps + 1,
        sums.ego_risk + report.ego_risk,
        sums.third_party_risk + report.third_party_risk,
        jnp.maximum(sums.largest_ego_risk, report.ego_risk),
    )


def _struck_from_behind(config: EnvironmentConfig, scenario: Scenario, state: SimulationState) -> Bool[Array, ""]:
    """Whether an obstacle whose centre lies behind the ego's rear quarter is among those that it collides with.

    Recorded traffic does not react: who follows closely runs into an ego that brakes.
    """
    obstacles, ego = scenario.obstacles, ego_box(config.planner, state)
    now = jnp.minimum(state.step, obstacles.valid.shape[1] - 1)
    away = obstacles.position[:, now] - jnp.stack([ego.x, ego.y])
    ahead, aside = away[:, 0] * ego.cos + away[:, 1] * ego.sin, away[:, 1] * ego.cos - away[:, 0] * ego.sin
    behind = ahead < -jnp.abs(aside)
    return (state.outcome == Outcome.COLLISION_OBSTACLE) & jnp.any(behind & hits_recorded(obstacles, state.step, ego))
