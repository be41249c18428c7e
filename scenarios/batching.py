"""Scenarios of different sizes become one batch: padded, then stacked on a new leading axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike

import jaxfrenet as jf
from scenarios.errors import ScenarioError

AXES: dict[str, tuple[str, ...]] = {
    "path.arc_length": ("nodes",),
    "path.x": ("nodes",),
    "path.y": ("nodes",),
    "path.heading": ("nodes",),
    "path.curvature": ("nodes",),
    "path.curvature_derivative": ("nodes",),
    "path.length": (),
    "lanes.center": ("nodes", ""),
    "lanes.width": ("nodes", ""),
    "lanes.direction": ("nodes", ""),
    "lane_map.center": ("pieces", "", ""),
    "lane_map.length": ("pieces",),
    "lane_map.successors": ("pieces", ""),
    "lane_map.valid": ("pieces",),
    "road.segments": ("segments", "", ""),
    "road.valid": ("segments",),
    "road.nearby": ("bins", "nearby"),
    "obstacles.position": ("obstacles", "steps", ""),
    "obstacles.heading": ("obstacles", "steps"),
    "obstacles.speed": ("obstacles", "steps"),
    "obstacles.valid": ("obstacles", "steps"),
    "obstacles.length": ("obstacles",),
    "obstacles.width": ("obstacles",),
    "obstacles.kind": ("obstacles",),
    "obstacles.static": ("obstacles",),
    "goal.edges": ("goals", "edges", "", ""),
    "goal.edge_valid": ("goals", "edges"),
    "goal.has_position": ("goals",),
    "goal.steps": ("goals", ""),
    "goal.speed": ("goals", ""),
    "goal.has_speed": ("goals",),
    "goal.heading": ("goals", ""),
    "goal.arc_length": ("goals", ""),
    "goal.valid": ("goals",),
    "initial_state.position": ("",),
    "initial_state.heading": (),
    "initial_state.speed": (),
    "initial_state.acceleration": (),
    "initial_state.yaw_rate": (),
    "origin": ("",),
}
"""Each leaf of a scenario and the names of its axes; axes without a name have a fixed size."""

FILL: dict[str, float] = {
    "lane_map.length": 1.0,
    "lane_map.successors": -1,
    "road.nearby": -1,
    "obstacles.length": 1.0,
    "obstacles.width": 1.0,
}
"""What padding is made of where 0 or False will not do."""

PADDED_AXES = tuple(sorted({axis for axes in AXES.values() for axis in axes if axis}))


def leaves_of(scenario: jf.Scenario) -> dict[str, np.ndarray]:
    """The scenario's arrays by dotted name, as numpy arrays."""
    parts = {name: name.split(".") for name in AXES}
    return {name: np.asarray(_attribute(scenario, path)) for name, path in parts.items()}


def _attribute(instance: Any, path: list[str]) -> Any:
    for name in path:
        instance = getattr(instance, name)
    return instance


def device_array(values: ArrayLike) -> jax.Array:
    """The values on the default device; `jnp.asarray`, which compiles a program for each shape, takes far longer."""
    return values if isinstance(values, jax.Array) else jax.device_put(np.array(values))


def scenario_of(leaves: Mapping[str, ArrayLike]) -> jf.Scenario:
    """The inverse of `leaves_of`, with arrays on the default device."""

    def part(container: type, name: str) -> Any:
        prefix = f"{name}."
        return container(
            **{key.removeprefix(prefix): device_array(leaf) for key, leaf in leaves.items() if key.startswith(prefix)}
        )

    return jf.Scenario(
        path=part(jf.ReferencePath, "path"),
        lanes=part(jf.Lanes, "lanes"),
        lane_map=part(jf.LaneMap, "lane_map"),
        road=part(jf.Road, "road"),
        obstacles=part(jf.Obstacles, "obstacles"),
        goal=part(jf.Goal, "goal"),
        initial_state=part(jf.InitialState, "initial_state"),
        origin=device_array(leaves["origin"]),
    )


def sizes_of(scenario: jf.Scenario) -> dict[str, int]:
    """The sizes of the axes that padding can enlarge, `PADDED_AXES`."""
    return _sizes(leaves_of(scenario))


def _sizes(leaves: Mapping[str, np.ndarray]) -> dict[str, int]:
    return {
        axis: size for name, axes in AXES.items() for axis, size in zip(axes, leaves[name].shape, strict=True) if axis
    }


def rounded_up(size: int) -> int:
    """The next of 0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, ... that is not smaller: few sizes need few programs."""
    if size <= 2:
        return size
    power = 1 << (size - 1).bit_length()
    return 3 * power // 4 if size <= 3 * power // 4 else power


def pad_to(scenario: jf.Scenario, sizes: Mapping[str, int]) -> jf.Scenario:
    """Enlarge a scenario's arrays; what is added does not exist (`valid` is False) or continues the path straight.

    Args:
      scenario: one scenario, not a batch.
      sizes: new sizes of axes by name, see `sizes_of`; axes that are left out keep theirs.

    Raises:
      ScenarioError: a size is smaller than the scenario's, or names no axis.
    """
    return scenario_of(_padded(leaves_of(scenario), sizes))


def stack(scenarios: Sequence[jf.Scenario], pad: Mapping[str, int] | None = None) -> jf.Scenario:
    """A batch: every leaf padded to the largest size among the scenarios, with a new leading axis.

    Args:
      scenarios: at least one.
      pad: larger sizes of axes by name, see `sizes_of`; results do not depend on them.

    Raises:
      ScenarioError: there is no scenario, or `pad` is too small for one of them.
    """
    if not scenarios:
        raise ScenarioError("no scenario to stack; give at least one")
    every = [leaves_of(scenario) for scenario in scenarios]
    sizes = [_sizes(leaves) for leaves in every]
    common = {axis: max(size[axis] for size in sizes) for axis in PADDED_AXES} | dict(pad or {})
    padded = [_padded(leaves, common) for leaves in every]
    return scenario_of({name: np.stack([leaves[name] for leaves in padded]) for name in AXES})


def without_traffic(scenario: jf.Scenario) -> jf.Scenario:
    """One scenario, not a batch, with nobody else on the road."""
    obstacles = jax.tree.map(lambda leaf: leaf[:1], scenario.obstacles)
    nobody = replace(
        obstacles, valid=device_array(np.zeros(obstacles.valid.shape, bool)), static=device_array(np.zeros(1, bool))
    )
    return replace(scenario, obstacles=nobody, predictions=None)


def _padded(leaves: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> dict[str, np.ndarray]:
    own = _sizes(leaves)
    for axis, size in sizes.items():
        if axis not in own:
            raise ScenarioError(f"no axis {axis!r} to pad; the axes are {', '.join(PADDED_AXES)}")
        if size < own[axis]:
            raise ScenarioError(f"cannot pad {axis} to {size}: the scenario has {own[axis]}; give a larger size")
    wanted = own | dict(sizes)
    result = {}
    for name, axes in AXES.items():
        leaf = leaves[name]
        extra = [(0, wanted[axis] - own[axis] if axis else 0) for axis in axes]
        fill = np.asarray(FILL.get(name, 0)).astype(leaf.dtype)
        result[name] = np.pad(leaf, extra, constant_values=fill) if axes else leaf
    return result | _continued_path(leaves, wanted["nodes"])


def _continued_path(leaves: Mapping[str, np.ndarray], nodes: int) -> dict[str, np.ndarray]:
    """The path's tables prolonged straight along the last heading to that many nodes."""
    arc_length, heading = leaves["path.arc_length"], leaves["path.heading"]
    count = nodes - len(arc_length)
    along = (arc_length[-1] - arc_length[-2]) * np.arange(1, count + 1, dtype=arc_length.dtype)
    tables = {
        "path.arc_length": arc_length[-1] + along,
        "path.x": leaves["path.x"][-1] + along * np.cos(heading[-1]),
        "path.y": leaves["path.y"][-1] + along * np.sin(heading[-1]),
        "path.heading": np.full(count, heading[-1]),
    }
    return {name: np.concatenate([leaves[name], more]).astype(np.float32) for name, more in tables.items()}
