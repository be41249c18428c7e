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
    """Make `cls` a frozen dataclass and register it as a pytree; every field is a child but those that are static.

    Unflattening does not call `__init__`: JAX rebuilds containers around placeholders (axes of `vmap`, `None`,
    strings), which annotations that are checked in tests would refuse.
    """
    data_class = dataclasses.dataclass(frozen=True)(cls)
    fields = dataclasses.fields(data_class)  # pyright: ignore[reportArgumentType]
    names = tuple(field.name for field in fields if not field.metadata.get("static"))
    static = tuple(field.name for field in fields if field.metadata.get("static"))

    def flatten_with_keys(instance: Any):
        children, structure = flatten(instance)
        return tuple(zip(map(jax.tree_util.GetAttrKey, names), children, strict=True)), structure

    def flatten(instance: Any):
        return tuple(getattr(instance, name) for name in names), tuple(getattr(instance, name) for name in static)

    def unflatten(structure: tuple[Any, ...], children):
        instance = object.__new__(data_class)
        for name, value in (*zip(names, children, strict=True), *zip(static, structure, strict=True)):
            object.__setattr__(instance, name, value)
        return instance

    jax.tree_util.register_pytree_with_keys(data_class, flatten_with_keys, unflatten, flatten)
    return data_class
