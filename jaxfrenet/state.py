"""The state of the closed loop between two steps."""

from __future__ import annotations

from enum import IntEnum

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float, Int
from jaxfrenet.trajectories import EgoState
from jaxfrenet.vehicle import Vehicle


class Outcome(IntEnum):
    """How an episode stands or has ended (paper, section "Reward design")."""

    RUNNING = 0
    GOAL_REACHED_IN_TIME = 1
    GOAL_REACHED_FASTER = 2
    GOAL_REACHED_LATE = 3
    COLLISION_OBSTACLE = 4
    COLLISION_ROAD = 5
    INFEASIBLE = 6
    TIMEOUT = 7
    PAST_GOAL = 8


@pytree_dataclass
class SimulationState:
    """Where the ego is, which step it is, and whether the episode has ended."""

    ego: EgoState
    step: Int[Array, "*batch"]
    """`[]`, steps driven so far."""
    outcome: Int[Array, "*batch"]
    """`[]`, an `Outcome`."""
    met_goal_region: Bool[Array, "*batch"]
    """`[]`, whether the ego has been inside a goal region at some step."""

    def center(self, vehicle: Vehicle) -> Float[Array, "2"]:
        """`[2]`, m, the vehicle's centre."""
        ahead = vehicle.rear_axle_to_center
        return jnp.stack(
            [self.ego.x + ahead * jnp.cos(self.ego.heading), self.ego.y + ahead * jnp.sin(self.ego.heading)]
        )
