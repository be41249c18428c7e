"""What functions give does not depend on how they are compiled, in batches and batches of batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfrenet._compilation import computed_once, in_parts, merging_batches


def digits(x: jax.Array, factor: jax.Array) -> dict[str, jax.Array]:
    return {"sum": jnp.sum(jnp.sin(x)) * factor, "each": jnp.cos(x) + factor}


VALUES = jnp.asarray(np.random.default_rng(0).normal(size=(7, 3, 5)), jnp.float32)
FACTORS = jnp.arange(7, dtype=jnp.float32)


def assert_same(got, expected):
    for mine, other in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-6)


def test_computed_once_is_the_function():
    plain = jax.vmap(digits)(VALUES, FACTORS)
    assert_same(jax.jit(jax.vmap(computed_once(digits)))(VALUES, FACTORS), plain)
    twice = computed_once(lambda x: computed_once(jnp.sin)(x) ** 2)
    assert_same(jax.jit(twice)(VALUES), jnp.sin(VALUES) ** 2)


def test_computed_once_is_a_call_of_its_own_on_cpus():
    if jax.default_backend() != "cpu":
        pytest.skip("elsewhere it is the function itself")

    def spread(rows: jax.Array, apart: bool) -> jax.Array:
        sines = computed_once(jnp.sin)(rows) if apart else jnp.sin(rows)
        return sines[:, None] * rows[None]

    programs = [jax.jit(spread, static_argnums=1).lower(VALUES[:, 0], apart).compile().as_text() for apart in (0, 1)]
    assert [" call(" in (program or "") for program in programs] == [False, True]


@pytest.mark.parametrize("largest", [1, 2, 3, 4, 6, 7, 100])
def test_in_parts_is_the_function(largest):
    divided = in_parts(digits, largest)
    assert_same(jax.jit(divided)(VALUES[0], FACTORS[1]), digits(VALUES[0], FACTORS[1]))
    assert_same(jax.vmap(divided)(VALUES, FACTORS), jax.vmap(digits)(VALUES, FACTORS))
    shared = jax.vmap(divided, in_axes=(0, None))(VALUES, FACTORS[2])
    assert_same(shared, jax.vmap(digits, in_axes=(0, None))(VALUES, FACTORS[2]))
    nested = jax.vmap(jax.vmap(divided, in_axes=(0, None)))(VALUES, FACTORS)
    assert_same(nested, jax.vmap(jax.vmap(digits, in_axes=(0, None)))(VALUES, FACTORS))


def test_merged_batches_see_all_elements_at_once():
    """Each element gets the whole batch's largest value: 7 and 21 elements are one batch, a single one is its own."""
    sizes = []

    def share_of_largest(values: jax.Array, factor: jax.Array) -> jax.Array:
        sizes.append(len(values))
        return values * factor[:, None] / jnp.max(values)

    merged = merging_batches(share_of_largest)
    one = jnp.float32(2.0)
    assert_same(merged(VALUES[0, 0], one), 2.0 * VALUES[0, 0] / VALUES[0, 0].max())
    flat = jax.vmap(merged, in_axes=(0, None))(VALUES[:, 0], one)
    assert_same(flat, 2.0 * VALUES[:, 0] / VALUES[:, 0].max())
    nested = jax.vmap(jax.vmap(merged, in_axes=(0, None)))(VALUES, FACTORS)
    assert_same(nested, VALUES * FACTORS[:, None, None] / VALUES.max())
    assert sizes[-1] == 21 and 7 in sizes and 1 in sizes
