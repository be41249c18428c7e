"""Several devices, of one process or of two, find what one device finds."""

from __future__ import annotations

import socket
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ppo_environments import SMALL, Drift

import ppo
from ppo.sharding import check_divisible


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.mark.parametrize("processes", [1, 2])
def test_several_devices_find_the_same_as_one(processes, tmp_path, unbroken, start_program):
    port = free_port()
    running = [
        start_program("sharded_run.py", tmp_path, index, processes, port, devices=4 // processes)
        for index in range(processes)
    ]
    try:
        for process in running:
            _, errors = process.communicate(timeout=200)
            assert process.returncode == 0, errors[-3000:]
    finally:
        for process in running:
            process.kill()
    found = np.load(tmp_path / "found.npz")
    state = unbroken[1][0]
    expected = {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(state.parameters)}
    for number, (_, metrics) in zip(("first", "second"), unbroken, strict=False):
        expected |= {f"{number} {name}": value for name, value in metrics.items()}
    policy, keys = ppo.current_policy(SMALL, state), jax.random.split(jax.random.key(3), 8)
    carry = ppo.initial_carry(policy, (8,))
    expected["returns"] = ppo.evaluate(Drift(), partial(ppo.act, policy), jnp.zeros((8, 0)), keys, 10, carry).returns
    assert set(found.files) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, atol=1e-5, rtol=1e-5, err_msg=name)


def test_environments_that_cannot_be_divided_are_an_error():
    mesh = jax.sharding.AbstractMesh((3,), ("environments",))
    with pytest.raises(ValueError, match="8 environments cannot be divided among 3 devices; give a multiple"):
        check_divisible(8, mesh)  # pyright: ignore[reportArgumentType]
