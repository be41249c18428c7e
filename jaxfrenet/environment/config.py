"""Settings of the learning problem."""

from __future__ import annotations

from dataclasses import dataclass

from jaxfrenet.config import PlannerConfig
from jaxfrenet.environment.action import PAPER_ADJUSTMENTS, Adjustment
from jaxfrenet.sampling import SAMPLING_TERMS


@dataclass(frozen=True)
class EnvironmentConfig:
    """What is static about the environment; frozen and hashable."""

    planner: PlannerConfig = PlannerConfig(predictor="neural")
    adjustments: tuple[Adjustment, ...] = PAPER_ADJUSTMENTS
    """What the agent may change."""

    def __post_init__(self) -> None:
        """Refuse a table that no action can be made of.

        Raises:
          ValueError: it has no cost term, or one comes twice.
        """
        object.__setattr__(self, "adjustments", tuple(self.adjustments))
        terms = [one.term for one in self.adjustments]
        if not set(terms).difference(SAMPLING_TERMS) or len(set(terms)) != len(terms):
            raise ValueError(f"adjustments are {terms}: name at least one cost term, and each once")
