"""Scenarios of like sizes together: batches that are padded little, in few different sizes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import jaxfrenet as jf
from scenarios.batching import AXES, PADDED_AXES, leaves_of, rounded_up, sizes_of, stack
from scenarios.errors import ScenarioError


class Bucket(NamedTuple):
    """Scenarios of like sizes as one batch."""

    indices: tuple[int, ...]
    """Which scenarios these are, by their place in what was divided, in increasing order."""
    scenario: jf.Scenario
    """All of them, padded to sizes on the scale of `rounded_up`, with a leading batch axis."""


def make_buckets(scenarios: Sequence[jf.Scenario], max_waste: float = 0.25) -> tuple[Bucket, ...]:
    """Divide scenarios into few batches of like sizes; see `group_by_size` for the rule.

    Args:
      scenarios: at least one, not batches.
      max_waste: how much more memory the batches may take than if each scenario were padded to its own sizes, rounded
        up. With 0 each of these sizes has a batch; larger shares give fewer batches.

    Returns:
      The buckets, those of small scenarios first; every scenario is in exactly one.

    Raises:
      ScenarioError: there is no scenario, or `max_waste` is negative or not finite.
    """
    if not scenarios:
        raise ScenarioError("no scenario to put into buckets; give at least one")
    if not 0.0 <= max_waste < math.inf:
        raise ScenarioError(f"max_waste is {max_waste}; give a share that is not negative, such as 0.25")
    sizes = [{axis: rounded_up(size) for axis, size in sizes_of(one).items()} for one in scenarios]
    groups = group_by_size(sizes, bytes_per_element(scenarios[0]), max_waste)
    return tuple(
        Bucket(tuple(indices), stack([scenarios[index] for index in indices], common)) for indices, common in groups
    )


def bytes_per_element(scenario: jf.Scenario) -> dict[str, int]:
    """For each leaf of a scenario, by name, the bytes that one element of its padded axes takes."""
    return {
        name: leaf.itemsize * math.prod(size for axis, size in zip(AXES[name], leaf.shape, strict=True) if not axis)
        for name, leaf in leaves_of(scenario).items()
    }


def group_by_size(
    sizes: Sequence[Mapping[str, int]], element_bytes: Mapping[str, int], max_waste: float
) -> list[tuple[list[int], dict[str, int]]]:
    """Group scenarios so that padding each to the largest sizes in its group wastes little memory.

    At first each combination of sizes is a group. Then, again and again, those two groups are joined for which this
    adds the least padding, as long as all padding takes at most `max_waste` of what the scenarios' own sizes take.

    Args:
      sizes: the sizes of each scenario's axes, see `sizes_of`; at least one.
      element_bytes: see `bytes_per_element`.
      max_waste: the share of memory that padding may add.

    Returns:
      For each group the scenarios' indices and the largest sizes; groups of small scenarios first.
    """
    alike: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for index, one in enumerate(sizes):
        alike[tuple(one[axis] for axis in PADDED_AXES)].append(index)
    members, largest = list(alike.values()), np.array(list(alike), np.int64)
    counts = np.array([len(indices) for indices in members])
    allowed = max_waste * np.sum(counts * _bytes_of(largest, element_bytes))
    costs = np.stack([_costs_of_joining(group, largest, counts, element_bytes) for group in range(len(members))])
    while np.min(costs) <= allowed:
        kept, joined = divmod(int(np.argmin(costs)), len(members))
        allowed -= costs[kept, joined]
        largest[kept] = np.maximum(largest[kept], largest[joined])
        counts[kept], counts[joined] = counts[kept] + counts[joined], 0
        members[kept], members[joined] = sorted(members[kept] + members[joined]), []
        costs[joined] = costs[:, joined] = np.inf
        costs[kept] = costs[:, kept] = _costs_of_joining(kept, largest, counts, element_bytes)
    order = np.argsort(_bytes_of(largest, element_bytes), kind="stable")
    return [
        (members[group], dict(zip(PADDED_AXES, largest[group].tolist(), strict=True)))
        for group in order
        if counts[group]
    ]


def _costs_of_joining(
    group: int, largest: NDArray[np.int64], counts: NDArray[np.int64], element_bytes: Mapping[str, int]
) -> NDArray[np.float64]:
    """Bytes of padding `[groups]` that joining this group with each other adds; infinite with itself and empty ones."""
    apart = counts * _bytes_of(largest, element_bytes)
    together = (counts + counts[group]) * _bytes_of(np.maximum(largest, largest[group]), element_bytes)
    costs = (together - apart - apart[group]).astype(float)
    costs[counts == 0] = costs[group] = np.inf
    return costs


def _bytes_of(sizes: NDArray[np.int64], element_bytes: Mapping[str, int]) -> NDArray[np.int64]:
    """Bytes `[groups]` of one scenario with these sizes `[groups, axes]`, in the order of `PADDED_AXES`."""
    columns = {name: [PADDED_AXES.index(axis) for axis in axes if axis] for name, axes in AXES.items()}
    return sum(
        (element_bytes[name] * np.prod(sizes[:, columns[name]], axis=1) for name in AXES),
        start=np.zeros(len(sizes), np.int64),
    )
