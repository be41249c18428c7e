"""What the tests of `ppo` share: a small setting, compiled once."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ppo

# The environments are a module beside the tests, which programs that run in processes of their own import as well.
sys.path.insert(0, str(Path(__file__).parent))

from ppo_environments import SMALL, Drift  # noqa: E402

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def update_once() -> Callable[..., tuple[ppo.TrainingState, dict[str, jax.Array]]]:
    """`train_update` in the small setting, of state and hyperparameters."""
    compiled = jax.jit(partial(ppo.train_update, SMALL, Drift()))
    return lambda state, hyperparameters=ppo.Hyperparameters(): compiled(state, hyperparameters, None)  # noqa: B008


@pytest.fixture(scope="session")
def one_step() -> Callable[..., tuple[ppo.TrainingState, dict[str, jax.Array]]]:
    """`train_update` with a single step of gradient descent, of state and hyperparameters."""
    compiled = jax.jit(partial(ppo.train_update, replace(SMALL, epochs=1, minibatches=1), Drift()))
    return lambda state, hyperparameters: compiled(state, jax.tree.map(jnp.float32, hyperparameters), None)


@pytest.fixture(scope="session")
def start() -> ppo.TrainingState:
    """The state before training in the small setting."""
    make = jax.jit(partial(ppo.initial_state, SMALL, Drift()))
    return make(ppo.Hyperparameters(), None, jax.random.key(0))


@pytest.fixture(scope="session")
def unbroken(start, update_once) -> list[tuple[ppo.TrainingState, dict[str, jax.Array]]]:
    """States and metrics after 1, 2, 3, 4 updates in the small setting."""
    found, state = [], start
    for _ in range(4):
        state, metrics = update_once(state)
        found.append((state, metrics))
    return found


def leaves(tree: Any) -> dict[str, np.ndarray]:
    """Arrays by name, keys as numbers."""

    def numbers(leaf: Any) -> np.ndarray:
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if is_key else leaf)

    return {jax.tree_util.keystr(path): numbers(leaf) for path, leaf in jax.tree.leaves_with_path(tree)}


@pytest.fixture(scope="session")
def assert_equal() -> Callable[[Any, Any], None]:
    """Two trees have the same bits."""

    def check(one: Any, other: Any) -> None:
        one, other = leaves(one), leaves(other)
        assert one.keys() == other.keys()
        for name, array in one.items():
            np.testing.assert_array_equal(array, other[name], err_msg=name)

    return check


@pytest.fixture(scope="session")
def start_program() -> Callable[..., subprocess.Popen]:
    """Start a program of this folder in a process of its own, with so many devices."""

    settings: Any = jax.config

    def begin(name: str, *arguments: Any, devices: int = 1) -> subprocess.Popen:
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "JAX_PLATFORMS": "cpu",
            "JAX_COMPILATION_CACHE_DIR": settings.jax_compilation_cache_dir or "",
            "XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}",
        }
        command = [sys.executable, str(Path(__file__).parent / name), *map(str, arguments)]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    return begin
