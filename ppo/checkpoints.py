"""Checkpoints of training states that survive kills, full disks and damaged files."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from jax.experimental import multihost_utils

T = TypeVar("T")

OnSkip = Callable[[Path, str], None]
"""Is told of a checkpoint that cannot be used, and why."""


class CheckpointError(OSError):
    """Checkpoints cannot be written, or none of those that are there can be read; the message is one line."""


class Checkpoints:
    """A folder of checkpoints, the newest `keep` of them.

    A checkpoint gets its final name when it is complete, and older ones are removed after that: whenever the process is
    killed, the last complete one is there. Each has a checksum of every leaf. With several processes all have to make
    the same calls, on a folder that all of them see.
    """

    def __init__(self, folder: Path | str, keep: int = 3) -> None:
        self.folder, self.keep = Path(folder).absolute(), keep

    def steps(self) -> list[int]:
        """Steps of which there are complete checkpoints, in order."""
        if not self.folder.is_dir():
            return []
        names = (path.name for path in self.folder.iterdir() if path.is_dir())
        return sorted(int(name) for name in names if name.isdecimal())

    def save(self, step: int, state: Any) -> None:
        """Write a state, and return when it is safe. A checkpoint of the same step is replaced.

        Args:
          step: by which checkpoints are ordered.
          state: a pytree of arrays; typed random keys are allowed, arrays may be spread over devices and processes.

        Raises:
          CheckpointError: if the folder cannot be written, for instance because the disk is full.
        """
        arrays = {name: _whole(leaf) for name, leaf in _named(state)}
        sums = {name: _describe(array) | {"crc32": _crc32(array)} for name, array in arrays.items()}
        stored = {name: array for name, array in arrays.items() if array.size}
        options = ocp.CheckpointManagerOptions(max_to_keep=self.keep, enable_async_checkpointing=False)
        try:
            with ocp.CheckpointManager(self.folder, options=options) as manager:
                if step in manager.all_steps():
                    manager.delete(step)
                content = ocp.args.Composite(state=ocp.args.StandardSave(stored), checksums=ocp.args.JsonSave(sums))
                manager.save(step, args=content, force=True)
        except Exception as error:  # the libraries below raise errors of many kinds
            raise CheckpointError(
                f"{self.folder}: the checkpoint of step {step} cannot be written: {_line(error)}"
            ) from error

    def restore(self, template: T, on_skip: OnSkip | None = None) -> tuple[T, int] | None:
        """Read the newest checkpoint that is whole.

        Args:
          template: a state of the same structure, shapes and types; what is read lies on the devices as it does.
          on_skip: is told of newer ones that cannot be used.

        Returns:
          The state and its step, or None if there are no checkpoints.

        Raises:
          CheckpointError: if there are some, but none can be used.
        """
        steps, reason = self.steps(), ""
        for step in reversed(steps):
            try:
                return self._read(step, template), step
            except Exception as error:  # whatever a damaged file makes the libraries below raise
                reason = _line(error)
                if on_skip is not None:
                    on_skip(self.folder / str(step), reason)
        if steps:
            raise CheckpointError(
                f"{self.folder}: none of its {len(steps)} checkpoints can be used; the oldest: {reason}"
            )
        return None

    def _read(self, step: int, template: T) -> T:
        expected = {name: _describe(_data(leaf)) for name, leaf in _named(template)}
        restored, folder = ocp.args.Composite, self.folder / str(step)
        with ocp.Checkpointer(ocp.CompositeCheckpointHandler()) as reader:
            sums = reader.restore(folder, args=restored(checksums=ocp.args.JsonRestore()))["checksums"]
            _compare(expected, sums)
            stored = reader.restore(folder, args=restored(state=ocp.args.StandardRestore(_blank(expected))))["state"]

        def find(path: tuple[Any, ...], leaf: Any) -> Any:
            name = _name(path)
            array = np.asarray(stored[name]) if name in stored else np.zeros(**expected[name])
            if _crc32(array) != sums[name]["crc32"]:
                raise CheckpointError(f"{name} is damaged: its checksum is not the one that was written")
            return _placed(array, leaf)

        return jax.tree_util.tree_map_with_path(find, template)


def _named(tree: Any) -> list[tuple[str, Any]]:
    return [(_name(path), leaf) for path, leaf in jax.tree.leaves_with_path(tree)]


def _name(path: tuple[Any, ...]) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/")


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _data(leaf: Any) -> Any:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _whole(leaf: Any) -> np.ndarray:
    """The leaf on the host, all parts of all processes."""
    data = _data(leaf)
    if isinstance(data, jax.Array) and not data.is_fully_addressable:
        data = multihost_utils.process_allgather(data, tiled=True)
    return np.asarray(data)


def _placed(array: np.ndarray, leaf: Any) -> Any:
    """The array where `leaf` is; as free to move as that, so that what is compiled for one does for the other."""
    if not isinstance(leaf, jax.Array):
        return array
    if _data(leaf).committed:
        data = jax.make_array_from_callback(array.shape, leaf.sharding, lambda index: array[index])
    else:
        data = jnp.asarray(array)
    return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf)) if _is_key(leaf) else data


def _describe(leaf: Any) -> dict[str, Any]:
    return {"shape": list(leaf.shape), "dtype": str(np.dtype(leaf.dtype))}


def _crc32(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).tobytes())


def _blank(expected: dict[str, Any]) -> dict[str, np.ndarray]:
    """Arrays of what is stored: all that are not empty."""
    return {name: np.zeros(**entry) for name, entry in expected.items() if 0 not in entry["shape"]}


def _compare(expected: dict[str, Any], found: dict[str, Any]) -> None:
    """Make sure that a checkpoint has the leaves that are expected."""
    for name in [*expected, *found]:
        has, wants = found.get(name), expected.get(name)
        if has is None or wants is None:
            raise CheckpointError(f"it is of another state: {name} is only in {'this' if has else 'the current'} one")
        if (has["shape"], has["dtype"]) != (wants["shape"], wants["dtype"]):
            raise CheckpointError(
                f"it is of another state: {name} is {has['dtype']}{has['shape']}, not {wants['dtype']}{wants['shape']}"
            )


def _line(error: Exception) -> str:
    """The first line of what an error says."""
    return (str(error).splitlines() or [type(error).__name__])[0]
