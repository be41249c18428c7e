"""What is not finite is named, with its place."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ppo_environments import SMALL, Broken

import ppo
from ppo.diagnosis import diagnose
from ppo.loss import LossTerms
from ppo.rollout import Rollout
from ppo.update import UpdateReport

TIME, ENVIRONMENTS = 6, 3


def diagnosed(bad: dict[str, tuple[int, ...] | None]) -> dict[str, jax.Array]:
    """What is said about an update whose tensors are zero but for some elements."""

    def tensor(name: str, *shape: int) -> jax.Array:
        zeros = np.zeros(shape, np.float32)
        if name in bad:
            zeros[bad[name] if bad[name] is not None else ...] = np.nan
        return jnp.asarray(zeros)

    steps = TIME, ENVIRONMENTS
    zeros, nothing = jnp.zeros(steps), jnp.zeros(steps, bool)
    rollout = Rollout(
        observations=tensor("observation", *steps, 4),
        resets=nothing,
        actions=tensor("action", *steps, 2),
        log_probs=zeros,
        values=tensor("value", *steps),
        next_values=zeros,
        rewards=tensor("reward", *steps),
        terminated=nothing,
        truncated=nothing,
    )
    terms = LossTerms(*[jnp.float32(0.0)] * 5)
    report = UpdateReport(terms, tensor("loss"), tensor("gradient"))
    parameters = {"a": tensor("parameters", 5), "b": jnp.zeros((2, 2))}
    return diagnose(rollout, tensor("last", ENVIRONMENTS, 4), tensor("advantage", *steps), report, parameters)


ALL_LATER = {"advantage": None, "loss": None, "gradient": None, "parameters": None}


@pytest.mark.parametrize(
    ("bad", "name", "step", "element"),
    [
        ({}, None, -1, -1),
        ({"observation": (3, 1, 2), "action": (3, 1, 0), "value": (3, 1), **ALL_LATER}, "observation", 3, 2),
        ({"last": (2, 3), **ALL_LATER}, "observation", TIME, 3),
        ({"reward": (2, 0), "observation": (3, 0, 1), **ALL_LATER}, "reward", 2, -1),
        ({"action": (4, 2, 1), "value": (4, 2), "reward": (4, 2), **ALL_LATER}, "action", 4, -1),
        ({"value": (0, 1), "reward": (1, 1), **ALL_LATER}, "value", 0, -1),
        ({**ALL_LATER, "advantage": (5, 1)}, "advantage", 5, -1),
        ({"loss": None, "gradient": None, "parameters": None}, "loss", -1, -1),
        ({"gradient": None, "parameters": (2,)}, "gradient", -1, -1),
        ({"parameters": (2,)}, "parameters", -1, -1),
    ],
)
def test_the_first_tensor_is_found(bad, name, step, element):
    found = diagnosed(bad)
    kind = int(found["nonfinite"])
    assert (ppo.NONFINITE_NAMES[kind] if kind >= 0 else None) == name
    assert (int(found["nonfinite_step"]), int(found["nonfinite_element"])) == (step, element)


@pytest.fixture(scope="module")
def broken_run(start):
    """What is said about two updates with an environment that goes wrong at step `at` of all."""
    update = jax.jit(partial(ppo.train_update, SMALL, Broken()))

    def run(at: int, observation: bool) -> str | None:
        params = {"at": jnp.int32(at), "observation": jnp.asarray(observation)}
        state, first = update(start, ppo.Hyperparameters(), params)
        _, second = update(state, ppo.Hyperparameters(), params)
        return ppo.first_nonfinite(jax.tree.map(lambda *values: jnp.stack(values), first, second))

    return run


def test_one_line_tells_where_an_environment_went_wrong(broken_run):
    at = SMALL.rollout_steps + 4
    line = "reward is not finite in update 2 at step 4 of its rollout, environment step 16"
    assert broken_run(at, False) == line
    line = "element 1 of the observation is not finite in update 2 at step 5 of its rollout, environment step 17"
    assert broken_run(at, True) == line
    assert broken_run(1000, True) is None


def test_several_runs_tell_which_one():
    metrics = {
        "nonfinite": np.asarray([[-1, -1, 7], [-1, 5, 5]]),
        "nonfinite_step": np.full((2, 3), -1),
        "nonfinite_element": np.full((2, 3), -1),
        "update": np.asarray([[1, 2, 3]] * 2),
        "rollout_steps": np.full((2, 3), 12),
    }
    assert ppo.first_nonfinite(metrics) == "loss is not finite in update 2 of run 1"


def test_a_policy_that_is_broken_is_named(start, update_once):
    parameters = start.parameters | {"log_std": start.parameters["log_std"].at[1].set(jnp.nan)}
    _, metrics = update_once(replace(start, parameters=parameters))
    assert (
        ppo.first_nonfinite(metrics) == "action is not finite in update 1 at step 0 of its rollout, environment step 0"
    )


def test_a_learning_rate_without_bounds_breaks_the_parameters(start, one_step):
    settings = replace(ppo.Hyperparameters(), learning_rate=jnp.float32(jnp.inf))
    _, metrics = one_step(start, settings)
    assert ppo.first_nonfinite(metrics) == "parameters are not finite in update 1"
