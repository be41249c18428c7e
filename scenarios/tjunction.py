"""Three-way junctions, drawn at random: two arms of a through road and a stem that meets it from one side.

`sample` is a pure function of a key, so scenarios can be drawn inside a compiled program, a batch of them by `vmap`.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._typing import Array
from scenarios.distributions import Dice, Knots, check_knots, check_number, check_shares
from scenarios.errors import ScenarioError
from scenarios.junction import lanelet_links
from scenarios.junction_scenario import draw_scenario, role_table
from scenarios.junction_task import JunctionTask, Stream
from scenarios.lanelet_map import LaneletMap
from scenarios.vehicle_types import MIXED, VehicleType

ROUTES = ((0, 2), (2, 1), (1, 2), (2, 0), (0, 1), (1, 0))
"""Arm in, arm out: left turns from the through road and from the stem, right turns likewise, both straight ways."""
ROLES_OF_ROUTES = role_table(3, ROUTES)
LINKS = lanelet_links(3)
STRAIGHT_ON = 2
"""The third of the turns, where the second route is the way back."""
DICE = 128
"""Random numbers per scenario, at least as many as are taken."""

TRAFFIC = (
    Stream("own", vehicles=1, arrival=(-8.0, -4.0), speed=(5.0, 9.0), spacing=(15.0, 30.0), goes_first=True),
    Stream("own", vehicles=1, arrival="behind the ego", speed=(0.1, 0.4), spacing=(10.0, 20.0)),
    Stream("other", vehicles=4, arrival=(-6.0, -2.0, 2.0, 6.0), speed=(4.0, 10.0), spacing=(10.0, 40.0)),
    Stream("exit", vehicles=2, arrival=(-6.0, -2.0, 2.0, 6.0), speed=(3.0, 7.0), spacing=(10.0, 30.0)),
)
"""One vehicle ahead, one behind, oncoming traffic, and some from the arm that the ego turns into."""


@dataclass(frozen=True, kw_only=True)
class TJunctionConfig(JunctionTask):
    """What T-junctions are drawn from; frozen and hashable, so it is a static argument under `jit`."""

    turns: tuple[float, float, float] = (0.7, 0.15, 0.15)
    """Shares of left turns, right turns and going straight; the left turn is the paper's task."""
    from_stem: float = 0.35
    """Probability that a turn begins on the stem instead of the through road."""
    skew: Knots = (-0.3, 0.3)
    """Angle between the stem and the through road's normal [rad]."""
    kink: Knots = (-0.15, 0.15)
    """Angle by which each arm of the through road deviates from a straight line [rad]."""
    streams: tuple[Stream, ...] = TRAFFIC
    vehicle_types: tuple[VehicleType, ...] = MIXED

    def __post_init__(self) -> None:
        """Refuse what no scenario can be made of.

        Raises:
          ScenarioError: a value is impossible.
        """
        super().__post_init__()
        check_shares("turns", self.turns, "left turns, right turns, going straight")
        check_number("from_stem", self.from_stem, 0.0, 1.0)
        check_knots("skew", self.skew, -0.35, 0.35)
        check_knots("kink", self.kink, -0.2, 0.2)
        if any("fourth" in (stream.origin, stream.destination) for stream in self.streams):
            raise ScenarioError("a stream names the arm 'fourth', which a T-junction has not: use own, exit or other")


def sample(key: Array, config: TJunctionConfig) -> jf.Scenario:
    """Draw a scenario; pure, works under `jit` (config static) and `vmap` (over keys).

    Args:
      key: random key; the same key gives the same scenario.
      config: what is drawn from.
    """
    return sample_with_map(key, config)[0]


def sample_with_map(key: Array, config: TJunctionConfig) -> tuple[jf.Scenario, LaneletMap]:
    """`sample`, with the borders of the map's lanelets; `LINKS` tells how they hang together."""
    dice = Dice(key, DICE)
    turn = dice.choose(config.turns)
    from_stem = dice.uniform() < jnp.where(turn == STRAIGHT_ON, 0.5, config.from_stem)
    kink, skew = dice.draw(config.kink, (2,)), dice.draw(config.skew, (1,))
    angle = jnp.asarray([0.0, np.pi, 1.5 * np.pi]) + jnp.concatenate([kink, skew])
    roles = jnp.asarray(ROLES_OF_ROUTES)[2 * turn + from_stem.astype(jnp.int32)]
    return draw_scenario(dice, config, angle, roles)


COMMONROAD = TJunctionConfig(
    turns=(1.0, 0.0, 0.0),
    from_stem=0.0,
    own_arm=(90.0, 120.0),
    exit_arm=(150.0, 200.0),
    other_arms=(60.0, 75.0),
    turn_radius=(7.5, 8.5),
    lane_width=(3.4, 3.8),
    skew=(-0.15, 0.15),
    kink=(-0.05, 0.05),
    start_time=(3.59, 5.96, 6.84, 7.71, 8.52, 9.59, 12.01, 13.0, 13.33),
    start_speed=(1.94, 3.44, 4.13, 4.47, 5.06, 5.631, 5.633, 5.635, 5.635),
    goal_in_junction="at start speed",
    goal_steps=(146, 147),
    density=1.0,
    separation=2.8,
    yielding=1.0,
    speed_spread=0.0,
    slow_in_curves=False,
    vehicle_types=(VehicleType(jf.ObstacleKind.CAR, 1.0, (5.0,), (2.0,), 16.0),),
    streams=(
        Stream(
            "own",
            "exit",
            arrival="behind the ego",
            speed=(0.0, 0.12, 0.21, 0.28, 0.34, 0.43, 0.52, 0.64, 1.0),
            spacing=(8.0,),
        ),
        Stream(
            "other",
            "own",
            vehicles=2,
            arrival=(-8.47, -6.26, -3.65, -3.03, -2.58, -2.12, 2.86, 5.65, 7.24),
            speed=(3.09, 4.61, 5.15, 5.45, 5.93, 6.2, 7.41, 8.83, 15.65),
            spacing=(8.0,),
            follower_speed=(0.06, 0.19, 0.27, 0.34, 0.4, 0.48, 0.59, 0.68, 0.96),
            followers_arrive=False,
        ),
        Stream(
            "exit",
            "other",
            vehicles=2,
            arrival=(-7.23, -4.92, -3.06, 2.44, 2.94, 3.39, 3.96, 4.66, 8.13),
            distance=(35.5, 35.7, 36.1, 36.7, 40.2, 43.4, 48.6, 58.9, 89.8),
            spacing=(8.0,),
            follower_speed=(0.22, 0.36, 0.42, 0.48, 0.52, 0.6, 0.68, 0.79, 0.89),
            followers_arrive=False,
        ),
    ),
)
"""Like CommonRoad's T-junction family `ZAM_Tjunction-1`: its distributions of start speed, distance to the goal, speeds
and time gaps of traffic, as quantiles of the 410 training files."""

HARD = TJunctionConfig(
    turns=(1.0, 0.0, 0.0),
    density=1.0,
    gap=0.6,
    speed_spread=0.25,
    yielding=0.2,
    start_speed=(4.0, 9.0),
    start_distance=(8.0, 30.0),
    pace=(5.5, 9.0),
)
"""Left turns through dense, fast traffic that rarely yields."""

PRESETS = {"default": TJunctionConfig(), "commonroad": COMMONROAD, "hard": HARD}
