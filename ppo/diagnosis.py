"""Find the first tensor of an update that is not finite."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from ppo.networks import Parameters
from ppo.rollout import Rollout
from ppo.update import UpdateReport

NONFINITE_NAMES = ("observation", "action", "reward", "value", "advantage", "loss", "gradient", "parameters")
"""Tensors that are looked at. Those of a rollout come in the order of their steps, at the same step in this one."""


def diagnose(
    rollout: Rollout, last_observation: Array, advantages: Array, report: UpdateReport, parameters: Parameters
) -> dict[str, Array]:
    """Which tensor was the first that was not finite.

    Args:
      rollout: what was collected.
      last_observation: `[environments, observation_size]`, after it.
      advantages: `[time, environments]`.
      report: of the update.
      parameters: after the update.

    Returns:
      int32 `[]` each, or -1 where there is nothing to tell: `nonfinite`, an index of `NONFINITE_NAMES`;
      `nonfinite_step`, the step in the rollout (as many as it has for an observation after it), and
      `nonfinite_element`, the element of an observation.
    """
    steps = rollout.rewards.shape[0]
    observations = jnp.concatenate([rollout.observations, last_observation[None]])
    first = jnp.stack(
        [_first_step(tensor, steps + 1) for tensor in (observations, rollout.actions, rollout.rewards, rollout.values)]
    )
    in_rollout = jnp.argmin(first).astype(jnp.int32)
    checks = (
        jnp.min(first) <= steps,
        ~jnp.all(jnp.isfinite(advantages)),
        ~jnp.isfinite(report.loss),
        ~jnp.isfinite(report.gradient_norm),
        ~_all_finite(parameters),
    )
    kinds = (in_rollout, *(jnp.int32(kind) for kind in range(4, 8)))
    none = jnp.int32(-1)
    kind = jnp.select(checks, kinds, none)
    step = jnp.where(kind == 4, _first_step(advantages, steps), jnp.min(first))
    step = jnp.where((kind >= 0) & (kind <= 4), step, none)
    element = _first_element(observations[jnp.minimum(first[0], steps)])
    return {
        "nonfinite": kind,
        "nonfinite_step": step,
        "nonfinite_element": jnp.where(kind == 0, element, none),
    }


def first_nonfinite(metrics: Mapping[str, Any]) -> str | None:
    """One line about the first tensor that was not finite, or None if all were.

    Args:
      metrics: of `train_update`, `train_chunk` or `train`, on the host or the device; axes before that of updates,
        for several runs at once, are allowed.
    """
    kinds = np.atleast_1d(np.asarray(metrics["nonfinite"]))
    found = np.argwhere(kinds >= 0)
    if not len(found):
        return None
    place = tuple(found[np.argmin(found[:, -1])])
    step, element, update, steps = (
        int(np.atleast_1d(np.asarray(metrics[name]))[place])
        for name in ("nonfinite_step", "nonfinite_element", "update", "rollout_steps")
    )
    name = NONFINITE_NAMES[int(kinds[place])]
    tensor = f"element {element} of the observation" if element >= 0 else name
    run = f" of run {','.join(str(index) for index in place[:-1])}" if len(place) > 1 else ""
    verb = "are" if name == "parameters" else "is"
    where = f" at step {step} of its rollout, environment step {(update - 1) * steps + step}" if step >= 0 else ""
    return f"{tensor} {verb} not finite in update {update}{run}{where}"


def _first_step(tensor: Array, otherwise: int) -> Array:
    """The first step `[]` of `[time, ...]` at which an element is not finite."""
    bad = jnp.any(~jnp.isfinite(tensor), axis=tuple(range(1, tensor.ndim)))
    return jnp.where(jnp.any(bad), jnp.argmax(bad), otherwise).astype(jnp.int32)


def _first_element(observations: Array) -> Array:
    return jnp.argmax(jnp.any(~jnp.isfinite(observations), axis=0)).astype(jnp.int32)


def _all_finite(tree: Any) -> Array:
    return jnp.all(jnp.isfinite(ravel_pytree(tree)[0]))
