"""Two updates on several devices, of one process or of some. Arguments: a folder, this process, how many, a port."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from ppo_environments import SMALL, Drift

import ppo
from ppo.sharding import replicated


def main(folder: str, process: str, processes: str, port: str) -> None:
    """Write parameters, metrics and returns of an evaluation; keep a checkpoint on the way, and go on from it."""
    if int(processes) > 1:
        jax.distributed.initialize(f"127.0.0.1:{port}", int(processes), int(process))
    mesh = ppo.environment_mesh()
    assert mesh.size == 4 and len(jax.local_devices()) * int(processes) == 4
    key, settings = jax.random.key(0), ppo.Hyperparameters()
    start = ppo.initial_state(SMALL, Drift(), settings, None, key, mesh)
    update = jax.jit(partial(ppo.train_update, SMALL, Drift(), mesh=mesh))
    state, first = update(start, settings, None)
    checkpoints = ppo.Checkpoints(Path(folder) / "checkpoints")
    checkpoints.save(1, state)
    restored = checkpoints.restore(start)
    assert restored is not None and restored[1] == 1
    before, after = jax.tree.leaves(state), jax.tree.leaves(restored[0])
    assert all(
        one.sharding.is_equivalent_to(other.sharding, one.ndim) for one, other in zip(before, after, strict=True)
    )
    assert not state.actors.observation.sharding.is_fully_replicated
    assert state.parameters["log_std"].sharding.is_fully_replicated
    state, second = update(restored[0], settings, None)

    @jax.jit
    def evaluate(policy: ppo.Policy) -> ppo.Evaluation:
        keys, carry = jax.random.split(jax.random.key(3), 8), ppo.initial_carry(policy, (8,))
        return ppo.evaluate(Drift(), partial(ppo.act, policy), jnp.zeros((8, 0)), keys, 10, carry, mesh)

    returns = jax.device_put(evaluate(ppo.current_policy(SMALL, state)).returns, replicated(mesh))
    if int(process) == 0:
        found = {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(state.parameters)}
        found |= {f"first {name}": value for name, value in first.items()}
        found |= {f"second {name}": value for name, value in second.items()} | {"returns": returns}
        np.savez(Path(folder) / "found.npz", allow_pickle=False, **jax.tree.map(np.asarray, found))
    if int(processes) > 1:
        jax.distributed.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
