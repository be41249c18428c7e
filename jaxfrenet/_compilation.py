"""How a function becomes part of a compiled program."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
R = TypeVar("R")


def computed_once(function: Callable[P, R], static_argnums: tuple[int, ...] = ()) -> Callable[P, R]:
    """The function, with results that are stored before anything uses them.

    XLA otherwise merges cheap-looking work into each place that reads it. On CPUs it does so even where every element
    is read many times, and computes it as often.
    """

    def inlined_within(*arguments: P.args, **named: P.kwargs) -> R:
        with set_xla_metadata(inlineable="true"):
            return function(*arguments, **named)

    compiled = jax.jit(inlined_within, static_argnums=static_argnums)

    @functools.wraps(function)
    def apart(*arguments: P.args, **named: P.kwargs) -> R:
        if jax.default_backend() != "cpu":
            return function(*arguments, **named)
        with set_xla_metadata(inlineable="false"):
            return compiled(*arguments, **named)

    return apart


def merging_batches(function: Callable[..., R]) -> Callable[..., R]:
    """A function of batches, for single elements, such that `vmap` makes the batch larger.

    Under plain `vmap`, a loop that runs for as long as there is work makes every element wait for the one with the
    most. A function of the whole batch can share the work out; so the rule for a new batch axis is to merge it with
    the axis that is there.

    Args:
      function: takes and gives pytrees of arrays, each with a leading batch axis.
    """
    batched_function = jax.custom_batching.custom_vmap(function)

    @batched_function.def_vmap
    def merge_axes(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        def merged(leaf: jax.Array, is_batched: bool) -> jax.Array:
            leaf = leaf if is_batched else jnp.broadcast_to(leaf, (size, *leaf.shape))
            return leaf.reshape(-1, *leaf.shape[2:])

        result = batched_function(*jax.tree.map(merged, arguments, tuple(batched)))
        result = jax.tree.map(lambda leaf: leaf.reshape(size, -1, *leaf.shape[1:]), result)
        return result, jax.tree.map(lambda _: True, result)

    def single(*arguments: Any) -> R:
        batch_of_one = batched_function(*jax.tree.map(lambda leaf: leaf[None], arguments))
        return jax.tree.map(lambda leaf: leaf[0], batch_of_one)

    return single


def in_parts(function: Callable[..., R], largest: int) -> Callable[..., R]:
    """The function, of which `vmap` computes at most `largest` at a time on CPUs.

    A whole batch's intermediate results leave the processor's caches and are new memory to the system each time, which
    takes longer than the work itself. Arguments are pytrees of arrays, by position.
    """
    single = jax.custom_batching.custom_vmap(function)

    @single.def_vmap
    def batch(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        together = jax.vmap(function, in_axes=jax.tree.map(lambda is_batched: 0 if is_batched else None, batched))
        parts = -(-size // largest)
        if parts == 1 or jax.default_backend() != "cpu":
            result = together(*arguments)
        else:
            each = -(-size // parts)
            start = jnp.minimum(jnp.arange(parts) * each, size - each)
            result = jax.lax.map(lambda at: together(*_cut(arguments, batched, at, each)), start)
            result = jax.tree.map(lambda leaf: _join(leaf, size), result)
        return result, jax.tree.map(lambda _: True, result)

    return single


def _cut(arguments: Any, batched: Any, start: jax.Array, size: int) -> Any:
    """`size` elements of the batch from `start` on."""

    def cut(leaf: jax.Array, is_batched: bool) -> jax.Array:
        return jax.lax.dynamic_slice_in_dim(leaf, start, size) if is_batched else leaf

    return tuple(jax.tree.map(cut, *pair) for pair in zip(arguments, batched, strict=True))


def _join(leaf: jax.Array, size: int) -> jax.Array:
    """A batch of `size` from its parts `[parts, each, ...]`, the last of which begins inside the one before."""
    parts, each = leaf.shape[:2]
    first = leaf[:-1].reshape((parts - 1) * each, *leaf.shape[2:])
    return jnp.concatenate([first, leaf[-1, parts * each - size :]])
