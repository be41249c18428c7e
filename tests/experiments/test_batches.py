from __future__ import annotations

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from experiments._batches import make_batches, rounded_up


@pytest.fixture(scope="module")
def found():
    return scenarios.load_set(scenarios.builtin_paths()).scenarios


@pytest.mark.parametrize("size, expected", [(0, 0), (1, 1), (2, 2), (3, 3), (5, 6), (6, 6), (7, 8), (13, 16), (65, 96)])
def test_sizes_are_rounded_up_to_a_coarse_scale(size, expected):
    assert rounded_up(size) == expected


@pytest.mark.parametrize("size", [1, 2, 3, 7])
def test_every_scenario_is_in_one_batch_of_the_common_length(found, size):
    many = [*found, *found, found[0]]
    batches = make_batches(many, size)
    assert sorted(index for batch in batches for index in batch.indices) == list(range(len(many)))
    lengths = {batch.scenario.origin.shape[0] for batch in batches}
    assert len(lengths) == 1
    assert lengths.pop() <= size


def test_a_batch_holds_its_scenarios(found):
    for batch in make_batches(found, 8):
        for row, index in enumerate(batch.indices):
            np.testing.assert_array_equal(batch.scenario.origin[row], found[index].origin)
            np.testing.assert_array_equal(
                batch.scenario.initial_state.position[row], found[index].initial_state.position
            )


def test_there_are_enough_steps_for_every_episode(found):
    assert all(batch.max_steps >= max(map(jf.max_steps, found)) for batch in make_batches(found, 8))
