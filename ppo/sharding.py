"""Several devices: environments are divided among them, everything else is on all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

AXIS = "environments"
"""Name of the mesh's only axis."""

T = TypeVar("T")


def environment_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """The devices, all of all processes if none are given, in a row."""
    return Mesh(np.asarray(jax.devices() if devices is None else devices), (AXIS,), axis_types=(AxisType.Auto,))


def replicated(mesh: Mesh) -> NamedSharding:
    """The same on every device."""
    return NamedSharding(mesh, PartitionSpec())


def divided(mesh: Mesh, axis: int = 0) -> NamedSharding:
    """Divided along an axis of the arrays."""
    return NamedSharding(mesh, PartitionSpec(*[None] * axis, AXIS))


def replicate(tree: T, mesh: Mesh) -> T:
    """Put a pytree on every device; with several processes all have to hold the same."""
    return jax.device_put(tree, replicated(mesh))


def constrain(tree: T, mesh: Mesh | None, axis: int | None) -> T:
    """Inside `jit`: keep arrays divided along `axis`, or on every device if it is None or cannot be divided evenly."""
    if mesh is None:
        return tree

    def one(leaf: jax.Array) -> jax.Array:
        even = axis is not None and leaf.shape[axis] % mesh.size == 0
        return jax.lax.with_sharding_constraint(
            leaf, divided(mesh, axis) if even and axis is not None else replicated(mesh)
        )

    return jax.tree.map(one, tree)


def map_environments(function: Callable, in_axes: tuple[int | None, ...], mesh: Mesh | None) -> Callable:
    """`jax.vmap` over environments, each device with its own.

    Environments have loops that run until the last of a batch is done. Left to the compiler these would be run in step
    by all devices, so they are divided here by hand.

    Args:
      function: of one environment.
      in_axes: for each argument 0, or None where all environments share it.
      mesh: None maps on one device.
    """
    mapped = jax.vmap(function, in_axes=in_axes)
    if mesh is None:
        return mapped
    specs = tuple(PartitionSpec() if axis is None else PartitionSpec(AXIS) for axis in in_axes)
    return jax.shard_map(mapped, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False)


def check_divisible(environments: int, mesh: Mesh | None) -> None:
    """Make sure that devices get equally many environments.

    Raises:
      ValueError: if they do not.
    """
    if mesh is not None and environments % mesh.size:
        raise ValueError(f"{environments} environments cannot be divided among {mesh.size} devices; give a multiple")


def shardings(tree: Any, sharding: NamedSharding) -> Any:
    """A pytree that says the same of every leaf of `tree`."""
    return jax.tree.map(lambda _: sharding, tree)
