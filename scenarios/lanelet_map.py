"""The lanelets of a generated map, as arrays that come with a scenario, and how they hang together."""

from __future__ import annotations

from typing import NamedTuple

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float


@pytree_dataclass
class LaneletMap:
    """Borders of a map's lanelets in the scenario's frame; the lanelets of one family are always the same ones."""

    left: tuple[Float[Array, "*batch corners 2"], ...]
    """One `[corners, 2]`, m, per lanelet."""
    right: tuple[Float[Array, "*batch corners 2"], ...]
    """One `[corners, 2]`, m, per lanelet."""
    is_goal: Bool[Array, "*batch lanelets"]
    """`[lanelets]`, which of them are the goal's region."""


class LaneletLinks(NamedTuple):
    """What one lanelet is connected to, by index."""

    successors: tuple[int, ...]
    left: int | None = None
    """The lanelet to its left."""
    left_same_direction: bool = False
    right: int | None = None
    """The lanelet to its right, always of the same direction."""
