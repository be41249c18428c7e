"""The families of generated scenarios, by name, and sets of scenarios drawn from them.

Scenario number i of a seed is always the same one, however many are drawn with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

import jaxfrenet as jf
from jaxfrenet._typing import Array
from scenarios import crossing, highway, tjunction
from scenarios.collection import ScenarioSet
from scenarios.commonroad import ScenarioInfo
from scenarios.errors import ScenarioError
from scenarios.export import PROBLEM_ID, commonroad_document
from scenarios.lanelet_map import LaneletLinks, LaneletMap
from scenarios.sharing import share_equal

CHUNK = 64
"""Scenarios that are drawn at once, also where fewer are asked for: one program for every count."""
LARGEST_SEED = 2**32 - 1


class Family(NamedTuple):
    """A kind of scenario."""

    title: str
    """Its part of a scenario's name."""
    sample_with_map: Callable[[Array, Any], tuple[jf.Scenario, LaneletMap]]
    """Draws a scenario and its map from a key and a configuration."""
    links: tuple[LaneletLinks, ...]
    """How the map's lanelets hang together."""
    presets: Mapping[str, Any]
    """Configurations by name; `default` is always among them."""


FAMILIES: Mapping[str, Family] = {
    "tjunction": Family("GenTjunction", tjunction.sample_with_map, tjunction.LINKS, tjunction.PRESETS),
    "highway": Family("GenHighway", highway.sample_with_map, highway.LINKS, highway.PRESETS),
    "crossing": Family("GenCrossing", crossing.sample_with_map, crossing.LINKS, crossing.PRESETS),
}


class Draw(NamedTuple):
    """Which scenarios to draw."""

    count: int
    seed: int = 0
    family: str = "tjunction"
    preset: str = "default"

    def checked(self) -> Draw:
        """The same.

        Raises:
          ScenarioError: there is no such family or preset, or a number is out of range.
        """
        _preset(self)
        if self.count < 1:
            raise ScenarioError(f"cannot draw {self.count} scenarios: give at least 1")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise ScenarioError(f"seed {self.seed} is out of range: give one within 0 … {LARGEST_SEED}")
        return self

    def name(self, index: int) -> str:
        """CommonRoad's name for scenario number `index`, from 0."""
        preset = "" if self.preset == "default" else self.preset.capitalize()
        return f"ZAM_{_family(self.family).title}{preset}-{self.seed + 1}_{index + 1}_T-1"


def _family(name: str) -> Family:
    if name not in FAMILIES:
        raise ScenarioError(f"no family {name!r} of generated scenarios; there are {', '.join(FAMILIES)}")
    return FAMILIES[name]


def _preset(draw: Draw) -> Any:
    presets = _family(draw.family).presets
    if draw.preset not in presets:
        raise ScenarioError(f"family {draw.family} has no preset {draw.preset!r}; there are {', '.join(presets)}")
    return presets[draw.preset]


def scenario_keys(seed: int, indices: Array) -> Array:
    """Random keys of the scenarios with these numbers `[scenarios]`, int."""
    return jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(indices)


@partial(jax.jit, static_argnums=(0, 1))
def sample_batch(
    sample_with_map: Callable[[Array, Any], tuple[jf.Scenario, LaneletMap]], config: Any, keys: Array
) -> tuple[jf.Scenario, LaneletMap]:
    """A scenario and its map for each key, as one batch."""
    return jax.vmap(lambda key: sample_with_map(key, config))(keys)


def chunks(draw: Draw) -> Iterator[tuple[range, jf.Scenario, LaneletMap]]:
    """The scenarios in batches as NumPy arrays, with their numbers.

    Raises:
      ScenarioError: there is nothing to draw, see `Draw.checked`.
    """
    family, config = _family(draw.checked().family), _preset(draw)
    for first in range(0, draw.count, CHUNK):
        keys = scenario_keys(draw.seed, jnp.arange(first, first + CHUNK))
        batch = jax.device_get(sample_batch(family.sample_with_map, config, keys))
        yield range(first, min(first + CHUNK, draw.count)), *batch


def generate(draw: Draw, progress: Callable[[int, int], None] | None = None) -> ScenarioSet:
    """Draw scenarios as a set like one that was read from files.

    Args:
      draw: which ones.
      progress: called with the number of scenarios drawn and of all.

    Raises:
      ScenarioError: there is nothing to draw, see `Draw.checked`.
    """
    found, infos = [], []
    for numbers, batch, _ in chunks(draw):
        for row, number in enumerate(numbers):
            scenario = jax.tree.map(lambda leaf, row=row: leaf[row], batch)
            found.append(scenario)
            infos.append(_info(draw.name(number), scenario))
        if progress is not None:
            progress(len(found), draw.count)
    return ScenarioSet(share_equal(found), tuple(infos))


def documents(draw: Draw) -> Iterator[tuple[str, bytes]]:
    """Names of the scenarios and their CommonRoad files' contents.

    Raises:
      ScenarioError: there is nothing to draw, or commonroad-io is not installed.
    """
    links = _family(draw.checked().family).links
    for numbers, batch, maps in chunks(draw):
        for row, number in enumerate(numbers):
            scenario, lanelet_map = (jax.tree.map(lambda leaf, row=row: leaf[row], part) for part in (batch, maps))
            yield draw.name(number), commonroad_document(scenario, lanelet_map, links, draw.name(number))


def _info(name: str, scenario: jf.Scenario) -> ScenarioInfo:
    return ScenarioInfo(
        name=name,
        benchmark_id=name,
        commonroad_version="2020a",
        planning_problem_id=PROBLEM_ID,
        initial_time_step=0,
        initial_heading=float(scenario.initial_state.heading),
        file_dt=jf.DT,
    )
