"""Sets of scenarios from folders and archives, and kept in one file."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile

import jax
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios.batching import leaves_of
from scenarios.files import written_whole


@pytest.fixture(scope="module")
def both(t_junction_file) -> scenarios.ScenarioSet:
    return scenarios.load_set(scenarios.builtin_paths())


def assert_same(one: scenarios.ScenarioSet, other: scenarios.ScenarioSet) -> None:
    assert one.infos == other.infos and one.skipped == other.skipped and len(one) == len(other)
    for first, second in zip(one.scenarios, other.scenarios, strict=True):
        for name, leaf in leaves_of(first).items():
            np.testing.assert_array_equal(leaf, leaves_of(second)[name])


def test_folder_and_archives_hold_the_same(tmp_path, both):
    (tmp_path / "folder" / "deeper").mkdir(parents=True)
    with tarfile.open(tmp_path / "set.tar.xz", "w:xz") as tar, zipfile.ZipFile(tmp_path / "set.zip", "w") as zipped:
        for path in reversed(scenarios.builtin_paths()):
            (tmp_path / "folder" / "deeper" / path.name).write_bytes(path.read_bytes())
            tar.add(path, arcname=f"set/{path.name}")
            zipped.write(path, arcname=f"set/{path.name}")
    for source in ("folder", "set.tar.xz", "set.zip"):
        assert_same(scenarios.load_set([tmp_path / source]), both)


def test_npz_round_trip(tmp_path, both):
    with_skipped = scenarios.ScenarioSet(both.scenarios, both.infos, (scenarios.Skipped("a.xml", "no route"),))
    scenarios.save_npz(tmp_path / "set.npz", with_skipped)
    assert_same(scenarios.load_npz(tmp_path / "set.npz"), with_skipped)
    assert_same(scenarios.load_set([tmp_path / "set.npz"]), with_skipped)
    assert [path.name for path in tmp_path.iterdir()] == ["set.npz"]


def test_equal_leaves_are_written_and_read_once(tmp_path, both):
    scenarios.save_npz(tmp_path / "one.npz", both)
    again = scenarios.load_set(scenarios.builtin_paths())
    twice = scenarios.ScenarioSet((*both.scenarios, *again.scenarios), both.infos * 2)
    scenarios.save_npz(tmp_path / "twice.npz", twice)
    assert (tmp_path / "twice.npz").stat().st_size < 1.1 * (tmp_path / "one.npz").stat().st_size
    read = scenarios.load_npz(tmp_path / "twice.npz")
    assert_same(read, twice)
    assert_each_leaf_shared(read.scenarios[:2], read.scenarios[2:])


def test_equal_leaves_are_imported_once(tmp_path, both):
    scenarios.save_npz(tmp_path / "set.npz", both)
    read = scenarios.load_set([tmp_path / "set.npz", *scenarios.builtin_paths()])
    assert_each_leaf_shared(read.scenarios[:2], read.scenarios[2:])


def assert_each_leaf_shared(some: tuple[jf.Scenario, ...], others: tuple[jf.Scenario, ...]) -> None:
    for one, other in zip(some, others, strict=True):
        assert all(jax.tree.leaves(jax.tree.map(lambda first, second: first is second, one, other)))


def test_empty_sets_are_not_written(tmp_path):
    with pytest.raises(scenarios.ScenarioError, match="no scenario to write"):
        scenarios.save_npz(tmp_path / "set.npz", scenarios.ScenarioSet((), ()))
    assert not (tmp_path / "set.npz").exists()


@pytest.mark.parametrize("version", [1, 99])
def test_npz_of_another_version(tmp_path, both, monkeypatch, version):
    monkeypatch.setattr("scenarios.storage.VERSION", version)
    scenarios.save_npz(tmp_path / "set.npz", both)
    monkeypatch.undo()
    with pytest.raises(scenarios.ScenarioError, match=f"format version {version}, this release reads 3"):
        scenarios.load_npz(tmp_path / "set.npz")


def test_npz_of_something_else(tmp_path):
    np.savez(tmp_path / "other.npz", header=np.zeros(3))
    with pytest.raises(scenarios.ScenarioError, match="not a complete set"):
        scenarios.load_npz(tmp_path / "other.npz")


def test_reading_npz_needs_no_commonroad(tmp_path, both):
    scenarios.save_npz(tmp_path / "set.npz", both)
    program = (
        "import sys\n"
        "for name in ('commonroad', 'shapely', 'networkx', 'scipy'): sys.modules[name] = None\n"
        "import scenarios\n"
        f"print(len(scenarios.load_set([{str(tmp_path / 'set.npz')!r}])))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "2", done.stderr


def test_progress(both):
    seen: list[tuple[int, int]] = []
    scenarios.load_set(scenarios.builtin_paths(), progress=lambda done, total: seen.append((done, total)))
    assert seen == [(0, 2), (1, 2), (2, 2)]


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "kept.txt"
    path.write_text("before")
    with pytest.raises(RuntimeError), written_whole(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]
