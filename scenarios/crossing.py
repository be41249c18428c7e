"""Urban crossings of four arms, drawn at random: traffic from every side, and pedestrians across the arms."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

import jaxfrenet as jf
from jaxfrenet._typing import Array
from scenarios.distributions import Dice, Knots, check_knots, check_shares
from scenarios.junction import lanelet_links
from scenarios.junction_scenario import draw_scenario, role_table
from scenarios.junction_task import JunctionTask, Stream
from scenarios.lanelet_map import LaneletMap
from scenarios.vehicle_types import MIXED, VehicleType

ROUTES = ((0, 3), (0, 1), (0, 2))
"""Arm in, arm out: the left turn, the right turn and straight on; all arms are alike."""
ROLES_OF_ROUTES = role_table(4, ROUTES)
LINKS = lanelet_links(4)
DICE = 160
"""Random numbers per scenario, at least as many as are taken."""

TRAFFIC = (
    Stream("own", vehicles=1, arrival=(-8.0, -4.0), speed=(5.0, 9.0), spacing=(15.0, 30.0), goes_first=True),
    Stream("other", vehicles=3, arrival=(-6.0, -2.0, 2.0, 6.0), speed=(4.0, 10.0), spacing=(10.0, 40.0)),
    Stream("fourth", vehicles=2, arrival=(-6.0, -2.0, 2.0, 6.0), speed=(4.0, 10.0), spacing=(10.0, 40.0)),
    Stream("exit", vehicles=2, arrival=(-6.0, -2.0, 2.0, 6.0), speed=(3.0, 8.0), spacing=(10.0, 30.0)),
)
"""One vehicle ahead, and crossing and oncoming traffic from the three other arms."""


@dataclass(frozen=True, kw_only=True)
class CrossingConfig(JunctionTask):
    """What crossings are drawn from; frozen and hashable, so it is a static argument under `jit`."""

    turns: tuple[float, float, float] = (0.35, 0.25, 0.4)
    """Shares of left turns, right turns and going straight."""
    skew: Knots = (-0.15, 0.15)
    """Angle by which each arm deviates from a right-angled crossing [rad]."""
    streams: tuple[Stream, ...] = TRAFFIC
    vehicle_types: tuple[VehicleType, ...] = MIXED
    pedestrians: int = 3

    def __post_init__(self) -> None:
        """Refuse what no scenario can be made of.

        Raises:
          ScenarioError: a value is impossible.
        """
        super().__post_init__()
        check_shares("turns", self.turns, "left turns, right turns, going straight")
        check_knots("skew", self.skew, -0.2, 0.2)


def sample(key: Array, config: CrossingConfig) -> jf.Scenario:
    """Draw a scenario; pure, works under `jit` (config static) and `vmap` (over keys).

    Args:
      key: random key; the same key gives the same scenario.
      config: what is drawn from.
    """
    return sample_with_map(key, config)[0]


def sample_with_map(key: Array, config: CrossingConfig) -> tuple[jf.Scenario, LaneletMap]:
    """`sample`, with the borders of the map's lanelets; `LINKS` tells how they hang together."""
    dice = Dice(key, DICE)
    roles = jnp.asarray(ROLES_OF_ROUTES)[dice.choose(config.turns)]
    angle = jnp.asarray(0.5 * np.pi * np.arange(4), jnp.float32) + dice.draw(config.skew, (4,))
    return draw_scenario(dice, config, angle, roles)


HARD = CrossingConfig(
    density=1.0,
    gap=0.6,
    speed_spread=0.25,
    yielding=0.2,
    start_speed=(4.0, 9.0),
    start_distance=(8.0, 30.0),
    pace=(5.5, 9.0),
    pedestrians=4,
)
"""Dense traffic that rarely yields, and many pedestrians."""

PRESETS = {"default": CrossingConfig(), "hard": HARD}
