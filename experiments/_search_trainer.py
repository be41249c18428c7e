"""Trials whose settings are arguments of one compiled program, trained side by side in its slots."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.stages import Compiled

import ppo
from experiments._measuring import free_memory, fresh_bytes
from experiments._presets import Preset
from experiments._search_slots import Round
from experiments._training_options import LearningOptions, settings
from experiments._training_problem import Problem
from experiments._training_program import CHUNK, Together, training_program
from jaxfrenet._typing import Array
from jaxfrenet.environment import DrivingEnvironment, EnvironmentParams, RewardFactors
from scenarios.command_line import UserError

SHARE = 0.8
"""Share of the free memory that a program may take."""
TOGETHER = Together(state=0, hyperparameters=0, rewards=0)


class SlotTrainer:
    """Trains as many trials as there are slots in one program; each has its own state, hyperparameters and rewards.

    A trial's result does not depend on its slot, nor on what is trained beside it.
    """

    def __init__(
        self,
        options: LearningOptions,
        preset: Preset,
        problem: Problem,
        most: int,
        on_chunk: Callable[[float], object] = lambda share: None,
    ) -> None:
        """Compile the program.

        Args:
          options: of any of the trials; those that shape the program, and the seed, are the same in all.
          preset: what they make of a preset.
          problem: what is learned; its validation counts by the factors that all trials are judged by.
          most: slots, if they fit into the memory.
          on_chunk: told of the share of a trial that was trained since the last time, over all slots.

        Raises:
          UserError: not even one trial fits into the memory.
        """
        self._problem, self._preset, self._on_chunk = problem, preset, on_chunk
        self._key = jax.random.key(options.seed)
        self._chunks = -(-preset.validate_every // CHUNK)
        self.steps = self._chunks * CHUNK * preset.ppo.environments * preset.ppo.rollout_steps
        self.rounds = -(-preset.total_steps // self.steps)
        self._start = jax.jit(jax.vmap(partial(_start, preset.ppo, problem.environment), (0, 0, None, None)))
        self.slots, self._program = fit_into_memory(self._compile, most)
        self._chosen = [(preset.hyperparameters, problem.train.rewards)] * self.slots
        self._state: ppo.TrainingState | None = None

    def begin(self, placed: Mapping[int, LearningOptions]) -> None:
        """Begin trials: options by slot; the other slots go on."""
        for slot, options in placed.items():
            chosen = settings(options)
            self._chosen[slot] = chosen.hyperparameters, chosen.rewards
        fresh = self._start(*_stacked(self._chosen), self._problem.train, self._key)
        if self._state is not None:
            begins = np.isin(np.arange(self.slots), list(placed))
            fresh = _merged(begins, fresh, self._state)
        self._state = fresh

    def advance(self, used: int) -> Sequence[Round]:
        """Train all slots, `used` of which have trials, up to the next validation."""
        complaints: list[str | None] = [None] * self.slots
        scores: Any = None
        for chunk in range(self._chunks):
            last = jnp.bool_(chunk + 1 == self._chunks)
            self._state, metrics, scores = self._program(*self._arguments(self._state, self._chosen, last))
            found = jax.device_get(metrics)
            for slot in range(self.slots):
                own = {name: value[slot] for name, value in found.items()}
                complaints[slot] = complaints[slot] or ppo.first_nonfinite(own)
            self._on_chunk(used / (self._chunks * self.rounds))
        returns = np.asarray(scores["return"])
        return [Round(float(score), complaint) for score, complaint in zip(returns, complaints, strict=True)]

    def _arguments(self, state: Any, chosen: Sequence[tuple[ppo.Hyperparameters, RewardFactors]], last: Any) -> tuple:
        problem = self._problem
        return state, *_stacked(chosen), problem.train, problem.validation, problem.counted, last

    def _compile(self, slots: int) -> Compiled:
        """The program with so many slots."""
        program = training_program(
            self._preset.ppo, self._problem.environment, self._problem.max_steps, together=TOGETHER
        )
        chosen = [(self._preset.hyperparameters, self._problem.train.rewards)] * slots
        state = jax.eval_shape(self._start, *_stacked(chosen), self._problem.train, self._key)
        return program.lower(*self._arguments(state, chosen, jnp.bool_(True))).compile()


def fit_into_memory(compile_for: Callable[[int], Compiled], most: int) -> tuple[int, Compiled]:
    """A program with as many slots as fit into the memory, and their number.

    Args:
      compile_for: makes the program with so many slots.
      most: slots if there is room for all.

    Raises:
      UserError: there is no room for a single one.
    """
    slots = most
    while True:
        compiled = compile_for(slots)
        needed, free = fresh_bytes(compiled), free_memory()
        if needed is None or free is None or needed <= SHARE * free:
            return slots, compiled
        if slots == 1:
            raise UserError(
                f"a trial needs {needed / 1e6:,.0f} MB, {free / 1e6:,.0f} MB are free; "
                "train fewer environments at a time, for example --sizes environments=8"
            )
        slots = max(1, min(slots - 1, int(slots * SHARE * free / needed)))
        print(f"sweep: {slots} trials at a time fit into the memory", file=sys.stderr)


def _start(
    config: ppo.PPOConfig,
    environment: DrivingEnvironment,
    hyperparameters: ppo.Hyperparameters,
    rewards: RewardFactors,
    train: EnvironmentParams,
    key: Array,
) -> ppo.TrainingState:
    return ppo.initial_state(config, environment, hyperparameters, replace(train, rewards=rewards), key)


@jax.jit
def _merged(begins: Array, fresh: ppo.TrainingState, old: ppo.TrainingState) -> ppo.TrainingState:
    """The fresh states where trials begin, the old ones elsewhere."""
    return jax.vmap(lambda begins, *states: jax.tree.map(partial(jnp.where, begins), *states))(begins, fresh, old)


def _stacked(
    chosen: Sequence[tuple[ppo.Hyperparameters, RewardFactors]],
) -> tuple[ppo.Hyperparameters, RewardFactors]:
    """Settings of all slots, `[slots]` float32 each."""

    def columns(kind: type, place: int) -> Any:
        names = [field.name for field in fields(kind)]
        return kind(**{name: jnp.asarray([getattr(one[place], name) for one in chosen], jnp.float32) for name in names})

    return columns(ppo.Hyperparameters, 0), columns(RewardFactors, 1)
