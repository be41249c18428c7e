"""Leaving out scenarios in which the traffic is never in the way."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import pytest

import jaxfrenet as jf
from experiments._conflicts import only_conflicts
from experiments._training_sets import TrainingSets, joined, training_sets
from jaxfrenet.environment import EnvironmentConfig
from scenarios import Dataset, Draw
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
    first = joined([empty.part(range(4)), busy.part(range(4))])
    second = joined([busy.part(range(4, 8)), empty.part(range(4, 8))])
    left = only_conflicts(CONFIG, TrainingSets(first, second, (3, 5)))
    assert left.groups == (0, len(left.train))
    for kept, candidates in zip(left.parts(), (busy.scenarios[:4], busy.scenarios[4:]), strict=True):
        assert len(kept)
        assert all(any(one is candidate for candidate in candidates) for one in kept.scenarios)


def test_nothing_left(busy, empty):
    with pytest.raises(UserError, match="--conflicts leaves no scenario for training"):
        only_conflicts(CONFIG, TrainingSets(empty, busy, (8,)))


def test_kinds_have_numbers_of_their_own():
    sets = training_sets((), (), ("tjunction:commonroad", "tjunction:hard=20"), 6, 0)
    assert (sets.groups, len(sets.validation)) == ((6, 20), 1 + 3)
    names = [info.name for info in sets.train.infos]
    assert len(set(names)) == 26
    assert not set(names) & {info.name for info in sets.validation.infos}
    with pytest.raises(UserError, match="--kinds tjunction:hard=many: 'many' is no number of scenarios"):
        training_sets((), (), ("tjunction:hard=many",), 6, 0)
