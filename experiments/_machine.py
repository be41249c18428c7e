"""The machine that a benchmark runs on: its names, and how fast it computes and moves data at best."""

from __future__ import annotations

import os
import platform
import resource
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxfrenet._typing import Array

ROUNDS = 8
MATRIX = {"cpu": 2048, "gpu": 8192}
"""Rows of the square matrices whose product tells the peak of computing."""
NUMBERS = {"cpu": 1 << 26, "gpu": 1 << 28}
"""Numbers in the array whose change tells the peak of moving data; far more than caches hold."""


class Peaks(NamedTuple):
    """The best that programs reach, measured."""

    flops_per_second: float
    """Floating-point operations in float32, in a product of matrices."""
    bytes_per_second: float
    """Bytes read and written, in a sum with a large array."""


def measure_peaks() -> Peaks:
    """Time a product of matrices and the change of a large array, and take the best of some rounds."""
    kind = "cpu" if jax.default_backend() == "cpu" else "gpu"
    rows, numbers = MATRIX[kind], NUMBERS[kind]
    product = jax.jit(lambda matrix: jnp.matmul(matrix, matrix, precision=jax.lax.Precision.HIGHEST))
    identity = jnp.eye(rows, dtype=jnp.float32)
    change = jax.jit(lambda values: values + 1.0, donate_argnums=0)  # without donation, fresh memory is what takes time
    values = jnp.zeros(numbers, jnp.float32)
    return Peaks(2.0 * rows**3 / _best(product, identity), 8.0 * numbers / _best(change, values))


def _best(function: Any, value: Array) -> float:
    """Shortest duration [s] of a function that is applied to its own results."""
    value = jax.block_until_ready(function(value))
    durations = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        value = jax.block_until_ready(function(value))
        durations.append(time.perf_counter() - start)
    return min(durations)


def describe_machine(peaks: Peaks | None) -> dict[str, Any]:
    """Names, versions and peaks, as JSON can hold them."""
    device = jax.devices()[0]
    return {
        "cpu": _cpu_name(),
        "cores": _cores(),
        "platform": device.platform,
        "device": device.device_kind,
        "system": platform.platform(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": version("jaxlib"),
        "peak_flops_per_second": None if peaks is None else peaks.flops_per_second,
        "peak_bytes_per_second": None if peaks is None else peaks.bytes_per_second,
    }


def most_memory() -> float:
    """MB, the most main memory that this process has had."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
