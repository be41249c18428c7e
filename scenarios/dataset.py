"""Scenarios to train and to measure on, whatever their source: divided into parts, and as batches."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import jaxfrenet as jf
from scenarios.batching import stack
from scenarios.buckets import Bucket, make_buckets
from scenarios.cache import load_cached
from scenarios.collection import ScenarioSet
from scenarios.errors import ScenarioError
from scenarios.families import Draw, generate
from scenarios.sharing import share_equal


@dataclass(frozen=True)
class Dataset(ScenarioSet):
    """A set of scenarios, from files or generated, in which equal arrays are in memory once."""

    @classmethod
    def from_paths(
        cls,
        paths: Sequence[str | Path],
        planning_problem: int | None = None,
        cache: str | Path | None = None,
        progress: bool | Callable[[int, int], None] = False,
    ) -> Dataset:
        """Scenarios of CommonRoad files, folders or archives of them, and `.npz` sets; see `load_cached`.

        Raises:
          ScenarioError: a path is missing, holds no scenario, or no file at all can be used.
        """
        found = load_cached(paths, planning_problem, cache, progress)
        return cls(found.scenarios, found.infos, found.skipped)

    @classmethod
    def from_set(cls, found: ScenarioSet) -> Dataset:
        """Scenarios that were loaded or generated before."""
        return cls(share_equal(found.scenarios), found.infos, found.skipped)

    @classmethod
    def from_generator(cls, draw: Draw) -> Dataset:
        """Generated scenarios; see `scenarios.families`.

        Raises:
          ScenarioError: there is nothing to draw, see `Draw.checked`.
        """
        return cls.from_set(generate(draw))

    def split(self, seed: int = 0, shares: Sequence[float] = (0.75, 0.15, 0.10)) -> Splits:
        """Divide at random into training, validation and test.

        The part of a scenario depends on `seed`, `shares` and its benchmark id alone: it stays the same when others
        are added, left out or reordered, and copies of a file or its other planning problems are in the same part.
        So the parts' sizes have the given shares only roughly, and may be 0 in small sets.

        Args:
          seed: any number; another one gives another division.
          shares: of training, validation and test, about; positive, with sum 1.

        Returns:
          The parts, each in the order of this set; skipped files belong to none.

        Raises:
          ScenarioError: the shares are not three positive numbers with sum 1.
        """
        if len(shares) != 3 or not all(share > 0.0 for share in shares) or not math.isclose(sum(shares), 1.0):
            raise ScenarioError(f"shares are {shares}; give three positive numbers with sum 1")
        bounds = list(accumulate(shares))[:-1]
        parts: tuple[list[int], ...] = ([], [], [])
        for index, info in enumerate(self.infos):
            place = _place(seed, info.benchmark_id)
            parts[sum(place >= bound for bound in bounds)].append(index)
        return Splits(*(self.part(indices) for indices in parts))

    def part(self, indices: Sequence[int]) -> Dataset:
        """The scenarios at some places, in that order."""
        return Dataset(tuple(self.scenarios[index] for index in indices), tuple(self.infos[index] for index in indices))

    def stacked(self, pad: Mapping[str, int] | None = None) -> jf.Scenario:
        """All scenarios as one batch, padded to the largest sizes among them, or larger ones; see `stack`.

        Raises:
          ScenarioError: there is no scenario, or `pad` is too small for one of them.
        """
        return stack(self.scenarios, pad)

    def buckets(self, max_waste: float = 0.25) -> tuple[Bucket, ...]:
        """All scenarios as few batches of like sizes, so that little is padded; see `make_buckets`.

        Raises:
          ScenarioError: there is no scenario, or `max_waste` is negative or not finite.
        """
        return make_buckets(self.scenarios, max_waste)


class Splits(NamedTuple):
    """The parts of a dataset; no scenario is in two of them."""

    train: Dataset
    validation: Dataset
    test: Dataset


def _place(seed: int, benchmark_id: str) -> float:
    """A number in [0, 1) that looks random and always is the same for these two."""
    digest = blake2b(f"{seed}/{benchmark_id}".encode(), digest_size=6).digest()
    return int.from_bytes(digest, "big") / 2.0**48
