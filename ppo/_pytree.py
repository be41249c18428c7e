"""Frozen dataclasses whose fields are the leaves of a pytree."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax

T = TypeVar("T")


def static_field() -> Any:
    """A field that belongs to the structure of the tree: hashable, constant under `jit`."""
    return dataclasses.field(metadata={"static": True})


@dataclass_transform(frozen_default=True, field_specifiers=(static_field,))
def pytree_dataclass(cls: type[T]) -> type[T]:
    """Make `cls` a frozen dataclass and register it as a pytree; every field is a child but those that are static."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))
