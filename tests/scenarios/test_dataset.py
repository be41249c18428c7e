"""Datasets: the same whatever their source, divided reproducibly, in batches that are padded little."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios import Dataset, Draw, ScenarioSet
from scenarios.batching import leaves_of, rounded_up, scenario_of
from scenarios.buckets import bytes_per_element, group_by_size
from scenarios.collection import scenario_files
from scenarios.commonroad import from_bytes


@pytest.fixture(scope="module")
def both(t_junction_file) -> ScenarioSet:
    return scenarios.load_set(scenarios.builtin_paths())


@pytest.fixture(scope="module")
def many(both) -> Dataset:
    """400 scenarios that differ in their names only."""
    names = [f"ZAM_Many-1_{number}_T-1" for number in range(400)]
    infos = tuple(dataclasses.replace(both.infos[0], name=name, benchmark_id=name) for name in names)
    return Dataset(both.scenarios[:1] * len(infos), infos)


@pytest.fixture(scope="module")
def mixed(both) -> Dataset:
    """Some scenarios as they are, and as large as if they had many more nodes or much more traffic."""
    longer = [scenarios.pad_to(one, {"nodes": 4000, "bins": 500}) for one in both.scenarios]
    crowded = [scenarios.pad_to(one, {"obstacles": 60 + 3 * index}) for index, one in enumerate(both.scenarios)]
    return Dataset.from_set(ScenarioSet((*both.scenarios, *longer, *crowded, *both.scenarios), both.infos * 4))


def copy_of(scenario: jf.Scenario) -> jf.Scenario:
    return scenario_of(leaves_of(scenario))


def nbytes(scenario: jf.Scenario) -> int:
    return sum(leaf.nbytes for leaf in jax.tree.leaves(scenario))


def names_of(part: Dataset) -> list[str]:
    return [info.name for info in part.infos]


def assert_same_leaves(one: jf.Scenario, other: jf.Scenario) -> None:
    for name, leaf in leaves_of(one).items():
        np.testing.assert_array_equal(leaf, leaves_of(other)[name], err_msg=name)


def test_sources_give_the_same(tmp_path, both):
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in scenarios.builtin_paths():
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / "broken.xml").write_bytes(b"")
    read = Dataset.from_paths([folder], cache=tmp_path / "cache")
    assert [skipped.file for skipped in read.skipped] == [str(folder / "broken.xml")]
    scenarios.save_npz(tmp_path / "set.npz", read)
    for other in (Dataset.from_set(scenarios.load_set([folder])), Dataset.from_paths([tmp_path / "set.npz"])):
        assert other.infos == read.infos == both.infos and other.skipped == read.skipped
        for one, same in zip(read.scenarios, other.scenarios, strict=True):
            assert_same_leaves(one, same)


def test_equal_leaves_are_in_memory_once(both):
    first, other = both.scenarios
    dataset = Dataset.from_set(ScenarioSet((first, copy_of(first), other), (*both.infos, both.infos[0])))
    leaves = [jax.tree.leaves(scenario) for scenario in dataset.scenarios]
    assert all(one is same for one, same in zip(leaves[0], leaves[1], strict=True))
    assert dataset.scenarios[0].road.segments is not dataset.scenarios[2].road.segments
    assert_same_leaves(dataset.scenarios[2], other)


def test_split_has_every_scenario_once_and_about_the_shares(many):
    parts = many.split()
    assert sorted(name for part in parts for name in names_of(part)) == sorted(names_of(many))
    for part, share in zip(parts, (0.75, 0.15, 0.10), strict=True):
        assert len(part) / len(many) == pytest.approx(share, abs=0.06)
        places = [many.infos.index(info) for info in part.infos]
        assert places == sorted(places)


def test_split_is_the_same_in_every_release(many):
    parts = Dataset(many.scenarios[:40], many.infos[:40]).split()
    numbers = [[int(name.split("_")[2]) for name in names_of(part)] for part in parts]
    assert numbers[1:] == [[31, 32, 35], [4, 17, 24, 37, 39]]


def test_split_does_not_depend_on_the_other_scenarios(many):
    whole = many.split(seed=3)
    reversed_half = Dataset(many.scenarios[:200], many.infos[200:][::-1]).split(seed=3)
    for all_names, some_names in zip(map(names_of, whole), map(names_of, reversed_half), strict=True):
        assert some_names == [name for name in reversed(all_names) if name in names_of(many)[200:]]


def test_other_seeds_split_otherwise(many):
    assert names_of(many.split(seed=0).test) != names_of(many.split(seed=1).test)


def test_copies_of_a_scenario_are_in_one_part(many):
    copies = tuple(dataclasses.replace(info, name=f"copy_{info.name}") for info in many.infos)
    for part in Dataset(many.scenarios * 2, many.infos + copies).split():
        half = len(part) // 2
        assert [f"copy_{name}" for name in names_of(part)[:half]] == names_of(part)[half:]


@pytest.mark.parametrize(
    "shares", [(0.8, 0.2, 0.0), (0.8, 0.3, -0.1), (0.5, 0.2, 0.2), (0.5, 0.5), (float("nan"), 0.5, 0.5)]
)
def test_shares_that_are_none(many, shares):
    with pytest.raises(scenarios.ScenarioError, match="three positive numbers with sum 1"):
        many.split(shares=shares)


def test_stacked_holds_all(mixed):
    batch = mixed.stacked({"steps": 300})
    assert batch.obstacles.valid.shape == (len(mixed), 63, 300)
    assert_same_leaves(batch, scenarios.stack(mixed.scenarios, {"steps": 300}))


def test_nothing_to_batch():
    with pytest.raises(scenarios.ScenarioError, match="no scenario to stack"):
        Dataset((), ()).stacked()
    with pytest.raises(scenarios.ScenarioError, match="no scenario to put into buckets"):
        Dataset((), ()).buckets()


@pytest.mark.parametrize("max_waste", [-0.1, float("nan"), float("inf")])
def test_waste_that_is_none(mixed, max_waste):
    with pytest.raises(scenarios.ScenarioError, match="max_waste is"):
        mixed.buckets(max_waste)


def test_buckets_hold_their_scenarios(mixed):
    for bucket in mixed.buckets():
        sizes = scenarios.sizes_of(jax.tree.map(lambda leaf: leaf[0], bucket.scenario))
        assert sizes == {axis: rounded_up(size) for axis, size in sizes.items()}
        for row, index in enumerate(bucket.indices):
            one = jax.tree.map(lambda leaf, row=row: leaf[row], bucket.scenario)
            assert_same_leaves(one, scenarios.pad_to(mixed.scenarios[index], sizes))


def test_scenarios_of_like_sizes_share_a_bucket(mixed):
    buckets = mixed.buckets(0.25)
    assert sorted(index for bucket in buckets for index in bucket.indices) == list(range(len(mixed)))
    assert {bucket.indices for bucket in buckets} == {(0, 1, 6, 7), (2, 3), (4, 5)}
    assert buckets[0].indices == (0, 1, 6, 7)
    assert sum(nbytes(bucket.scenario) for bucket in buckets) < 0.6 * nbytes(mixed.stacked())
    assert len(mixed.buckets(100.0)) == 1


@pytest.mark.parametrize("max_waste", [0.0, 0.1, 0.5, 2.0])
def test_padding_stays_within_what_is_allowed(t_junction, max_waste):
    random, own = np.random.default_rng(0), scenarios.sizes_of(t_junction)
    sizes = [{axis: size * int(random.integers(1, 5)) for axis, size in own.items()} for _ in range(60)]
    element_bytes = bytes_per_element(t_junction)
    groups = group_by_size(sizes, element_bytes, max_waste)
    assert sorted(index for indices, _ in groups for index in indices) == list(range(len(sizes)))
    for indices, largest in groups:
        assert largest == {axis: max(sizes[index][axis] for index in indices) for axis in own}
    at_first = sum(nbytes(scenarios.pad_to(t_junction, one)) for one in sizes)
    padded = sum(len(indices) * nbytes(scenarios.pad_to(t_junction, largest)) for indices, largest in groups)
    assert padded <= (1.0 + max_waste) * at_first
    assert len(groups) <= len(group_by_size(sizes, element_bytes, 0.0))


def some_files(data_root: Path, name: str, every: int) -> list[tuple[jf.Scenario, scenarios.ScenarioInfo]]:
    archive = data_root / "scenarios" / f"{name}.tar.xz"
    if not archive.is_file():
        pytest.skip(f"no {archive}")
    return [from_bytes(file.read(), file.name) for file in scenario_files(archive)[::every]]


@pytest.mark.data
def test_real_files(data_root):
    pytest.importorskip("commonroad")
    alike, diverse = some_files(data_root, "tjunction-validation", 8), some_files(data_root, "commonroad-diverse", 12)
    loaded = [*alike, *diverse]
    dataset = Dataset.from_set(ScenarioSet(tuple(one for one, _ in loaded), tuple(info for _, info in loaded)))
    # These files are of one map; where the ego starts decides between the frames.
    assert len({id(scenario.road.segments) for scenario in dataset.scenarios[: len(alike)]}) <= 2
    assert len({info.benchmark_id for info in dataset.infos}) == len(dataset)
    buckets = dataset.buckets()
    assert sorted(index for bucket in buckets for index in bucket.indices) == list(range(len(dataset)))
    assert 1 < len(buckets) < len(dataset) / 2
    assert sum(nbytes(bucket.scenario) for bucket in buckets) < 0.6 * nbytes(dataset.stacked())


def test_generated_scenarios_are_a_dataset_like_any_other():
    data = Dataset.from_generator(Draw(12, 7))
    assert len(data) == 12
    parts = data.split(seed=1)
    assert sum(len(part) for part in parts) == 12
    more = Dataset.from_generator(Draw(20, 7)).split(seed=1)
    for part, larger in zip(parts, more, strict=True):
        assert {info.name for info in part.infos} <= {info.name for info in larger.infos}
    assert data.stacked().path.x.shape[0] == 12
