"""Arrays that are equal are kept once: many scenarios on one map hold one copy of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

import jaxfrenet as jf
from scenarios.batching import device_array

Identity = tuple[tuple[int, ...], str, bytes]
"""Shape, dtype and bytes."""


def identity(array: np.ndarray | np.generic | jax.Array) -> Identity:
    """What two arrays have in common exactly if one can stand for the other."""
    values = np.asarray(array)
    return values.shape, values.dtype.str, values.tobytes()


def distinct(arrays: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[int]]:
    """The different ones among arrays, in order of their first appearance, and for each array which of them it is."""
    identities = [identity(array) for array in arrays]
    first = dict(zip(identities, arrays, strict=True))
    places = {one: place for place, one in enumerate(first)}
    return list(first.values()), [places[one] for one in identities]


def share_equal(scenarios: Sequence[jf.Scenario]) -> tuple[jf.Scenario, ...]:
    """The same scenarios on the default device; leaves of equal shape, dtype and bytes are one and the same array."""
    known: dict[tuple[Any, Identity], jax.Array] = {}

    def shared(path: Any, leaf: np.ndarray | np.generic | jax.Array) -> jax.Array:
        key = path, identity(leaf)
        if key not in known:
            known[key] = device_array(leaf)
        return known[key]

    return tuple(jax.tree_util.tree_map_with_path(shared, scenario) for scenario in scenarios)
