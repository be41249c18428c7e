"""What every predictor returns."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Bool, Float


@pytree_dataclass
class Prediction:
    """Where obstacles will be: a Gaussian per obstacle and coming step; entry 0 is the next step.

    Entries that are not valid hold finite numbers without meaning; their covariance is the identity.
    """

    mean: Float[Array, "*batch 2"]
    """`[obstacles, steps, 2]`, m, centre."""
    covariance: Float[Array, "*batch 2 2"]
    """`[obstacles, steps, 2, 2]`, m², positive definite."""
    heading: Float[Array, "*batch"]
    """`[obstacles, steps]`, rad."""
    speed: Float[Array, "*batch"]
    """`[obstacles, steps]`, m/s."""
    valid: Bool[Array, "*batch"]
    """`[obstacles, steps]`."""
    length: Float[Array, "*obstacles"]
    """`[obstacles]`, m, enlarged by the safety margin."""
    width: Float[Array, "*obstacles"]
    """`[obstacles]`, m, enlarged by the safety margin."""

    def first(self, steps: int) -> Prediction:
        """The first `steps` coming steps; as many as there are if fewer, then padded as not valid."""
        missing = max(0, steps - self.valid.shape[-1])

        def cut(value: Array) -> Array:
            widths = [(0, 0), (0, missing)] + [(0, 0)] * (value.ndim - 2)
            return jnp.pad(value[:, :steps], widths, mode="edge")

        return Prediction(
            mean=cut(self.mean),
            covariance=cut(self.covariance),
            heading=cut(self.heading),
            speed=cut(self.speed),
            valid=jnp.pad(self.valid[:, :steps], ((0, 0), (0, missing))),
            length=self.length,
            width=self.width,
        )

    def at(self, scenario: Array, obstacle: Array, step: Array) -> Prediction:
        """Entries of a batch at some triples, all int `[triples]`: every field gets the one leading axis `triples`."""
        entry = scenario, obstacle, step
        return Prediction(
            mean=self.mean[entry],
            covariance=self.covariance[entry],
            heading=self.heading[entry],
            speed=self.speed[entry],
            valid=self.valid[entry],
            length=self.length[scenario, obstacle],
            width=self.width[scenario, obstacle],
        )
