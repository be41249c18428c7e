"""Save checkpoints until killed, and print the step of each when it is safe. Argument: the folder."""

from __future__ import annotations

import sys

import jax
import numpy as np

import ppo


def state_of(step: int) -> dict[str, jax.Array]:
    """The state that belongs to a step."""
    random = np.random.default_rng(step)
    return {name: jax.numpy.asarray(random.normal(size=100_000), "float32") for name in "abcdef"}


def main(folder: str) -> None:
    """Go on from the last step."""
    checkpoints = ppo.Checkpoints(folder, keep=2)
    restored = checkpoints.restore(state_of(0))
    step = restored[1] if restored else 0
    while True:
        step += 1
        checkpoints.save(step, state_of(step))
        print(step, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
