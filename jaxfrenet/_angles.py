"""Angles without full turns."""

from __future__ import annotations

import jax.numpy as jnp

from jaxfrenet._typing import Array


def wrapped(angle: Array) -> Array:
    """The angle [rad] without full turns, in [-π, π]."""
    return angle - 2 * jnp.pi * jnp.round(angle / (2 * jnp.pi))
