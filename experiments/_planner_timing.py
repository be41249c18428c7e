"""How long a planning cycle takes, beside the reference's, and how far that is from what the machine can do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

import jaxfrenet as jf
from experiments._machine import Peaks, most_memory
from experiments._measuring import Budget, Program, compile_ahead, measure, work_of
from experiments._planning_cases import Layout, nearness, planning_batch
from experiments._reference import ReferencePlanner, reference_case
from jaxfrenet._typing import Array

MOST_REFERENCE_SCENARIOS = 8
"""The reference plans at most so many scenarios of a batch, evenly chosen, one after the other."""
LEVELS = range(5)
"""Sampling levels: 48, 180, 800, 3,564 and 12,716 trajectories."""
USUAL = {"batch": 64, "obstacles": 5, "level": 2, "layout": "mixed"}
"""What is varied around, as far as it is among what was asked for."""


@dataclass(frozen=True)
class Case:
    """One setting of the planner."""

    layout: Layout
    obstacles: int
    batch: int
    level: int
    """Sampling level."""

    @property
    def config(self) -> jf.PlannerConfig:
        """The planner's configuration."""
        return jf.PlannerConfig(sampling_level=self.level)

    def __str__(self) -> str:
        """For the progress bar."""
        trajectories = self.config.trajectories
        return f"{self.layout}, {self.obstacles} obstacles, {trajectories:,} trajectories, batch {self.batch}"

    def as_plain(self) -> dict[str, Any]:
        """What it is, as JSON can hold it."""
        trajectories = self.config.trajectories
        return {
            "layout": self.layout,
            "obstacles": self.obstacles,
            "batch": self.batch,
            "trajectories": trajectories,
        }


class Slim(NamedTuple):
    """What is asked of a planning cycle: no more, so that nothing else is written."""

    trajectory: jf.EgoState
    mode: Array
    chosen: Array
    cost: Array


def nearest_level(trajectories: int) -> int:
    """The sampling level whose number of trajectories is nearest by ratio."""
    return min(
        LEVELS, key=lambda level: abs(np.log(jf.PlannerConfig(sampling_level=level).trajectories / trajectories))
    )


def star(
    batches: Sequence[int], levels: Sequence[int], obstacles: Sequence[int], layouts: Sequence[Layout]
) -> list[Case]:
    """Cases in which one thing is varied at a time, around `USUAL` or else the first that is given.

    Layouts and obstacles are varied in a batch of 64, trajectories in a single scenario, again if they are given.
    """
    level, usual = _usual("level", levels), _usual("obstacles", obstacles)
    layout, batch = _usual("layout", layouts), _usual("batch", batches)
    single = _single(batches)
    cases = [Case(layout, usual, one, level) for one in batches]
    cases += [Case(one, usual, batch, level) for one in layouts]
    cases += [Case(layout, one, batch, level) for one in obstacles]
    cases += [Case(layout, usual, single, one) for one in levels]
    return list(dict.fromkeys(cases))


def arms(rows: Sequence[dict[str, Any]], cases: Sequence[Case]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The results that differ from the star's first case in their batch only, and those that do in trajectories only.

    Args:
      rows: results of the cases, some of which may be missing.
      cases: of `star`.
    """
    middle = cases[0].as_plain()
    single = _single([case.batch for case in cases])

    def differing(field: str, fixed: dict[str, Any]) -> list[dict[str, Any]]:
        return [row for row in rows if all(row[name] == value for name, value in fixed.items() if name != field)]

    return differing("batch", middle), differing("trajectories", middle | {"batch": single})


def _single(batches: Sequence[int]) -> int:
    return 1 if 1 in batches else batches[0]


def _usual(name: str, given: Sequence[Any]) -> Any:
    return USUAL[name] if USUAL[name] in given else given[0]


def measure_case(case: Case, peaks: Peaks, with_reference: bool, budget: Budget) -> dict[str, Any]:
    """One row of the results.

    A batch of one is planned without a batch axis. Times of a batch are divided by its size, also the 99th percentile.

    Raises:
      DoesNotFit: it takes more memory than there is.
      UserError: the reference is asked for, but not installed.
    """
    config, weights = case.config, jf.CostWeights()
    scenario, state = planning_batch(config, case.layout, case.obstacles, case.batch)
    program = _compile(case, scenario, state, weights)
    references = _references(config, scenario, state, weights) if with_reference else []
    calls = [program.run]
    if references:
        calls += [lambda: [one.serial() for one in references], lambda: [one.concurrent() for one in references]]
    durations = measure(calls, budget)
    near = nearness(config, scenario, state)
    normal = np.mean(np.asarray(program.run().mode) == jf.PlanMode.NORMAL)
    row = case.as_plain() | {"near_share": near.share, "normal_share": float(normal)}
    row |= _times(case, durations[0])
    row |= _reference_times(durations[1:], len(references), row["ms_per_cycle"])
    row |= {"compile_seconds": program.compile_seconds, "compiled_before": program.from_cache}
    return row | _roofline(case, program, float(np.median(durations[0])), peaks)


def _compile(case: Case, scenario: jf.Scenario, state: jf.SimulationState, weights: jf.CostWeights) -> Program:
    plan = partial(_plan, case.config)
    if case.batch == 1:
        return compile_ahead(plan, *_one(0, scenario, state), weights)
    return compile_ahead(jax.vmap(plan, in_axes=(0, 0, None)), scenario, state, weights)


def _plan(config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState, weights: jf.CostWeights) -> Slim:
    cycle = jf.plan(config, scenario, state, weights)
    return Slim(cycle.trajectory, cycle.mode, cycle.chosen, cycle.cost[cycle.chosen])


def _one(index: int, scenario: jf.Scenario, state: jf.SimulationState) -> tuple[jf.Scenario, jf.SimulationState]:
    return jax.tree.map(lambda leaf: leaf[index], (scenario, state))


def _references(
    config: jf.PlannerConfig, scenario: jf.Scenario, state: jf.SimulationState, weights: jf.CostWeights
) -> list[ReferencePlanner]:
    """The reference, ready for some scenarios of a batch."""
    batch = len(state.step)
    chosen = np.linspace(0, batch - 1, min(batch, MOST_REFERENCE_SCENARIOS)).astype(int)
    return [
        ReferencePlanner(config, weights, reference_case(config, *_one(index, scenario, state))) for index in chosen
    ]


def _times(case: Case, durations: NDArray) -> dict[str, Any]:
    seconds = float(np.median(durations)) / case.batch
    return {
        "ms_per_cycle": 1e3 * seconds,
        "p99_ms": 1e3 * float(np.quantile(durations, 0.99)) / case.batch,
        "repeats": len(durations),
        "cycles_per_second": 1.0 / seconds,
        "trajectories_per_second": case.config.trajectories / seconds,
    }


def _reference_times(durations: Sequence[NDArray], scenarios: int, ours_ms: float) -> dict[str, float | None]:
    """Medians per planning cycle, and how many times as long as ours the faster one takes."""
    if not scenarios:
        return {"reference_serial_ms": None, "reference_concurrent_ms": None, "ratio": None}
    serial, concurrent = (1e3 * float(np.median(one)) / scenarios for one in durations)
    ratio = min(serial, concurrent) / ours_ms
    return {"reference_serial_ms": serial, "reference_concurrent_ms": concurrent, "ratio": ratio}


def _roofline(case: Case, program: Program, seconds: float, peaks: Peaks) -> dict[str, float | None]:
    """What one call of a program computes and moves, against what the machine can; see `Work` for what is missing."""
    work = work_of(program)
    flops, moved = (None if one is None else one / seconds for one in (work.flops, work.bytes))
    return {
        "megabytes_per_scenario": None if work.memory is None else work.memory / case.batch / 1e6,
        "process_megabytes": most_memory(),
        "flops_per_cycle": None if work.flops is None else work.flops / case.batch,
        "bytes_per_cycle": None if work.bytes is None else work.bytes / case.batch,
        "flops_per_byte": None if work.flops is None or work.bytes is None else work.flops / work.bytes,
        "flops_per_second": flops,
        "bytes_per_second": moved,
        "share_of_peak_flops": None if flops is None else flops / peaks.flops_per_second,
        "share_of_peak_bytes": None if moved is None else moved / peaks.bytes_per_second,
    }
