"""What was imported once is read from the cache, and only if it is still the same."""

from __future__ import annotations

import tarfile
from pathlib import Path

import pytest

import scenarios
from scenarios import cache as cache_module
from scenarios.batching import leaves_of
from scenarios.cache import user_cache


@pytest.fixture
def folder(tmp_path, t_junction_file) -> Path:
    """A folder with a good and a broken file."""
    path = tmp_path / "files"
    path.mkdir()
    (path / "good.xml").write_bytes(t_junction_file.read_bytes())
    (path / "broken.xml").write_bytes(b"")
    return path


@pytest.fixture
def imports(monkeypatch) -> list[list[Path]]:
    """What was imported because it was not in the cache."""
    seen: list[list[Path]] = []

    def load_set(paths, *arguments):
        seen.append(paths)
        return scenarios.load_set(paths, *arguments)

    monkeypatch.setattr(cache_module, "load_set", load_set)
    return seen


def assert_same(one: scenarios.ScenarioSet, other: scenarios.ScenarioSet) -> None:
    assert one.infos == other.infos and one.skipped == other.skipped
    for first, second in zip(one.scenarios, other.scenarios, strict=True):
        for name, leaf in leaves_of(first).items():
            assert leaf.tobytes() == leaves_of(second)[name].tobytes(), name


def test_second_time_comes_from_the_cache(tmp_path, folder, imports):
    first = scenarios.load_cached([folder], cache=tmp_path / "cache")
    again = scenarios.load_cached([str(folder)], cache=str(tmp_path / "cache"))
    assert len(imports) == 1
    assert_same(again, first)
    assert_same(again, scenarios.load_set([folder]))
    assert [skipped.file for skipped in again.skipped] == [str(folder / "broken.xml")]
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_archives_too(tmp_path, folder, imports):
    with tarfile.open(tmp_path / "set.tar.xz", "w:xz") as archive:
        archive.add(folder, arcname="set")
    paths = [tmp_path / "set.tar.xz"]
    assert_same(*(scenarios.load_cached(paths, cache=tmp_path / "cache") for _ in range(2)))
    assert len(imports) == 1


def test_what_changes_is_imported_anew(tmp_path, folder, imports, monkeypatch):
    def count(planning_problem: int | None = None) -> int:
        scenarios.load_cached([folder], planning_problem, cache=tmp_path / "cache")
        return len(imports)

    assert count() == 1
    assert count(planning_problem=100) == 2
    (folder / "broken.xml").write_bytes(b" ")
    assert count() == 3
    (folder / "broken.xml").rename(folder / "other.xml")
    assert count() == 4
    monkeypatch.setattr(cache_module, "IMPORTER_VERSION", 99)
    assert count() == 5
    monkeypatch.undo()
    scenarios.load_cached([folder], cache=tmp_path / "cache")
    assert len(list((tmp_path / "cache").iterdir())) == 5


@pytest.mark.parametrize("kept", [0, 100, -2000])
def test_broken_cache_is_replaced(tmp_path, folder, imports, kept):
    first = scenarios.load_cached([folder], cache=tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    content = file.read_bytes()
    file.write_bytes(content[:kept])
    assert_same(scenarios.load_cached([folder], cache=tmp_path / "cache"), first)
    assert len(imports) == 2
    assert_same(scenarios.load_cached([folder], cache=tmp_path / "cache"), first)
    assert len(imports) == 2


def test_cache_of_another_version_is_replaced(tmp_path, folder, imports, monkeypatch):
    scenarios.load_cached([folder], cache=tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    monkeypatch.setattr("scenarios.storage.VERSION", 99)
    scenarios.save_npz(file, scenarios.load_set([folder]))
    monkeypatch.setattr("scenarios.storage.VERSION", cache_module.VERSION)
    scenarios.load_cached([folder], cache=tmp_path / "cache")
    assert len(imports) == 2
    assert len(scenarios.load_npz(file)) == 1


def test_without_a_place_for_the_cache(tmp_path, folder):
    (tmp_path / "file").touch()
    loaded = scenarios.load_cached([folder], cache=tmp_path / "file" / "cache")
    assert len(loaded) == 1 and len(loaded.skipped) == 1


def test_default_place(tmp_path, folder, monkeypatch):
    monkeypatch.setattr(cache_module, "user_cache", user_cache)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    scenarios.load_cached([folder])
    assert len(list((tmp_path / "caches" / "jaxfrenet" / "scenarios").glob("*.npz"))) == 1
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert cache_module.user_cache() == tmp_path / ".cache" / "jaxfrenet" / "scenarios"


def test_one_file_and_npz_sets_are_read_themselves(tmp_path, t_junction_file):
    scenarios.save_npz(tmp_path / "set.npz", scenarios.load_set([t_junction_file]))
    for path in (t_junction_file, tmp_path / "set.npz"):
        assert len(scenarios.load_cached([path], cache=tmp_path / "cache")) == 1
    assert not (tmp_path / "cache").exists()


def test_bad_sources_are_reported_as_ever(tmp_path):
    for paths, expected in (([], "no scenario given"), ([tmp_path / "nothing"], "no such file or folder")):
        with pytest.raises(scenarios.ScenarioError, match=expected):
            scenarios.load_cached(paths, cache=tmp_path / "cache")
    (tmp_path / "empty.xml").touch()
    with pytest.raises(scenarios.ScenarioError, match="none of 1 scenarios can be used"):
        scenarios.load_cached([tmp_path], cache=tmp_path / "cache")
