"""What an agent may change: a table of adjustments, and what an action makes of them (paper, "Action Space").

Most adjust the weight of a cost term, as in the paper; some, as in its outlook, how far the sampling reaches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfrenet._typing import Array, Float
from jaxfrenet.costs import COST_TERMS, CostTerm, CostWeights, ExtraTerm
from jaxfrenet.sampling import SAMPLING_TERMS, SamplingRange


@dataclass(frozen=True)
class Adjustment:
    """One number of the action: by how much one cost weight, or one range of the sampling, changes in a step."""

    term: str
    """The cost term whose weight it is, or the range in `SAMPLING_TERMS`."""
    scale: float
    """Change of the weight for an action of 1."""
    low: float
    """Lowest weight."""
    high: float
    """Highest weight."""
    default: float
    """Weight at the start of an episode, which the zero action keeps. Where it is the planner's own, 1 for a range, the
    zero action drives as the default planner does."""
    cost: CostTerm | None = None
    """What computes the term where it is not one of `COST_TERMS`; `term` then only names it."""

    def __post_init__(self) -> None:
        """Refuse what cannot be adjusted.

        Raises:
          ValueError: there is no such cost term, or the planner has another one of that name, or the numbers make no
            range around the default.
        """
        known = (*COST_TERMS, *SAMPLING_TERMS)
        if self.cost is None and self.term not in known:
            raise ValueError(f"adjustment of {self.term!r}: there is no such cost term; there are {', '.join(known)}")
        if self.cost is not None and self.term in known:
            raise ValueError(f"adjustment of {self.term!r}: the planner has a term of that name; choose another name")
        ordered = 0.0 <= self.low <= self.default <= self.high < math.inf and self.low < self.high
        if not (ordered and 0.0 < self.scale < math.inf):
            raise ValueError(
                f"adjustment of {self.term!r}: choose finite numbers, a scale above 0, and 0 ≤ low ≤ default ≤ high"
            )


PAPER_ADJUSTMENTS = (
    Adjustment("prediction", scale=20.0, low=0.0, high=400.0, default=200.0),
    Adjustment("lateral_jerk", scale=0.1, low=0.001, high=2.0, default=1.0),
    Adjustment("longitudinal_jerk", scale=0.1, low=0.001, high=2.0, default=1.0),
    Adjustment("distance_to_reference_path", scale=0.1, low=0.001, high=2.0, default=1.0),
    Adjustment("velocity_offset", scale=0.1, low=0.001, high=2.0, default=1.0),
)
"""The paper's action space; any other cost term can be added."""
SAMPLING_ADJUSTMENTS = (
    *PAPER_ADJUSTMENTS,
    Adjustment("acceleration_range", scale=0.2, low=0.0, high=2.0, default=1.0),
    Adjustment("braking_range", scale=0.1, low=0.1, high=1.0, default=1.0),
    Adjustment("lateral_range", scale=0.1, low=0.1, high=1.0, default=1.0),
)
"""The same and how far the sampling reaches, which the paper's outlook proposes."""


def default_weights(adjustments: tuple[Adjustment, ...]) -> Float[Array, "actions"]:
    """`[actions]`, the weights at the start of an episode, in the order of the table."""
    return jnp.asarray(_column(adjustments, "default"))


def adjust(
    adjustments: tuple[Adjustment, ...], weights: Float[Array, "actions"], action: Float[Array, "actions"]
) -> Float[Array, "actions"]:
    """The weights after an action: ω ← clip(ω + scale · a, low, high).

    Args:
      adjustments: the table.
      weights: `[actions]`, before.
      action: `[actions]`, clipped to [-1, 1]; what is not a number changes nothing.
    """
    change = _column(adjustments, "scale") * jnp.clip(jnp.where(jnp.isnan(action), 0.0, action), -1.0, 1.0)
    return jnp.clip(weights + change, _column(adjustments, "low"), _column(adjustments, "high"))


def normalized(adjustments: tuple[Adjustment, ...], weights: Float[Array, "actions"]) -> Float[Array, "actions"]:
    """`[actions]`, the weights on the scale from low, -1, to high, 1."""
    low, high = _column(adjustments, "low"), _column(adjustments, "high")
    return 2.0 * (weights - low) / (high - low) - 1.0


def cost_weights(adjustments: tuple[Adjustment, ...], weights: Float[Array, "actions"]) -> CostWeights:
    """The planner's weights; terms that the table leaves out are switched off."""
    known: dict[str, Any] = dict.fromkeys(COST_TERMS)
    known |= {one.term: weights[place] for place, one in enumerate(adjustments) if one.term in COST_TERMS}
    extra = [ExtraTerm(one.cost, weights[place]) for place, one in enumerate(adjustments) if one.cost is not None]
    return CostWeights(**known, extra=tuple(extra))


def sampling_range(adjustments: tuple[Adjustment, ...], weights: Float[Array, "actions"]) -> SamplingRange | None:
    """How far the planner's sampling reaches; `None`, as in the config, if the table says nothing about it."""
    reach = {one.term: weights[place] for place, one in enumerate(adjustments) if one.term in SAMPLING_TERMS}
    return SamplingRange(**reach) if reach else None


def _column(adjustments: tuple[Adjustment, ...], name: str) -> np.ndarray:
    return np.asarray([getattr(one, name) for one in adjustments], np.float32)
