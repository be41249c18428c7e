"""Leaving out scenarios in which the traffic is never in the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import pytest

import jaxfrenet as jf
from experiments._conflicts import with_conflicts
from experiments._training_sets import joined, training_sets
from jaxfrenet.environment import EnvironmentConfig
from scenarios import Dataset, Draw, builtin_paths
from scenarios.command_line import UserError

CONFIG = EnvironmentConfig(jf.PlannerConfig.preset("full"))


@pytest.fixture(scope="module")
def busy() -> Dataset:
    return Dataset.from_generator(Draw(8, 0, "tjunction", "commonroad"))


@pytest.fixture(scope="module")
def empty(busy) -> Dataset:
    """The same scenarios without their traffic."""
    cleared = [
        replace(one, obstacles=replace(one.obstacles, valid=jnp.zeros_like(one.obstacles.valid)))
        for one in busy.scenarios
    ]
    return Dataset(tuple(cleared), busy.infos)


def test_only_scenarios_with_traffic_in_the_way_are_left(busy, empty):
    kept = with_conflicts(CONFIG, joined([empty, busy]))
    assert len(kept)
    assert all(any(one is candidate for candidate in busy.scenarios) for one in kept.scenarios)


def test_files_are_kept():
    def nothing(found: Dataset) -> Dataset:
        return found.part([])

    def names(found: Dataset) -> list[str]:
        return [info.name for info in found.infos]

    files = [Path(path) for path in builtin_paths()]
    kind = ("tjunction:commonroad",)
    sets = training_sets(files, files[:1], kind, 3, 0, nothing)
    assert sets.groups == (2, 0)
    assert len(sets.train) == 2 and names(sets.validation) == names(Dataset.from_paths(files[:1]))
    kept = training_sets(files, files[:1], kind, 3, 0)
    assert (kept.groups, len(kept.validation)) == ((2, 3), 1)
    with pytest.raises(UserError, match="no scenario is left for training; give more with --generate, or files"):
        training_sets((), files, kind, 3, 0, nothing)


def test_kinds_have_numbers_of_their_own():
    sets = training_sets((), (), ("tjunction:commonroad", "tjunction:hard=20"), 6, 0)
    assert (sets.groups, len(sets.validation)) == ((6, 20), 1 + 3)
    names = [info.name for info in sets.train.infos]
    assert len(set(names)) == 26
    assert not set(names) & {info.name for info in sets.validation.infos}
    with pytest.raises(UserError, match="--kinds tjunction:hard=many: 'many' is no number of scenarios"):
        training_sets((), (), ("tjunction:hard=many",), 6, 0)
