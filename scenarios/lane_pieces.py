"""The lanes of a map as pieces of evenly spaced centre-line nodes that follow each other; see `jaxfrenet.LaneMap`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxfrenet.scenario import LANE_NODES
from scenarios import polyline
from scenarios.lanelets import Network
from scenarios.polyline import Points

LONGEST_PIECE = 30.0
"""Longest piece [m]: nodes are less than 2 m apart."""


class LanePieces(NamedTuple):
    """All pieces of a map."""

    center: NDArray[np.float64]
    """`[pieces, LANE_NODES, 2]`, m."""
    length: NDArray[np.float64]
    """`[pieces]`, m."""
    successors: NDArray[np.int32]
    """`[pieces, 3]`, the leftmost, straightest and rightmost; -1 where a lane ends."""


def cut(network: Network) -> LanePieces:
    """Cut all lanes of a road network; lanelets between which nothing forks or merges count as one."""
    chains, lines = [], []
    for chain in _chains(network):
        line = polyline.without_repeats(np.concatenate([network[id_].center_line for id_ in chain]))
        if len(line) > 1:
            chains.append(chain)
            lines.append(line)
    lengths = [float(polyline.arc_lengths(line)[-1]) for line in lines]
    counts = [math.ceil(length / LONGEST_PIECE) for length in lengths]
    first = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    of_lanelet = {chain[0]: index for index, chain in enumerate(chains)}
    successors = np.repeat(np.arange(1, first[-1] + 1, dtype=np.int32)[:, None], 3, axis=1)
    for index, chain in enumerate(chains):
        following = [of_lanelet[id_] for id_ in network[chain[-1]].successors if id_ in of_lanelet]
        ways = _ways(lines[index], [lines[other] for other in following])
        successors[first[index + 1] - 1] = [first[following[way]] for way in ways] if following else -1
    center = [
        polyline.at_arc_lengths(line, np.linspace(0.0, length, count * (LANE_NODES - 1) + 1))
        for line, length, count in zip(lines, lengths, counts, strict=True)
    ]
    pieces = [
        nodes[start * (LANE_NODES - 1) : (start + 1) * (LANE_NODES - 1) + 1]
        for nodes, count in zip(center, counts, strict=True)
        for start in range(count)
    ]
    length = np.repeat(np.divide(lengths, counts), counts)
    return LanePieces(np.stack(pieces), length, successors)


def _chains(network: Network) -> list[list[int]]:
    """Lanelets one after the other, of which each is the only one behind the one before and before the one behind."""

    def only_next(id_: int) -> int | None:
        following = network[id_].successors
        if len(following) == 1 and len(network[following[0]].predecessors) == 1 and following[0] != id_:
            return following[0]
        return None

    inner = {only_next(id_) for id_ in network}
    heads = [id_ for id_ in network if id_ not in inner]
    chains, seen = [], set[int]()
    for head in [*heads, *network]:  # the second part: rings, which have no head
        chain, at = [], head
        while at is not None and at not in seen:
            seen.add(at)
            chain.append(at)
            at = only_next(at)
        if chain:
            chains.append(chain)
    return chains


def _ways(line: Points, following: list[Points]) -> list[int]:
    """Which of the lines behind a line turns most to the left, least, and most to the right; none if there is none."""
    if not following:
        return []
    end = _direction(line[-2], line[-1])
    turns = np.array([_direction(other[-2], other[-1]) - end for other in following])
    turns = (turns + np.pi) % (2.0 * np.pi) - np.pi
    return [int(np.argmax(turns)), int(np.argmin(np.abs(turns))), int(np.argmin(turns))]


def _direction(start: Points, end: Points) -> float:
    step = end - start
    return float(np.arctan2(step[1], step[0]))
