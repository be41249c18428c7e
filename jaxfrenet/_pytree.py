"""Frozen dataclasses whose fields are the leaves of a pytree."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def pytree_dataclass(cls: type[T]) -> type[T]:
    """Make `cls` a frozen dataclass and register it as a pytree, every field a child.

    Unflattening does not call `__init__`: JAX rebuilds containers around placeholders (axes of `vmap`, `None`,
    strings), which annotations that are checked in tests would refuse.
    """
    data_class = dataclasses.dataclass(frozen=True)(cls)
    names = tuple(field.name for field in dataclasses.fields(data_class))  # pyright: ignore[reportArgumentType]

    def flatten_with_keys(instance: Any):
        return tuple((jax.tree_util.GetAttrKey(name), getattr(instance, name)) for name in names), None

    def flatten(instance: Any):
        return tuple(getattr(instance, name) for name in names), None

    def unflatten(_: None, children):
        instance = object.__new__(data_class)
        for name, child in zip(names, children, strict=True):
            object.__setattr__(instance, name, child)
        return instance

    jax.tree_util.register_pytree_with_keys(data_class, flatten_with_keys, unflatten, flatten)
    return data_class
