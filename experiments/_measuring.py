"""Programs compiled ahead of time, what XLA says of them, and how long they take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.stages import Compiled
from numpy.typing import NDArray

MOST_CALLS, LEAST_ROUNDS = 10, 3
"""Calls of one program in a round; rounds where their number is not given."""
CACHE_HIT = "/jax/compilation_cache/cache_hits"


class DoesNotFit(Exception):
    """A program needs more memory than there is; the message says how much."""


@dataclass(frozen=True)
class Budget:
    """How long to measure."""

    seconds: float
    """Measure for at least so long [s], and at least `LEAST_ROUNDS` rounds."""
    repeats: int | None = None
    """Measure exactly so many rounds instead."""


@dataclass(frozen=True)
class Program:
    """A compiled program with its arguments."""

    compiled: Compiled
    arguments: tuple[Any, ...]
    compile_seconds: float
    """s, of tracing and compiling, or of reading what an earlier run compiled."""
    from_cache: bool
    """Whether an earlier run had compiled it."""

    def run(self) -> Any:
        """Call it and wait for what it returns."""
        return jax.block_until_ready(self.compiled(*self.arguments))


class Work(NamedTuple):
    """What XLA says of one call; None where it says nothing.

    Its cost analysis counts the body of a loop once, however often it runs, and says nothing about foreign calls: a
    program with loops does more than this.
    """

    flops: float | None
    """Floating-point operations."""
    bytes: float | None
    """Bytes read and written."""
    memory: float | None
    """Bytes that arguments, results and intermediate values take."""


def compile_ahead(function: Callable[..., Any], *arguments: Any) -> Program:
    """Compile a function for some arguments; traced anew each time.

    Raises:
      DoesNotFit: running it would take more memory than is free.
    """
    hits = _count_cache_hits()
    before, start = hits.count, time.perf_counter()
    compiled = jax.jit(function).lower(*arguments).compile()
    program = Program(compiled, arguments, time.perf_counter() - start, hits.count > before)
    needed, free = fresh_bytes(compiled), free_memory()
    if needed is not None and free is not None and needed > free:
        raise DoesNotFit(f"needs {needed / 1e6:,.0f} MB more, {free / 1e6:,.0f} MB are free")
    return program


def measure(calls: Sequence[Callable[[], Any]], budget: Budget) -> list[NDArray[np.float64]]:
    """Durations [s] of the calls, one array for each.

    All are called in turn, so that they share whatever else happens on the machine; in each round quick ones are called
    up to `MOST_CALLS` times. The first two calls of each are not counted.
    """
    warm = [min(_duration(call), _duration(call)) for call in calls]
    times = [int(np.clip(max(warm) / max(own, 1e-9), 1, MOST_CALLS)) for own in warm]
    found: list[list[float]] = [[] for _ in calls]
    start, rounds = time.perf_counter(), 0
    while not _enough(budget, rounds, time.perf_counter() - start):
        for call, count, durations in zip(calls, times, found, strict=True):
            durations += [_duration(call) for _ in range(count)]
        rounds += 1
    return [np.array(durations) for durations in found]


def _enough(budget: Budget, rounds: int, elapsed: float) -> bool:
    if budget.repeats is not None:
        return rounds >= budget.repeats
    return rounds >= LEAST_ROUNDS and elapsed >= budget.seconds


def _duration(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def work_of(program: Program) -> Work:
    """XLA's account of a program."""
    costs: Any = program.compiled.cost_analysis()
    if isinstance(costs, list | tuple):
        costs = costs[0] if costs else None
    costs = costs or {}
    memory = program.compiled.memory_analysis()
    sizes = None if memory is None else fresh_bytes(program.compiled)
    total = None if memory is None or sizes is None else float(sizes + memory.argument_size_in_bytes)
    return Work(_positive(costs.get("flops")), _positive(costs.get("bytes accessed")), total)


def _positive(value: float | None) -> float | None:
    return float(value) if value is not None and value > 0 else None


def fresh_bytes(compiled: Compiled) -> int | None:
    """Bytes that a call needs beside its arguments."""
    memory = compiled.memory_analysis()
    return None if memory is None else memory.temp_size_in_bytes + memory.output_size_in_bytes


@contextmanager
def memory_watched() -> Iterator[None]:
    """Turns JAX's error of a device that is out of memory into `DoesNotFit`."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise DoesNotFit(str(error).splitlines()[0]) from None


def free_memory() -> int | None:
    """Bytes that the device, or without one of its own the machine, has to spare; None where nobody knows."""
    stats = jax.devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return stats["bytes_limit"] - stats.get("bytes_in_use", 0)
    return min((found for found in (_free_in_machine(), _free_in_container()) if found is not None), default=None)


def _free_in_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), None)


def _free_in_container() -> int | None:
    group = Path("/sys/fs/cgroup")
    try:
        return int((group / "memory.max").read_text()) - int((group / "memory.current").read_text())
    except (OSError, ValueError):  # no limit reads "max"
        return None


@dataclass
class _Hits:
    count: int = 0


@cache
def _count_cache_hits() -> _Hits:
    """Counts programs that were found compiled, from the first call on."""
    hits = _Hits()

    def listen(event: str, **_: Any) -> None:
        hits.count += event == CACHE_HIT

    jax.monitoring.register_event_listener(listen)
    return hits
