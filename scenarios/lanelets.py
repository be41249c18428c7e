"""Lanelets: the pieces of lane that a road network is made of (Bender et al. 2014), in plain arrays.

A network is a dictionary from id to `Lanelet`; all references in it point to lanelets of the same network.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from scenarios import polyline
from scenarios.polyline import Points


class Neighbor(NamedTuple):
    """A lanelet beside another one."""

    id: int
    same_direction: bool


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A piece of lane between two bounds with equally many points, in driving direction."""

    id: int
    left_bound: Points
    """`[points, 2]`, m."""
    right_bound: Points
    """`[points, 2]`, m."""
    predecessors: tuple[int, ...]
    successors: tuple[int, ...]
    left: Neighbor | None
    right: Neighbor | None

    @cached_property
    def center_line(self) -> Points:
        """`[points, 2]`, m, midway between the bounds."""
        return polyline.without_repeats(0.5 * (self.left_bound + self.right_bound))

    @cached_property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return float(polyline.arc_lengths(self.center_line)[-1])

    @cached_property
    def outline(self) -> Points:
        """`[points, 2]`, m, ring around the lanelet."""
        return polyline.without_repeats(np.concatenate([self.right_bound, self.left_bound[::-1]]))

    def contains(self, position: Points) -> bool:
        """Whether `position` `[2]` lies in the lanelet."""
        return bool(polyline.contains(polyline.ring_edges(self.outline), position[None])[0])


Network = dict[int, Lanelet]
"""A road network: its lanelets by id."""
