"""A policy by itself: networks with all they need to act, in memory and in files."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ppo import networks
from ppo._pytree import pytree_dataclass, static_field
from ppo.config import NetworkConfig
from ppo.networks import Carry, Parameters, PolicyOutput
from ppo.normalization import RunningMoments, initial_moments, normalize

ARRAYS, DESCRIPTION = "policy.npz", "policy.json"
"""Files of a policy's folder."""
FORMAT = 1
"""Version of these files."""


class PolicyError(ValueError):
    """A folder holds no policy that can be used; the message is one line."""


@pytree_dataclass
class Policy:
    """Networks and the scales of what goes in and comes out."""

    parameters: Parameters
    moments: RunningMoments
    """Of observations."""
    return_std: Array
    """`[]`, what rewards were divided by when values were learned."""
    network: NetworkConfig = static_field()
    normalize_observations: bool = static_field()
    observation_clip: float = static_field()
    """Bound of normalised observations."""
    observation_floor: float = static_field()
    """Least standard deviation, as it were, that they are divided by."""


def normalized(policy: Policy, observation: Array) -> Array:
    """What the networks see of `[..., observation_size]`."""
    if not policy.normalize_observations:
        return observation
    return normalize(policy.moments, observation, policy.observation_clip, policy.observation_floor)


def initial_carry(policy: Policy, batch_shape: tuple[int, ...]) -> Carry:
    """What the policy remembers before an episode."""
    return networks.initial_carry(policy.network, batch_shape)


def outputs(policy: Policy, carry: Carry, observation: Array, reset: Array) -> tuple[Carry, PolicyOutput]:
    """One time step of the networks.

    Args:
      policy: the policy.
      carry: what it remembers.
      observation: `[batch, observation_size]`, as the environment gives it.
      reset: `[batch]` bool, whether an episode begins.

    Returns:
      What it remembers then, and what it says; values are in units of scaled rewards.
    """
    seen = normalized(policy, observation)
    return networks.apply_one(policy.network, policy.parameters, carry, seen, reset)


def act(policy: Policy, carry: Carry, observation: Array, reset: Array) -> tuple[Carry, Array]:
    """The mean action `[batch, action_size]`, not clipped; arguments as for `outputs`."""
    carry, output = outputs(policy, carry, observation, reset)
    return carry, output.mean


def value(policy: Policy, carry: Carry, observation: Array, reset: Array) -> tuple[Carry, Array]:
    """The expected discounted return `[batch]` in the environment's own units; arguments as for `outputs`."""
    carry, output = outputs(policy, carry, observation, reset)
    return carry, output.value * policy.return_std


def average_policies(policies: Sequence[Policy]) -> Policy:
    """The mean of policies' parameters; all else is the last one's.

    Among policies of one run that are not far apart it averages out much of the noise of learning (Izmailov et al.
    2018, stochastic weight averaging).

    Raises:
      PolicyError: there is none, or their networks differ.
    """
    if not policies:
        raise PolicyError("no policy to average; name at least one")
    last = policies[-1]
    for one in policies:
        shapes = [jax.tree.map(jnp.shape, each.parameters) for each in (one, last)]
        if one.network != last.network or shapes[0] != shapes[1]:
            raise PolicyError("policies to average have different networks; name some of one run")
    mean = jax.tree.map(lambda *leaves: sum(leaves[1:], leaves[0]) / len(leaves), *(one.parameters for one in policies))
    return replace(last, parameters=mean)


def save_policy(folder: Path | str, policy: Policy, description: dict[str, Any] | None = None) -> None:
    """Write `policy.npz` (arrays) and `policy.json` (all else) into a folder, which is replaced if there is one.

    The folder appears under its name when it is complete.

    Args:
      folder: to write.
      policy: to keep.
      description: whatever is to be known about it and can be written as JSON; `load_policy` compares what stands
        under `observation_names` and `action_names`.
    """
    folder = Path(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "format": FORMAT,
        "observation_size": int(policy.moments.mean.shape[0]),
        "action_size": int(policy.parameters["log_std"].shape[0]),
        "network": asdict(policy.network),
        "normalize_observations": policy.normalize_observations,
        "observation_clip": policy.observation_clip,
        "observation_floor": policy.observation_floor,
        "description": description or {},
    }
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        new, old = temporary / "new", temporary / "old"
        new.mkdir()
        np.savez(new / ARRAYS, allow_pickle=False, **_named_arrays(policy))
        (new / DESCRIPTION).write_text(json.dumps(content, indent=1) + "\n")
        if folder.exists():
            os.rename(folder, old)
        os.rename(new, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def load_policy(
    folder: Path | str,
    observation_names: Sequence[str] | None = None,
    action_names: Sequence[str] | None = None,
) -> tuple[Policy, dict[str, Any]]:
    """Read what `save_policy` wrote.

    Args:
      folder: that was written.
      observation_names: what the elements of observations are where the policy is to be used.
      action_names: likewise of actions.

    Returns:
      The policy and its description.

    Raises:
      PolicyError: if the folder or a file is missing or broken, or if the names are others than in the description.
    """
    folder = Path(folder)
    content = _read_description(folder)
    description = content["description"]
    for kind, expected in (("observation", observation_names), ("action", action_names)):
        if expected is not None:
            _compare_names(folder, kind, description.get(f"{kind}_names"), expected)
    try:
        shape = _shape(content)
    except (KeyError, TypeError, ValueError) as error:
        raise PolicyError(f"{folder / DESCRIPTION}: does not describe a policy ({_line(error)})") from error
    arrays = _read_arrays(folder / ARRAYS)
    return jax.tree.map(jnp.asarray, _filled(folder / ARRAYS, shape, arrays)), description


def _named_arrays(policy: Policy) -> dict[str, np.ndarray]:
    return {_name(path): np.asarray(leaf) for path, leaf in jax.tree.leaves_with_path(policy)}


def _name(path: tuple[Any, ...]) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/")


def _read_description(folder: Path) -> dict[str, Any]:
    file = folder / DESCRIPTION
    if not folder.is_dir():
        raise PolicyError(f"{folder}: there is no such folder; name one that training wrote")
    try:
        content = json.loads(file.read_text())
    except FileNotFoundError as error:
        raise PolicyError(f"{folder}: has no {DESCRIPTION}; name a folder that holds a policy") from error
    except (OSError, ValueError) as error:
        raise PolicyError(f"{file}: cannot be read ({_line(error)})") from error
    if not isinstance(content, dict) or not isinstance(content.get("description"), dict):
        raise PolicyError(f"{file}: does not describe a policy")
    if content.get("format") != FORMAT:
        raise PolicyError(f"{file}: has format {content.get('format')}, this version reads format {FORMAT}")
    return content


def _read_arrays(file: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError as error:
        raise PolicyError(f"{file.parent}: has no {file.name}; name a folder that holds a policy") from error
    except (OSError, ValueError, EOFError, KeyError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise PolicyError(f"{file}: cannot be read ({_line(error)})") from error


def _shape(content: dict[str, Any]) -> Policy:
    """A policy of shapes and types, as the description says."""
    network = NetworkConfig(**content["network"])
    observation_size, action_size = int(content["observation_size"]), int(content["action_size"])

    def make() -> Policy:
        parameters = networks.init(network, jax.random.key(0), observation_size, action_size, 1.0)
        return Policy(
            parameters=parameters,
            moments=initial_moments((observation_size,)),
            return_std=jnp.float32(1.0),
            network=network,
            normalize_observations=bool(content["normalize_observations"]),
            observation_clip=float(content["observation_clip"]),
            observation_floor=float(content["observation_floor"]),
        )

    return jax.eval_shape(make)


def _filled(file: Path, shape: Policy, arrays: dict[str, np.ndarray]) -> Policy:
    def find(path: tuple[Any, ...], leaf: jax.ShapeDtypeStruct) -> np.ndarray:
        name = _name(path)
        if name not in arrays:
            raise PolicyError(f"{file}: has no array {name}; its {DESCRIPTION} belongs to another policy")
        found = arrays[name]
        if found.shape != leaf.shape or found.dtype != leaf.dtype:
            raise PolicyError(
                f"{file}: {name} is {found.dtype}{list(found.shape)}, but its {DESCRIPTION} says "
                f"{leaf.dtype}{list(leaf.shape)}"
            )
        return found

    return jax.tree_util.tree_map_with_path(find, shape)


def _compare_names(folder: Path, kind: str, found: Any, expected: Sequence[str]) -> None:
    if not isinstance(found, list):
        raise PolicyError(f"{folder / DESCRIPTION}: does not name the elements of its {kind}s; train the policy again")
    for index in range(max(len(found), len(expected))):
        has = found[index] if index < len(found) else None
        wants = expected[index] if index < len(expected) else None
        if has != wants:
            raise PolicyError(
                f"{folder}: element {index} of the policy's {kind}s is {has or 'missing'}, here it is "
                f"{wants or 'none'}; use the settings that the policy was trained with, or train it again"
            )


def _line(error: Exception) -> str:
    """The first line of what an error says."""
    return (str(error).splitlines() or [type(error).__name__])[0]
