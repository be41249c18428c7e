"""Policies in files, and settings that cannot be."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ppo_environments import SMALL

import ppo
from ppo import networks

NAMES = {"observation_names": ["x", "y", "z"], "action_names": ["left", "right"]}


@pytest.fixture(scope="module")
def policy(unbroken) -> ppo.Policy:
    return ppo.current_policy(SMALL, unbroken[-1][0])


@pytest.fixture
def folder(policy, tmp_path):
    ppo.save_policy(tmp_path / "policy", policy, {**NAMES, "note": "kept"})
    return tmp_path / "policy"


@pytest.mark.parametrize("memory", [True, False])
def test_what_is_saved_is_loaded(policy, tmp_path, memory, assert_equal):
    if not memory:
        network = replace(SMALL.network, memory=False)
        parameters = networks.init(network, jax.random.key(0), 3, 2, 0.3)
        policy = replace(policy, network=network, parameters=parameters)
    for _ in range(2):
        ppo.save_policy(tmp_path / "new" / "policy", policy, {**NAMES, "note": "kept"})
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["policy"]
    assert sorted(path.name for path in (tmp_path / "new" / "policy").iterdir()) == ["policy.json", "policy.npz"]
    loaded, description = ppo.load_policy(tmp_path / "new" / "policy", **NAMES)
    assert description == {**NAMES, "note": "kept"}
    assert jax.tree.structure(loaded) == jax.tree.structure(policy)
    assert_equal(loaded, policy)


def test_the_average_of_policies(policy):
    moved = replace(policy, parameters=jax.tree.map(lambda leaf: leaf + 3.0, policy.parameters))
    mean = ppo.average_policies([policy, policy, replace(moved, return_std=jnp.float32(7.0))])
    for leaf, first in zip(jax.tree.leaves(mean.parameters), jax.tree.leaves(policy.parameters), strict=True):
        np.testing.assert_allclose(leaf, first + 1.0, atol=1e-6)
    assert float(mean.return_std) == 7.0
    smaller = networks.init(SMALL.network, jax.random.key(0), 2, 2, 0.3)
    for others in ([], [policy, replace(policy, parameters=smaller)]):
        with pytest.raises(ppo.PolicyError, match="name"):
            ppo.average_policies(others)


def test_a_policy_that_cannot_be_written_leaves_the_old_one(folder, policy, assert_equal):
    with pytest.raises(TypeError):
        ppo.save_policy(folder, replace(policy, return_std=jnp.float32(5.0)), {"note": object()})
    assert [path.name for path in folder.parent.iterdir()] == ["policy"]
    assert_equal(ppo.load_policy(folder)[0], policy)


def change(folder, **changes):
    content = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps(content | changes))


def drop_array(folder):
    with np.load(folder / "policy.npz") as archive:
        arrays = {name: archive[name] for name in archive.files if name != "return_std"}
    np.savez(folder / "policy.npz", allow_pickle=False, **arrays)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (shutil.rmtree, "there is no such folder; name one that training wrote"),
        (lambda folder: (folder / "policy.npz").unlink(), "has no policy.npz; name a folder that holds a policy"),
        (lambda folder: (folder / "policy.json").unlink(), "has no policy.json; name a folder that holds a policy"),
        (lambda folder: (folder / "policy.json").write_text("{"), "policy.json: cannot be read"),
        (lambda folder: (folder / "policy.json").write_text("[]"), "policy.json: does not describe a policy"),
        (lambda folder: (folder / "policy.npz").write_bytes(b"garbage"), "policy.npz: cannot be read"),
        (
            lambda folder: (folder / "policy.npz").write_bytes((folder / "policy.npz").read_bytes()[:-200]),
            "policy.npz: cannot be read",
        ),
        (lambda folder: change(folder, format=2), "has format 2, this version reads format 1"),
        (lambda folder: change(folder, network={"lstm_size": -1}), "lstm_size -1: give a positive integer"),
        (lambda folder: change(folder, network={"width": 1}), "does not describe a policy .*width"),
        (
            lambda folder: change(folder, observation_size=4),
            r"encoder_0/kernel is float32\[2, 3, 8\], but .*\[2, 4, 8\]",
        ),
        (drop_array, "has no array return_std; its policy.json belongs to another policy"),
        (lambda folder: change(folder, description={}), "does not name the elements of its observations"),
    ],
)
def test_a_policy_that_cannot_be_used_is_one_line(folder, damage, message):
    damage(folder)
    with pytest.raises(ppo.PolicyError, match=message) as error:
        ppo.load_policy(folder, **NAMES)
    assert "\n" not in str(error.value) and str(folder) in str(error.value)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"observation_names": ["x", "speed", "z"]}, "element 1 of the policy's observations is y, here it is speed"),
        (
            {"observation_names": ["x", "y", "z", "t"]},
            "element 3 of the policy's observations is missing, here it is t",
        ),
        ({"action_names": ["left"]}, "element 1 of the policy's actions is right, here it is none"),
    ],
)
def test_a_policy_of_another_layout_is_refused(folder, names, message):
    with pytest.raises(ppo.PolicyError, match=f"{message}; use the settings that the policy was trained with"):
        ppo.load_policy(folder, **names)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ppo.PPOConfig(environments=10),
            "environments 10 cannot be divided into minibatches 4; give a multiple",
        ),
        (lambda: ppo.PPOConfig(rollout_steps=0), "PPOConfig.rollout_steps 0: give a positive integer"),
        (lambda: ppo.PPOConfig(epochs=True), "PPOConfig.epochs True: give a positive integer"),
        (lambda: ppo.PPOConfig(observation_clip=0.0), "PPOConfig.observation_clip 0.0: give a positive number"),
        (lambda: ppo.PPOConfig(observation_floor=0.0), "PPOConfig.observation_floor 0.0: give a positive number"),
        (lambda: ppo.NetworkConfig(lstm_size=0), "NetworkConfig.lstm_size 0: give a positive integer"),
        (lambda: ppo.NetworkConfig(head=(64, -1)), "NetworkConfig.head -1: give a positive integer"),
        (lambda: ppo.Hyperparameters(learning_rate=0.0), "Hyperparameters.learning_rate 0: give a positive number"),
        (lambda: ppo.Hyperparameters(discount=1.1), "Hyperparameters.discount 1.1: give a number between 0 and 1"),
        (lambda: ppo.Hyperparameters(initial_std=float("nan")), "initial_std nan: give a positive number"),
        (lambda: ppo.Hyperparameters(entropy_coefficient=-1), "entropy_coefficient -1: give a number of at least 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
