"""A long short-term memory over whole sequences, with a backward pass that is fast on small batches."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array


class Memory(NamedTuple):
    """What an LSTM remembers from one time step to the next."""

    hidden: Array
    """`[batch, size]`."""
    cell: Array
    """`[batch, size]`."""


class _Saved(NamedTuple):
    """What the backward pass needs of the forward pass."""

    kernel: Array
    reset: Array
    gates: Array
    """`[time, batch, 4, size]`, after their nonlinearities."""
    hidden: Array
    """`[time, batch, size]`, before each time step and after its reset."""
    cell: Array
    """`[time, batch, size]`, likewise."""
    next_cell: Array
    """`[time, batch, size]`, after each time step."""


@jax.custom_vjp
def lstm(kernel: Array, projected: Array, reset: Array, memory: Memory) -> tuple[Memory, Array]:
    """Run a layer over a sequence (Hochreiter and Schmidhuber, 1997, with a forget gate).

    With i, f, g, o = σ, σ, tanh, σ of `projected` + h `kernel`: c ← f c + i g, h ← o tanh(c).

    The derivative is written by hand: that of the kernel is one product over all time steps, where automatic
    differentiation would add to it at each of them, and the loop is left with a single product and few other
    operations.

    Args:
      kernel: `[size, 4 size]`, recurrent weights, gates in the order i, f, g, o.
      projected: `[time, batch, 4 size]`, inputs times their weights, plus the biases.
      reset: `[time, batch]`, whether the memory is zeroed before a time step.
      memory: before the first time step.

    Returns:
      The memory after the last time step, and `[time, batch, size]`, the hidden values after every one.
    """
    return _forward(kernel, projected, reset, memory)[0]


def _forward(kernel: Array, projected: Array, reset: Array, memory: Memory) -> tuple[tuple[Memory, Array], _Saved]:
    size = kernel.shape[0]

    def step(memory: Memory, inputs: tuple[Array, Array]) -> tuple[Memory, tuple[Array, ...]]:
        projected, reset = inputs
        hidden, cell = (_unless(reset, part) for part in memory)
        before = (projected + hidden @ kernel).reshape(*hidden.shape[:-1], 4, size)
        write, keep, read = (jax.nn.sigmoid(before[..., gate, :]) for gate in (0, 1, 3))
        value = jnp.tanh(before[..., 2, :])
        next_cell = keep * cell + write * value
        after = Memory(read * jnp.tanh(next_cell), next_cell)
        return after, (after.hidden, before, hidden, cell, next_cell)

    last, (outputs, before, hidden, cell, next_cell) = jax.lax.scan(step, memory, (projected, reset))
    is_value = (jnp.arange(4) == 2)[:, None]
    gates = jnp.where(is_value, jnp.tanh(before), jax.nn.sigmoid(before))
    return (last, outputs), _Saved(kernel, reset, gates, hidden, cell, next_cell)


def _backward(saved: _Saved, gradients: tuple[Memory, Array]) -> tuple[Array, Array, None, Memory]:
    last, outputs = gradients
    kernel, reset, size = saved.kernel.T, saved.reset, saved.kernel.shape[0]
    write, keep, value, read = (saved.gates[..., gate, :] for gate in range(4))
    squashed = jnp.tanh(saved.next_cell)
    # Everything that does not depend on later time steps is found for all of them at once.
    cell_of_hidden = read * (1.0 - squashed**2)
    gate_factors = jnp.stack(
        [
            value * write * (1.0 - write),
            saved.cell * keep * (1.0 - keep),
            write * (1.0 - value**2),
            squashed * read * (1.0 - read),
        ],
        axis=-2,
    )
    is_read = (jnp.arange(4) == 3)[:, None]

    def step(memory: Memory, inputs: tuple[Array, ...]) -> tuple[Memory, Array]:
        outputs, reset, keep, cell_of_hidden, gate_factors = inputs
        hidden = memory.hidden + outputs
        cell = memory.cell + hidden * cell_of_hidden
        before = gate_factors * jnp.where(is_read, hidden[..., None, :], cell[..., None, :])
        before = before.reshape(*hidden.shape[:-1], 4 * size)
        return Memory(_unless(reset, before @ kernel), _unless(reset, cell * keep)), before

    first, before = jax.lax.scan(step, last, (outputs, reset, keep, cell_of_hidden, gate_factors), reverse=True)
    of_kernel = jnp.einsum("tbh,tbg->hg", saved.hidden, before)
    return of_kernel, before, None, first


def _unless(reset: Array, values: Array) -> Array:
    """Zeros where `reset` holds: a product would let values through that are not finite."""
    return jnp.where(reset[..., None], 0.0, values)


lstm.defvjp(_forward, _backward)
