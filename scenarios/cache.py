"""Imported folders and archives are kept, because reading CommonRoad files takes about 0.1 s each."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from hashlib import blake2b
from pathlib import Path

from scenarios.collection import ScenarioSet, load_set, scenario_files
from scenarios.commonroad import IMPORTER_VERSION
from scenarios.errors import ScenarioError
from scenarios.storage import VERSION, load_npz, save_npz


def load_cached(
    paths: Sequence[str | Path],
    planning_problem: int | None = None,
    cache: str | Path | None = None,
    progress: bool | Callable[[int, int], None] = False,
) -> ScenarioSet:
    """Like `load_set`, but what was imported before is read from a cache.

    The cache knows files by their names and content, so changed ones are imported anew. Its files may be deleted at
    any time; a broken one is replaced, and where none can be written there is no cache. A single `.xml` file and
    `.npz` sets alone are always read themselves.

    Args:
      paths: as for `load_set`.
      planning_problem: id of the planning problem, by default the first in each file.
      cache: folder of the cache, by default `jaxfrenet/scenarios` in the user's cache folder.
      progress: as for `load_set`; not called for what is in the cache.

    Raises:
      ScenarioError: as `load_set`.
    """
    paths = [Path(path) for path in paths]
    if all(path.suffix == ".npz" for path in paths) or (len(paths) == 1 and paths[0].suffix == ".xml"):
        return load_set(paths, planning_problem, progress)
    try:
        key = _key(paths, planning_problem)
    except OSError:  # load_set says which file is missing or cannot be read, or leaves it out
        return load_set(paths, planning_problem, progress)
    file = (user_cache() if cache is None else Path(cache)) / f"{key}.npz"
    try:
        return load_npz(file)
    except ScenarioError:
        found = load_set(paths, planning_problem, progress)
    with contextlib.suppress(OSError):  # where nothing can be written, the next import takes as long as this one
        save_npz(file, found)
    return found


def user_cache() -> Path:
    """The folder in which imported scenarios are kept by default."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxfrenet" / "scenarios"


def _key(paths: Sequence[Path], planning_problem: int | None) -> str:
    """A hash of all that the imported scenarios depend on."""
    digest = blake2b(repr((VERSION, IMPORTER_VERSION, planning_problem)).encode(), digest_size=16)
    for path in paths:
        for name, read in scenario_files(path) if path.is_dir() else [(str(path), path.read_bytes)]:
            data = read()
            digest.update(os.fsencode(name) + f"\0{len(data)}\0".encode() + data)
    return digest.hexdigest()
