"""Training goes on from checkpoints, whatever happened to them."""

from __future__ import annotations

import resource
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from saving_loop import state_of

import ppo


@pytest.fixture(scope="module")
def saved(tmp_path_factory, unbroken) -> Path:
    """A folder with checkpoints after 1, 2 and 3 updates, not to be changed."""
    folder = tmp_path_factory.mktemp("saved")
    for step, (state, _) in enumerate(unbroken[:3], start=1):
        ppo.Checkpoints(folder).save(step, state)
    return folder


@pytest.fixture
def copy(saved, tmp_path) -> Path:
    """The same, to be changed."""
    return shutil.copytree(saved, tmp_path / "checkpoints")


def restored(folder: Path, template: Any, on_skip: Callable[[Path, str], None] | None = None) -> tuple[Any, int]:
    found = ppo.Checkpoints(folder).restore(template, on_skip)
    assert found is not None
    return found


def test_training_goes_on_bit_for_bit(saved, start, unbroken, update_once, assert_equal):
    state, step = restored(saved, start)
    assert step == 3
    assert_equal(state, unbroken[2][0])
    assert_equal(update_once(state), unbroken[3])


def test_only_the_newest_are_kept(tmp_path, start):
    checkpoints = ppo.Checkpoints(tmp_path / "new" / "folder", keep=2)
    assert checkpoints.restore(start) is None and checkpoints.steps() == []
    for step in (3, 20, 100):
        checkpoints.save(step, {"step": jnp.int32(step)})
    assert checkpoints.steps() == [20, 100]
    checkpoints.save(100, {"step": jnp.int32(7)})
    state, _ = restored(checkpoints.folder, {"step": jnp.int32(0)})
    assert int(state["step"]) == 7


def largest(folder: Path) -> Path:
    return max((path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)


def cut(folder: Path) -> None:
    with largest(folder).open("r+b") as file:
        file.truncate(largest(folder).stat().st_size // 2)


def flip(folder: Path) -> None:
    content = bytearray(largest(folder).read_bytes())
    content[len(content) // 2] ^= 0xFF
    largest(folder).write_bytes(content)


def remove(folder: Path) -> None:
    largest(folder).unlink()


def garbage(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_file():
            path.write_bytes(b"garbage")


def empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def no_checksums(folder: Path) -> None:
    shutil.rmtree(folder / "checksums")


@pytest.mark.parametrize("damage", [cut, flip, remove, garbage, empty, no_checksums])
def test_a_damaged_checkpoint_is_skipped(copy, start, unbroken, assert_equal, damage):
    damage(copy / "3")
    skipped = []
    state, step = restored(copy, start, lambda path, reason: skipped.append((path, reason)))
    assert step == 2
    assert_equal(state, unbroken[1][0])
    ((path, reason),) = skipped
    assert path == copy / "3" and reason and "\n" not in reason
    ppo.Checkpoints(copy).save(3, unbroken[2][0])
    assert restored(copy, start)[1] == 3


def test_other_values_under_the_same_names_are_noticed(copy, start):
    shutil.rmtree(copy / "3" / "state")
    shutil.copytree(copy / "2" / "state", copy / "3" / "state")
    skipped = []
    _, step = restored(copy, start, lambda path, reason: skipped.append(reason))
    assert step == 2 and "damaged: its checksum" in skipped[0]


def test_no_usable_checkpoint_is_an_error(copy, start):
    wider = start.actors.observation[:, :2]
    other = {"a": jnp.zeros(3)}
    with pytest.raises(ppo.CheckpointError, match="none of its 3 checkpoints can be used.*another state"):
        ppo.Checkpoints(copy).restore(other)
    narrow = jax.tree.map(lambda leaf: wider if leaf is start.actors.observation else leaf, start)
    with pytest.raises(ppo.CheckpointError, match=r"actors/observation is float32\[8, 3\], not float32\[8, 2\]"):
        ppo.Checkpoints(copy).restore(narrow)


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path, start):
    (tmp_path / "file").write_text("")
    with pytest.raises(ppo.CheckpointError, match="checkpoint of step 1 cannot be written"):
        ppo.Checkpoints(tmp_path / "file" / "folder").save(1, start)


def test_a_full_disk_is_an_error_and_harms_nothing(tmp_path):
    checkpoints = ppo.Checkpoints(tmp_path / "full")
    checkpoints.save(1, state_of(1))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(ppo.CheckpointError, match="checkpoint of step 2 cannot be written"):
            checkpoints.save(2, state_of(2))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert restored(checkpoints.folder, state_of(0))[1] == 1
    checkpoints.save(2, state_of(2))
    assert restored(checkpoints.folder, state_of(0))[1] == 2


def test_kills_while_saving_leave_the_last_checkpoint(tmp_path, start_program):
    folder, saved = tmp_path / "checkpoints", 0
    for delay in (0.0, 0.013, 0.05):
        process = start_program("saving_loop.py", folder)
        try:
            for _ in range(3):
                line = process.stdout.readline()
                assert line, process.stderr.read()
                saved = int(line)
            time.sleep(delay)
        finally:
            process.kill()
            process.wait()
        state, step = restored(folder, state_of(0))
        assert step >= saved
        jax.tree.map(np.testing.assert_array_equal, state, state_of(step))
    assert saved >= 9
