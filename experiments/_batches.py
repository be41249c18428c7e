"""Scenarios in batches, driven by as few compiled programs as possible."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax

import jaxfrenet as jf
import scenarios
from experiments._planners import Planner
from scenarios.batching import rounded_up


@dataclass(frozen=True)
class Batch:
    """Scenarios that one run of a program drives."""

    indices: tuple[int, ...]
    """Which scenarios of the set these are."""
    scenario: jf.Scenario
    """All of them, with a leading batch axis; the last may be repeated to fill the batch."""
    max_steps: int
    """Steps after which every episode has ended."""


def make_batches(found: Sequence[jf.Scenario], size: int) -> list[Batch]:
    """Sort scenarios by their number of obstacles, which work grows with, and cut them into batches of one length.

    All other array sizes are common to the whole set. Sizes are rounded up and the last batch is filled up, so that
    batches with alike traffic share a program, and another run over the family finds it compiled.

    Args:
      found: at least one scenario, without a batch axis.
      size: most scenarios in a batch.
    """
    every = [scenarios.sizes_of(scenario) | {"max_steps": jf.max_steps(scenario)} for scenario in found]
    common = {axis: rounded_up(max(sizes[axis] for sizes in every)) for axis in every[0]}
    max_steps = common.pop("max_steps")
    order = sorted(range(len(found)), key=lambda index: every[index]["obstacles"])
    rows = math.ceil(len(order) / math.ceil(len(order) / size))
    batches = []
    for first in range(0, len(order), rows):
        indices = order[first : first + rows]
        obstacles = rounded_up(every[indices[-1]]["obstacles"])
        filled = indices + indices[-1:] * (rows - len(indices))
        stacked = scenarios.stack([found[index] for index in filled], common | {"obstacles": obstacles})
        batches.append(Batch(tuple(indices), stacked, max_steps))
    return batches


@dataclass
class BatchDriver:
    """Drives batches and keeps account of the time."""

    planner: Planner
    seconds: float = 0.0
    """Time [s] that driving took so far."""
    compile_seconds: float = 0.0
    """Time [s] that compiling, or reading what an earlier run compiled, took so far."""
    _programs: dict[tuple, Callable[..., jf.Episode]] = field(default_factory=dict)

    def drive(self, batch: Batch, parameters: Any = None) -> dict[int, jf.Episode]:
        """Drive a batch to its end; the episodes, as NumPy arrays, by the scenarios' indices.

        Args:
          batch: of scenarios.
          parameters: in place of the planner's own.
        """
        program = self._program(batch)
        start = time.perf_counter()
        parameters = self.planner.parameters if parameters is None else parameters
        episodes = jax.device_get(program(parameters, batch.scenario))
        self.seconds += time.perf_counter() - start
        rows = [jax.tree.map(lambda leaf, row=row: leaf[row], episodes) for row in range(len(batch.indices))]
        return dict(zip(batch.indices, rows, strict=True))

    def _program(self, batch: Batch) -> Callable[..., jf.Episode]:
        shapes = tuple(leaf.shape for leaf in jax.tree.leaves(batch.scenario))
        key = (batch.max_steps, shapes)
        if key not in self._programs:
            start = time.perf_counter()
            self._programs[key] = self._compile(batch)
            self.compile_seconds += time.perf_counter() - start
        return self._programs[key]

    def _compile(self, batch: Batch) -> Callable[..., jf.Episode]:
        def drive_all(parameters: Any, scenario: jf.Scenario) -> jf.Episode:
            return jax.vmap(lambda one: self.planner.roll_out(parameters, one, batch.max_steps))(scenario)

        return jax.jit(drive_all).lower(self.planner.parameters, batch.scenario).compile()
