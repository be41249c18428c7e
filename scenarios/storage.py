"""A set of scenarios in one `.npz` file, read with nothing but numpy and jax.

Per leaf the file holds one array with the different values end to end, one with their shapes, and one that says which
of them each scenario has: what many scenarios share is kept once. A JSON header keeps the version of the format, what
identifies each scenario, and the skipped files. Nothing is pickled.
"""

from __future__ import annotations

import dataclasses
import json
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from scenarios.batching import AXES, device_array, leaves_of, scenario_of
from scenarios.collection import ScenarioSet, Skipped
from scenarios.commonroad import ScenarioInfo
from scenarios.errors import ScenarioError
from scenarios.files import written_whole
from scenarios.sharing import distinct

FORMAT = "jaxfrenet scenarios"
VERSION = 3
BROKEN = (
    *(zipfile.BadZipFile, zlib.error, tokenize.TokenError, EOFError, OSError, MemoryError, RuntimeError),
    *(ValueError, KeyError, TypeError, IndexError, SyntaxError),
)
"""What damaged files end in, in zipfile, numpy or here."""


def save_npz(path: str | Path, scenarios: ScenarioSet) -> None:
    """Write a set of scenarios; an existing file is replaced as a whole, or kept if writing fails.

    Raises:
      ScenarioError: the set is empty.
    """
    if not len(scenarios):
        raise ScenarioError(f"{path}: no scenario to write; give a set with at least one")
    every = [leaves_of(scenario) for scenario in scenarios.scenarios]
    header = {
        "format": FORMAT,
        "version": VERSION,
        "infos": [dataclasses.asdict(info) for info in scenarios.infos],
        "skipped": [list(skipped) for skipped in scenarios.skipped],
    }
    arrays: dict[str, Any] = {"header": np.frombuffer(json.dumps(header).encode(), np.uint8)}
    for name in AXES:
        different, index = distinct([leaves[name] for leaves in every])
        arrays[f"{name}/shapes"] = np.array([leaf.shape for leaf in different], np.int64)
        arrays[f"{name}/values"] = np.concatenate([leaf.ravel() for leaf in different])
        arrays[f"{name}/index"] = np.array(index, np.int32)
    with written_whole(path) as file:
        np.savez_compressed(file, **arrays)


def load_npz(path: str | Path) -> ScenarioSet:
    """Read a set that `save_npz` has written; leaves that are equal in several scenarios are one and the same array.

    Raises:
      ScenarioError: the file is missing, truncated, no such set, or of another version of the format.
    """
    if not Path(path).is_file():
        raise ScenarioError(f"{path}: no such file; check the path")
    try:
        with np.load(path, allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes())
            if header["format"] != FORMAT:
                raise KeyError(header["format"])
            if header["version"] != VERSION:
                raise ScenarioError(
                    f"{path}: format version {header['version']}, this release reads {VERSION}; save the set again"
                )
            count = len(header["infos"])
            tables = {name: _column(archive, name, count) for name in AXES}
            infos = tuple(ScenarioInfo(**info) for info in header["infos"])
            skipped = tuple(Skipped(*entry) for entry in header["skipped"])
    except ScenarioError:
        raise
    except BROKEN:
        raise ScenarioError(f"{path}: not a complete set of scenarios; save it again with scenarios.save_npz") from None
    return ScenarioSet(
        tuple(scenario_of({name: table[index] for name, table in tables.items()}) for index in range(len(infos))),
        infos,
        skipped,
    )


def _column(archive: Mapping[str, np.ndarray], name: str, count: int) -> list[jax.Array]:
    """A leaf of every scenario."""
    different = [device_array(part) for part in _split(archive[f"{name}/values"], archive[f"{name}/shapes"])]
    index = archive[f"{name}/index"]
    if len(index) != count:
        raise ValueError("numbers of scenarios differ")
    return [different[place] for place in index]


def _split(values: np.ndarray, shapes: np.ndarray) -> list[np.ndarray]:
    """Cut an array that holds several end to end."""
    sizes = np.prod(shapes, axis=1, dtype=np.int64)
    if np.sum(sizes) != len(values):
        raise ValueError("sizes and values differ")
    parts = np.split(values, np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
