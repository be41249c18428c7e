"""Which devices and processes train."""

from __future__ import annotations

import os
import re

import jax
from jax.experimental import multihost_utils
from jax.sharding import Mesh

import ppo
from experiments._presets import Preset
from experiments._training_options import TrainOptions
from scenarios.command_line import UserError

THREADS_PER_DEVICE = 4
"""Threads for each device that a CPU is divided into."""


def provide_threads() -> None:
    """Have threads enough where a CPU is divided into several devices; before anything is computed.

    XLA has as many threads as there are cores for all devices of a CPU together. While one device waits in a thread for
    the others, these may find none left to go on in, and training stands still for ever. `NPROC` is how XLA is told.
    """
    flag = re.search(r"xla_force_host_platform_device_count=(\d+)", os.environ.get("XLA_FLAGS", ""))
    devices = int(flag[1]) if flag else 1
    if devices > 1:
        os.environ.setdefault("NPROC", str(max(os.cpu_count() or 1, THREADS_PER_DEVICE * devices)))


def start_processes(options: TrainOptions) -> None:
    """Join the other processes, if there are any; before anything is computed.

    Raises:
      UserError: they cannot be joined.
    """
    if not options.distributed:
        return
    try:
        jax.distributed.initialize(options.coordinator, options.processes, options.process)
    except (ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"--distributed: {reason}; give --coordinator, --processes and --process") from None
    multihost_utils.sync_global_devices("begun")


def shared_mesh(options: TrainOptions, preset: Preset) -> Mesh | None:
    """The devices that share the environments, None for a single one.

    Raises:
      UserError: there are not so many, or they cannot share the environments evenly.
    """
    every = jax.devices()
    count = len(every) if options.devices is None else options.devices
    if count > len(every):
        raise UserError(f"--devices {count}: there are {len(every)}")
    if count == 1:
        return None
    if options.seeds > 1:
        raise UserError(f"--seeds {options.seeds} runs on one device; add --devices 1")
    if preset.ppo.environments % count:
        raise UserError(f"--devices {count}: cannot share {preset.ppo.environments} environments evenly")
    return ppo.environment_mesh(every[:count])
