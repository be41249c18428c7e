"""What drives in generated traffic: kinds of vehicles, how often, how large and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._typing import Array
from scenarios.distributions import Dice, Knots, check_knots, check_number, quantile


@dataclass(frozen=True)
class VehicleType:
    """A kind of vehicle."""

    kind: jf.ObstacleKind
    share: float
    """Probability relative to the others'."""
    length: Knots
    """m."""
    width: Knots
    """m; as large within its range as the length is in its own."""
    top_speed: float
    """m/s."""

    def __post_init__(self) -> None:
        """Refuse what no vehicle is.

        Raises:
          ScenarioError: a value is impossible.
        """
        check_number(f"share of {self.kind.name.lower()}s", self.share, 0.0, 1e6)
        check_knots(f"length of {self.kind.name.lower()}s", self.length, 0.3, 20.0)
        check_knots(f"width of {self.kind.name.lower()}s", self.width, 0.3, 3.0)
        check_number(f"top_speed of {self.kind.name.lower()}s", self.top_speed, 0.1, 70.0)


CAR = VehicleType(jf.ObstacleKind.CAR, 0.7, (4.2, 5.0), (1.75, 2.0), 50.0)
TRUCK = VehicleType(jf.ObstacleKind.TRUCK, 0.1, (7.0, 10.0), (2.3, 2.5), 22.0)
MOTORCYCLE = VehicleType(jf.ObstacleKind.MOTORCYCLE, 0.1, (2.0, 2.3), (0.75, 0.9), 50.0)
BICYCLE = VehicleType(jf.ObstacleKind.BICYCLE, 0.1, (1.7, 1.9), (0.55, 0.7), 6.0)
MIXED = (CAR, TRUCK, MOTORCYCLE, BICYCLE)
"""Urban traffic."""


def draw_types(dice: Dice, types: tuple[VehicleType, ...], count: int) -> tuple[Array, Array, Array, Array]:
    """Kind, length [m], width [m] and top speed [m/s] of `count` vehicles."""
    which = dice.choose([one.share for one in types], (count,))
    size = dice.uniform((count,))
    lengths, widths = (
        jnp.stack([quantile(size, knots) for knots in every])
        for every in ([one.length for one in types], [one.width for one in types])
    )
    vehicles = jnp.arange(count)
    kinds = jnp.asarray([one.kind for one in types], jnp.int32)
    top_speeds = jnp.asarray([one.top_speed for one in types], jnp.float32)
    return kinds[which], lengths[which, vehicles], widths[which, vehicles], top_speeds[which]
