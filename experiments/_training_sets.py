"""Scenarios to train and to validate on, as parameters of the environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxfrenet as jf
import ppo
import scenarios
from experiments._sources import load_files, named_draws
from jaxfrenet._typing import Array
from jaxfrenet.environment import Baseline, DrivingEnvironment, EnvironmentParams, RewardFactors, make_params
from scenarios import Dataset
from scenarios.batching import rounded_up
from scenarios.command_line import UserError
from scenarios.families import LARGEST_SEED, Draw

VALIDATION = 0.15
"""Generated scenarios to validate on, relative to those to train on."""
TOGETHER = 16
"""Scenarios that are driven with the default weights at once."""
RISKY = 1e-12
"""Mean risk, to the ego and others together, from which on a scenario that ended well counts as hard."""


class TrainingSets(NamedTuple):
    """What is learnt from, and what is measured on."""

    train: Dataset
    validation: Dataset
    groups: tuple[int, ...]
    """How many of the scenarios to train on come from each source: files, and each kind that was generated."""

    def parts(self) -> tuple[Dataset, Dataset]:
        """Both sets of scenarios."""
        return self.train, self.validation

    def max_steps(self) -> int:
        """Steps after which every episode has ended."""
        return max(jf.max_steps(one) for part in self.parts() for one in part.scenarios)


class Driven(NamedTuple):
    """How episodes went; `[episodes]` each."""

    returns: np.ndarray | Array
    """Sums of rewards."""
    steps: np.ndarray | Array
    episode: dict[str, np.ndarray] | dict[str, Array]
    """Summaries, see `DrivingEnvironment.step`."""
    metrics: dict[str, np.ndarray] | dict[str, Array]
    """Sums over the steps, likewise."""
    rewards: np.ndarray | Array
    """`[episodes, steps]`, if they were recorded."""

    @classmethod
    def of(cls, found: ppo.Evaluation) -> Driven:
        """What an evaluation tells."""
        return cls(found.returns, found.lengths, found.episode, found.metrics, found.rewards)

    @property
    def hard(self) -> np.ndarray:
        """Which ended badly, or were risky."""
        episode = {name: np.asarray(value) for name, value in self.episode.items()}
        risk = episode["mean_ego_risk"] + episode["mean_third_party_risk"]
        return (episode["outcome/goal_reached_in_time"] < 0.5) | (risk > RISKY)


def training_sets(
    files: Sequence[Path],
    validation: Sequence[Path],
    kinds: tuple[str, ...],
    count: int,
    seed: int,
    keep: Callable[[Dataset], Dataset] | None = None,
) -> TrainingSets:
    """Read and generate what to train on, and what to validate on.

    Unless files are named for it, validation has 15 % of the files, and for each kind other generated scenarios.

    Args:
      files: CommonRoad files, folders, archives or `.npz` sets to train on.
      validation: the same to validate on, if there are any.
      kinds: kinds of scenarios to generate, `FAMILY` or `FAMILY:PRESET`, perhaps followed by `=NUMBER`.
      count: how many to generate of each kind without a number; 0 for none at all.
      seed: of the generator.
      keep: leaves out some of the generated scenarios; files are always kept.

    Raises:
      UserError: nothing is left to train or to validate on.
      ScenarioError: a source holds nothing that can be driven.
    """
    train, held_out = [], []
    if files:
        parts = Dataset.from_set(load_files(tuple(files))).split()
        rest = (parts.test, parts.validation) if validation else (parts.test,)
        train, held_out = [joined([parts.train, *rest])], [parts.validation]
    if count:
        named, drawn, others = _draws(kinds, count, seed), [], []
        for draw in tqdm(named, "generating", unit=" kinds", delay=5.0):
            other = draw._replace(count=max(1, round(VALIDATION * draw.count)), seed=(draw.seed + 1) % LARGEST_SEED)
            drawn.append(Dataset.from_generator(draw))
            if not validation:
                others.append(Dataset.from_generator(other))
        train += drawn if keep is None else map(keep, drawn)
        held_out += others if keep is None else map(keep, others)
    if validation:
        held_out = [Dataset.from_set(load_files(tuple(validation)))]
    sets = TrainingSets(joined(train), joined(held_out), tuple(len(group) for group in train))
    for name, part in zip(("training", "validation"), sets.parts(), strict=True):
        if not len(part):
            raise UserError(f"no scenario is left for {name}; give more with --generate, or files")
    return sets


def _draws(kinds: tuple[str, ...], count: int, seed: int) -> list[Draw]:
    """What to generate for words as `training_sets` takes them.

    Raises:
      UserError: what should be a number is none.
      ScenarioError: there is no such kind, or a number is out of range.
    """
    found: dict[str, Draw] = {}
    for word in kinds:
        kind, _, number = word.partition("=")
        if number and not (number.isdecimal() and int(number)):
            raise UserError(f"--kinds {word}: {number!r} is no number of scenarios; write for example {kind}=100")
        found |= named_draws((kind,), int(number) if number else count, seed)
    return list((found or named_draws((), count, seed)).values())


def joined(parts: Sequence[Dataset]) -> Dataset:
    """All scenarios of several sets."""
    every = [one for part in parts for one in part.scenarios], [one for part in parts for one in part.infos]
    return Dataset(tuple(every[0]), tuple(every[1]))


def environment_params(
    environment: DrivingEnvironment, sets: TrainingSets, rewards: RewardFactors
) -> tuple[EnvironmentParams, EnvironmentParams]:
    """Parameters for training, and for validation with one scenario per element of a leading axis.

    Predictions are tabulated, which takes a while. All arrays have the same sizes, so that programs can be shared.
    """
    every = joined(sets.parts())
    common, made = common_sizes(every), []
    with tqdm(total=len(every), desc="predicting traffic", unit=" scenarios", delay=5.0) as bar:
        for part in sets.parts():
            made.append(make_params(environment.config, part.stacked(common), rewards, progress=bar.update))
    return made[0], one_each(made[1])


def common_sizes(found: Dataset) -> dict[str, int]:
    """Sizes of the axes of arrays that hold any of the scenarios."""
    sizes = [scenarios.sizes_of(one) for one in found.scenarios]
    return {axis: rounded_up(max(size[axis] for size in sizes)) for axis in sizes[0]}


def one_each(params: EnvironmentParams) -> EnvironmentParams:
    """Parameters with a leading axis, along which each element has a single scenario."""
    assert params.chances is not None
    count = params.chances.shape[0]
    scenarios, starts = jax.tree.map(lambda leaf: leaf[:, None], (params.scenarios, params.starts))
    rewards = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), params.rewards)
    return EnvironmentParams(rewards, scenarios, starts, jnp.ones((count, 1)))


def drive_default(
    environment: DrivingEnvironment, params: EnvironmentParams, max_steps: int, description: str
) -> Driven:
    """Drive every scenario with the zero action, and record every reward: what learning has to beat.

    Args:
      environment: says how it is driven.
      params: with a leading axis, see `one_each`.
      max_steps: steps after which every episode has ended.
      description: what the progress bar says.
    """
    count = jax.tree.leaves(params)[0].shape[0]
    run = zero_driver(environment, max_steps)
    parts = []
    with tqdm(total=count, desc=description, unit=" scenarios", delay=5.0) as bar:
        for first in range(0, count, TOGETHER):
            chosen = np.minimum(np.arange(first, first + TOGETHER), count - 1)
            some = jax.tree.map(lambda leaf, chosen=chosen: leaf[chosen], params)
            new = min(TOGETHER, count - first)
            parts.append(jax.tree.map(lambda leaf, new=new: leaf[:new], jax.device_get(run(some))))
            bar.update(new)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


@cache
def zero_driver(environment: DrivingEnvironment, max_steps: int) -> Callable[[EnvironmentParams], Driven]:
    """Drives with the zero action and records every reward; compiled, for parameters as `drive_default` has them."""

    def act(carry: None, observation: Array, reset: Array) -> tuple[None, Array]:
        return None, jnp.zeros((observation.shape[0], environment.action_size))

    def run(params: EnvironmentParams) -> Driven:
        keys = jax.random.split(jax.random.key(0), jax.tree.leaves(params)[0].shape[0])
        found = ppo.evaluate(environment, act, params, keys, max_steps, record=max_steps)
        return Driven.of(found)

    return jax.jit(run)


def baseline_of(rewards: np.ndarray, discount: float) -> Baseline:
    """What the default weights get from each step on.

    Args:
      rewards: `[scenarios, steps]`, its rewards.
      discount: γ.
    """
    to_go = np.zeros((rewards.shape[0], rewards.shape[1] + 1))
    for step in reversed(range(rewards.shape[1])):
        to_go[:, step] = rewards[:, step] + discount * to_go[:, step + 1]
    return Baseline(jnp.asarray(to_go, jnp.float32), jnp.float32(discount))


def shares(groups: Sequence[int]) -> Array:
    """`[scenarios]`, how often each is drawn: every group, of a size each, alike; within it every scenario alike."""
    return jnp.asarray(np.concatenate([np.full(size, 1.0 / max(size, 1)) for size in groups]), jnp.float32)
