"""What drives: the default planner with fixed weights, or the hybrid planner, whose weights a policy adjusts."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp

import jaxfrenet as jf
import ppo
from jaxfrenet._typing import Array
from jaxfrenet.environment import (
    Adjustment,
    EnvironmentConfig,
    Situation,
    begin,
    observation_fields,
    proceed,
    roll_out_policy,
)
from jaxfrenet.environment.action import cost_weights, default_weights
from scenarios.command_line import UserError

SHIPPED = Path(__file__).parent / "policies" / "default"
"""The policy that comes with the project."""


class StepResult(NamedTuple):
    """One step of the closed loop."""

    memory: Any
    """What the planner remembers."""
    cycle: jf.PlanningCycle
    state: jf.SimulationState
    report: jf.StepReport


class Planner(Protocol):
    """Something that drives; `parameters` are traced, all else is static."""

    @property
    def config(self) -> jf.PlannerConfig:
        """Settings of the planning cycles."""
        ...

    @property
    def parameters(self) -> Any:
        """A pytree of numbers that driving depends on."""
        ...

    @property
    def terms(self) -> tuple[str, ...]:
        """The cost terms that rank trajectories, in the order of the reports."""
        ...

    def roll_out(self, parameters: Any, scenario: jf.Scenario, max_steps: int) -> jf.Episode:
        """Drive one scenario to its end."""
        ...

    def begin(self, parameters: Any, scenario: jf.Scenario) -> tuple[Any, jf.SimulationState]:
        """What is remembered before the first step, and the state then."""
        ...

    def step(self, parameters: Any, memory: Any, state: jf.SimulationState, scenario: jf.Scenario) -> StepResult:
        """Drive one step."""
        ...


class Fixed(NamedTuple):
    """What the default planner keeps."""

    weights: jf.CostWeights
    reach: jf.SamplingRange | None
    """How far its sampling reaches; as the config has it if None."""


@dataclass(frozen=True)
class DefaultPlanner:
    """The planner with fixed cost weights and sampling ranges."""

    config: jf.PlannerConfig
    weights: jf.CostWeights
    reach: jf.SamplingRange | None = None

    @property
    def parameters(self) -> Fixed:
        """Weights and ranges."""
        return Fixed(self.weights, self.reach)

    @property
    def terms(self) -> tuple[str, ...]:
        """Those with a weight."""
        return self.weights.names()

    def roll_out(self, parameters: Fixed, scenario: jf.Scenario, max_steps: int) -> jf.Episode:
        """Drive one scenario to its end."""
        return jf.roll_out(self.config, scenario, parameters.weights, max_steps, parameters.reach)

    def begin(self, parameters: Fixed, scenario: jf.Scenario) -> tuple[None, jf.SimulationState]:
        """Nothing is remembered."""
        return None, jf.reset(self.config, scenario)

    def step(self, parameters: Fixed, memory: None, state: jf.SimulationState, scenario: jf.Scenario) -> StepResult:
        """Drive one step."""
        cycle = jf.plan(self.config, scenario, state, *parameters)
        return StepResult(None, cycle, *jf.advance(self.config, scenario, state, cycle, parameters.weights))


class _Driving(NamedTuple):
    """What the hybrid planner remembers."""

    carry: Any
    situation: Situation


@dataclass(frozen=True)
class HybridPlanner:
    """The planner whose cost weights a policy's mean actions adjust."""

    environment: EnvironmentConfig
    parameters: ppo.Policy

    @property
    def config(self) -> jf.PlannerConfig:
        """Settings of the planning cycles."""
        return self.environment.planner

    @property
    def terms(self) -> tuple[str, ...]:
        """Those whose weights the policy adjusts."""
        adjustments = self.environment.adjustments
        return cost_weights(adjustments, default_weights(adjustments)).names()

    def roll_out(self, parameters: ppo.Policy, scenario: jf.Scenario, max_steps: int) -> jf.Episode:
        """Drive one scenario to its end."""
        memory = parameters, ppo.initial_carry(parameters, (1,))
        return roll_out_policy(self.environment, scenario, _act, memory, max_steps)

    def begin(self, parameters: ppo.Policy, scenario: jf.Scenario) -> tuple[_Driving, jf.SimulationState]:
        """The policy's memory is empty."""
        situation = begin(self.environment, scenario)
        return _Driving(ppo.initial_carry(parameters, (1,)), situation), situation.simulation

    def step(
        self, parameters: ppo.Policy, memory: _Driving, state: jf.SimulationState, scenario: jf.Scenario
    ) -> StepResult:
        """Drive one step."""
        (_, carry), action = _act((parameters, memory.carry), memory.situation.observation)
        situation, cycle, report = proceed(self.environment, scenario, memory.situation, action)
        return StepResult(_Driving(carry, situation), cycle, situation.simulation, report)


def _act(memory: tuple[ppo.Policy, Any], observation: Array) -> tuple[tuple[ppo.Policy, Any], Array]:
    policy, carry = memory
    carry, action = ppo.act(policy, carry, observation[None], jnp.zeros(1, bool))
    return (policy, carry), action[0]


def describe(config: EnvironmentConfig) -> dict[str, Any]:
    """What a policy's folder says about the environment that it was trained in."""
    return {
        "observation_names": [field.name for field in observation_fields(config)],
        "action_names": [one.term for one in config.adjustments],
        "adjustments": [asdict(one) for one in config.adjustments],
    }


def load_hybrid(folder: Path | None, planner: jf.PlannerConfig) -> HybridPlanner:
    """Read a policy for a planner.

    Args:
      folder: that training wrote; None for the policy that comes with the project.
      planner: settings of the planning cycles.

    Raises:
      UserError: the folder holds no policy, or one that sees or does something else.
    """
    folder = SHIPPED if folder is None else folder
    try:
        _, description = ppo.load_policy(folder)
        config = EnvironmentConfig(planner, tuple(Adjustment(**one) for one in description.get("adjustments", [])))
        here = describe(config)
        policy, _ = ppo.load_policy(folder, here["observation_names"], here["action_names"])
    except ppo.PolicyError as error:
        raise UserError(f"--policy {error}") from None
    except (TypeError, ValueError) as error:
        raise UserError(f"--policy {folder}: {error}; train it again") from None
    return HybridPlanner(config, policy)
