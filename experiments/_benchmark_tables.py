"""Tables of the benchmark's results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple


class Column(NamedTuple):
    """How one field of the results is shown."""

    title: str
    field: str
    show: Callable[[Any], str]


def _digits(count: int, factor: float = 1.0) -> Callable[[Any], str]:
    return lambda value: f"{factor * value:,.{count}f}"


_whole = "{:,}".format
COMPILE = Column("compile [s]", "compile_seconds", _digits(1))
COLUMNS: dict[str, tuple[Column, ...]] = {
    "planner": (
        Column("layout", "layout", str),
        Column("obstacles", "obstacles", _whole),
        Column("batch", "batch", _whole),
        Column("trajectories", "trajectories", _whole),
        Column("near", "near_share", _digits(0, 100.0)),
        Column("ms/cycle", "ms_per_cycle", _digits(3)),
        Column("p99", "p99_ms", _digits(3)),
        Column("serial", "reference_serial_ms", _digits(1)),
        Column("concurrent", "reference_concurrent_ms", _digits(1)),
        Column("ratio", "ratio", _digits(1)),
        Column("cycles/s", "cycles_per_second", _digits(0)),
        Column("traj./s", "trajectories_per_second", _digits(0)),
        Column("MB/scen.", "megabytes_per_scenario", _digits(2)),
        Column("flops/B", "flops_per_byte", _digits(2)),
        Column("% flops", "share_of_peak_flops", _digits(1, 100.0)),
        Column("% bytes", "share_of_peak_bytes", _digits(1, 100.0)),
        COMPILE,
    ),
    "episode": (
        Column("preset", "preset", str),
        Column("batch", "batch", _whole),
        Column("episodes", "episodes", _whole),
        Column("steps", "steps", _whole),
        Column("steps/s", "steps_per_second", _digits(0)),
        COMPILE,
    ),
    "environment": (
        Column("preset", "preset", str),
        Column("batch", "batch", _whole),
        Column("steps", "steps", _whole),
        Column("steps/s", "steps_per_second", _digits(0)),
        COMPILE,
    ),
    "training": (
        Column("preset", "preset", str),
        Column("environments", "environments", _whole),
        Column("rollout", "rollout_steps", _whole),
        Column("parameters", "parameters", _whole),
        Column("steps/s", "steps_per_second", _digits(0)),
        Column("h/1M steps", "hours_per_million_steps", _digits(2)),
        COMPILE,
    ),
    "predictor": (
        Column("predictor", "predictor", str),
        Column("of", "what", str),
        Column("batch", "batch", _whole),
        Column("obstacles", "obstacles", _whole),
        Column("steps", "steps", _whole),
        Column("ms/scenario", "ms_per_scenario", _digits(3)),
        Column("p99", "p99_ms", _digits(3)),
        COMPILE,
    ),
}
NOTES = {
    "planner": (
        "times are for one planning cycle; near: triples of trajectory, obstacle and step within 7 m [%];",
        "serial, concurrent: the reference's times [ms]; ratio: the shorter of these over ours;",
        "% flops, % bytes: of the machine's peaks, as XLA counts them, which takes a loop's body for one run",
    )
}


def print_rows(part: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print a part's results on stdout, a line for each, without columns in which there is nothing."""
    if not rows:
        return
    columns = [column for column in COLUMNS[part] if any(row[column.field] is not None for row in rows)]
    cells = [[column.title for column in columns]]
    cells += [["-" if row[one.field] is None else one.show(row[one.field]) for one in columns] for row in rows]
    widths = [max(len(line[index]) for line in cells) for index in range(len(columns))]
    print(part)
    for line in cells:
        print("  " + "  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))
    for note in NOTES.get(part, ()):
        print(f"  {note}")
