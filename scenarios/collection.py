"""Sets of scenarios from files, folders and archives."""

from __future__ import annotations

import sys
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from lzma import LZMAError
from pathlib import Path
from typing import NamedTuple

import jaxfrenet as jf
from scenarios.commonroad import ScenarioInfo, from_bytes, load_with_info
from scenarios.errors import ScenarioError
from scenarios.sharing import share_equal

ARCHIVES = (".tar.xz", ".tar.gz", ".tgz", ".zip")
BROKEN_ARCHIVE = (tarfile.TarError, zipfile.BadZipFile, LZMAError, zlib.error, EOFError, OSError, RuntimeError)


class Skipped(NamedTuple):
    """A file that could not be used."""

    file: str
    reason: str


@dataclass(frozen=True)
class ScenarioSet:
    """Scenarios, what identifies each, and the files that were left out."""

    scenarios: tuple[jf.Scenario, ...]
    infos: tuple[ScenarioInfo, ...]
    skipped: tuple[Skipped, ...] = ()

    def __len__(self) -> int:
        """Number of scenarios."""
        return len(self.scenarios)


class ScenarioFile(NamedTuple):
    """One CommonRoad file, wherever it lies."""

    name: str
    read: Callable[[], bytes]


def load_set(
    paths: Sequence[str | Path],
    planning_problem: int | None = None,
    progress: bool | Callable[[int, int], None] = False,
) -> ScenarioSet:
    """Read all scenarios of CommonRoad files, folders or archives of them, and our own `.npz` sets.

    Files that cannot be used are skipped and listed, unless the only thing asked for is one such file.

    Args:
      paths: `.xml` files, folders (every `.xml` below), `.tar.xz`, `.tar.gz`, `.tgz` or `.zip` archives, `.npz` sets.
      planning_problem: id of the planning problem, by default the first in each file.
      progress: called with the number of files done and of all files; True writes them to stderr.

    Raises:
      ScenarioError: a path is missing, a folder or archive holds no scenario, or no file at all can be used.
    """
    if not paths:
        raise ScenarioError("no scenario given; name CommonRoad files, folders, archives or .npz sets")
    kept = [_load_kept(Path(path)) for path in paths if str(path).endswith(".npz")]
    sources = [source for path in paths if not str(path).endswith(".npz") for source in scenario_files(Path(path))]
    if len(sources) == 1 and not kept and str(paths[0]).endswith(".xml"):
        scenario, info = load_with_info(paths[0], planning_problem)
        return ScenarioSet((scenario,), (info,))
    read = _load_sources(sources, planning_problem, _reporter(progress))
    sets = [*kept, read]
    merged = ScenarioSet(
        share_equal([scenario for one in sets for scenario in one.scenarios]),
        tuple(info for one in sets for info in one.infos),
        tuple(skipped for one in sets for skipped in one.skipped),
    )
    if not len(merged):
        first = f", the first because {merged.skipped[0].reason}" if merged.skipped else ""
        raise ScenarioError(f"none of {len(merged.skipped)} scenarios can be used{first}; give others")
    return merged


def _load_kept(path: Path) -> ScenarioSet:
    from scenarios.storage import load_npz

    return load_npz(path)


def _load_sources(
    sources: list[ScenarioFile], planning_problem: int | None, report: Callable[[int, int], None]
) -> ScenarioSet:
    loaded, skipped = [], []
    for count, source in enumerate(sources):
        report(count, len(sources))
        try:
            loaded.append(from_bytes(source.read(), source.name, planning_problem))
        except ScenarioError as error:
            skipped.append(Skipped(source.name, str(error).removeprefix(f"{source.name}: ")))
        except BROKEN_ARCHIVE as error:
            skipped.append(Skipped(source.name, f"cannot be read ({_short(error)}); get it again"))
    report(len(sources), len(sources))
    return ScenarioSet(tuple(one for one, _ in loaded), tuple(info for _, info in loaded), tuple(skipped))


def _reporter(progress: bool | Callable[[int, int], None]) -> Callable[[int, int], None]:
    def write(done: int, total: int) -> None:
        sys.stderr.write(f"\rimporting scenarios: {done}/{total}" + ("\n" if done == total else ""))
        sys.stderr.flush()

    if callable(progress):
        return progress
    return write if progress else lambda done, total: None


def scenario_files(path: Path) -> list[ScenarioFile]:
    """The CommonRoad files that a path stands for, by name: itself, or those in a folder or archive.

    Raises:
      ScenarioError: the path is missing, holds no CommonRoad file, or is not a complete archive.
    """
    if not path.exists():
        raise ScenarioError(f"{path}: no such file or folder; check the path")
    if path.is_dir():
        found = [ScenarioFile(str(file), file.read_bytes) for file in sorted(path.rglob("*.xml")) if file.is_file()]
    elif path.name.endswith(ARCHIVES):
        found = sorted(_members(path))
    elif path.suffix == ".xml":
        return [ScenarioFile(str(path), path.read_bytes)]
    else:
        raise ScenarioError(
            f"{path}: neither a folder nor one of .xml, .npz, {', '.join(ARCHIVES)}; rename or convert it"
        )
    if not found:
        raise ScenarioError(f"{path}: holds no CommonRoad file (*.xml); give a folder or archive that does")
    return found


def _members(path: Path) -> Iterator[ScenarioFile]:
    """The `.xml` members of an archive, read into memory."""
    if not path.stat().st_size:
        raise ScenarioError(f"{path}: archive is empty (0 bytes); get it again")
    try:
        for name, data in _zip_members(path) if path.suffix == ".zip" else _tar_members(path):
            if name.endswith(".xml") and not Path(name).name.startswith("."):
                yield ScenarioFile(f"{path}/{name}", lambda data=data: data)
    except BROKEN_ARCHIVE as error:
        raise ScenarioError(f"{path}: not a complete archive ({_short(error)}); get it again") from None


def _zip_members(path: Path) -> Iterator[tuple[str, bytes]]:
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if not name.endswith("/"):
                yield name, archive.read(name)


def _tar_members(path: Path) -> Iterator[tuple[str, bytes]]:
    with tarfile.open(path) as archive:
        for member in archive:
            file = archive.extractfile(member) if member.isfile() else None
            if file is not None:
                yield member.name, file.read()


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
