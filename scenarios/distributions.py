"""Random numbers from distributions that are written as knots of their quantile function."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._typing import Array
from scenarios.errors import ScenarioError

Knots = tuple[float | int, ...]
"""Values at evenly spaced probabilities 0 … 1, linear in between: one is a constant, two a uniform distribution."""


class Dice:
    """Random numbers of one key, thrown all at once and taken one after the other: little to compile.

    Whoever traces the same program takes the same numbers, so functions that take from dice remain pure.
    """

    def __init__(self, key: Array, count: int) -> None:
        """Throw `count` numbers."""
        self._left = jax.random.uniform(key, (count,))

    def uniform(self, shape: tuple[int, ...] = ()) -> Array:
        """The next numbers in [0, 1)."""
        size = math.prod(shape)
        if size > len(self._left):
            raise ValueError(f"no {size} numbers left of these dice; throw more")
        taken, self._left = self._left[:size], self._left[size:]
        return taken.reshape(shape)

    def draw(self, knots: Knots, shape: tuple[int, ...] = ()) -> Array:
        """The next values from the distribution with these knots."""
        return quantile(self.uniform(shape), knots)

    def choose(self, shares: Sequence[float], shape: tuple[int, ...] = ()) -> Array:
        """The next indices, int32, with probabilities in proportion to `shares`."""
        bounds = np.cumsum(np.asarray(shares, np.float64))
        bounds = jnp.asarray(bounds[:-1] / bounds[-1], jnp.float32)
        return jnp.sum(self.uniform(shape)[..., None] >= bounds, axis=-1, dtype=jnp.int32)

    def normal(self, shape: tuple[int, ...] = ()) -> Array:
        """The next standard normal values."""
        return jax.scipy.special.ndtri(jnp.clip(self.uniform(shape), 1e-6, 1.0 - 1e-6))


def quantile(probability: Array, knots: Knots) -> Array:
    """The quantile function with these knots, at probabilities in [0, 1] of any shape."""
    values = jnp.asarray(knots, jnp.float32)
    if len(knots) == 1:
        return jnp.full(probability.shape, values[0])
    position = probability * (len(knots) - 1)
    before = jnp.clip(position.astype(jnp.int32), 0, len(knots) - 2)
    return values[before] + (position - before.astype(jnp.float32)) * (values[before + 1] - values[before])


def check_knots(name: str, knots: object, low: float | int, high: float | int) -> None:
    """Refuse knots that are no distribution within `low` … `high`.

    Raises:
      ScenarioError: there is none, they decrease, or one is out of range or not finite.
    """
    wanted = f"give one or more non-decreasing numbers within {low:g} … {high:g}"
    if not isinstance(knots, tuple) or not knots:
        raise ScenarioError(f"{name} is {knots!r}: {wanted}")
    for value in knots:
        if not isinstance(value, int | float) or not math.isfinite(value) or not low <= value <= high:
            raise ScenarioError(f"{name} has the value {value!r}: {wanted}")
    if any(after < before for before, after in zip(knots, knots[1:], strict=False)):
        raise ScenarioError(f"{name} is {knots!r}, which decreases: {wanted}")


def check_shares(name: str, shares: tuple[float | int, ...], titles: str) -> None:
    """Refuse shares that are no distribution over three things.

    Raises:
      ScenarioError: there are not three, one is negative, or all are 0.
    """
    if len(shares) != 3 or not min(shares) >= 0.0 or not 0.0 < sum(shares) < math.inf:
        raise ScenarioError(f"{name} is {shares}: give three shares ≥ 0, of {titles}")


def check_number(name: str, value: object, low: float | int, high: float | int) -> None:
    """Refuse a number outside `low` … `high`.

    Raises:
      ScenarioError: it is.
    """
    if not isinstance(value, int | float) or not low <= value <= high:
        raise ScenarioError(f"{name} is {value!r}: give a number within {low:g} … {high:g}")
