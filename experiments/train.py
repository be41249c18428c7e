"""Train the hybrid planner: recurrent PPO adjusts the planner's cost weights while it drives."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from tqdm import tqdm

import ppo
from experiments._learning_curve import draw_learning_curve
from experiments._planners import describe
from experiments._presets import Preset
from experiments._training_config import command_line, settle_config, with_config
from experiments._training_devices import provide_threads, shared_mesh, start_processes
from experiments._training_log import TrainingLog, read_metrics
from experiments._training_options import TrainOptions, environment_config, settings
from experiments._training_problem import Problem, make_problem, scenario_sets
from experiments._training_program import CHUNK, Together, training_program
from jaxfrenet._typing import Array
from scenarios.command_line import UserError, prepare_folder, run_command


class Runs(NamedTuple):
    """Training, compiled."""

    state: ppo.TrainingState
    """With a leading axis of runs, if there are several."""
    advance: Callable[..., tuple[ppo.TrainingState, Any, Any]]
    """See `training_program`."""


def train(options: TrainOptions) -> None:
    """Train, validate, keep the best policy, and print how good it is."""
    preset = settings(options)
    environment = environment_config(options, preset)
    folder = prepare_folder(options.out)
    provide_threads()
    start_processes(options)
    mesh = shared_mesh(options, preset)
    first = jax.process_index() == 0
    if first:
        settle_config(folder, options, preset)
    discount = float(preset.hyperparameters.discount) if options.relative else None
    sets = scenario_sets(options, preset)
    problem = make_problem(sets, environment, preset.rewards, discount, mesh)
    checkpoints = ppo.Checkpoints(folder / "checkpoints")
    runs = _runs(options, preset, problem, mesh)
    restored = checkpoints.restore(runs.state, _report_skipped) if options.resume else None
    state, done = restored or (runs.state, 0)
    with _log(folder, done if restored else None, first) as log:
        if log is not None and not restored:
            log.write("baseline", 0, 0, problem.baseline)
        state = _train(options, preset, problem, runs, state, done, checkpoints, log, folder)
    if first:
        _finish(folder, problem, preset, state)


def _runs(options: TrainOptions, preset: Preset, problem: Problem, mesh: Mesh | None) -> Runs:
    """The state before training and the program that goes on from it."""
    config, environment = preset.ppo, problem.environment
    together = Together(state=0) if options.seeds > 1 else None
    program = training_program(config, environment, problem.max_steps, mesh, together)

    def start(key: Array) -> ppo.TrainingState:
        return ppo.initial_state(config, environment, preset.hyperparameters, problem.train, key, mesh)

    key = jax.random.key(options.seed)
    if options.seeds == 1:
        return Runs(start(key), program)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(options.seeds))
    return Runs(jax.vmap(start)(keys), program)


def _train(
    options: TrainOptions,
    preset: Preset,
    problem: Problem,
    runs: Runs,
    state: ppo.TrainingState,
    done: int,
    checkpoints: ppo.Checkpoints,
    log: TrainingLog | None,
    folder: Path,
) -> ppo.TrainingState:
    """Train from `done` environment steps on to the end; the state then."""
    batch = preset.ppo.environments * preset.ppo.rollout_steps
    every = -(-preset.validate_every // CHUNK)
    chunks = -(-preset.total_steps // (batch * CHUNK))
    saved = done if done else None
    with tqdm(
        total=chunks * CHUNK * batch, initial=done, desc="training", unit=" steps", disable=log is None, mininterval=1.0
    ) as bar:
        for chunk in range(done // (batch * CHUNK), chunks):
            validate = (chunk + 1) % every == 0 or chunk + 1 == chunks
            start = time.perf_counter()
            moved, metrics, scores = runs.advance(
                state, preset.hyperparameters, problem.train.rewards, problem.train, problem.validation,
                problem.counted, validate,
            )  # fmt: skip
            metrics, scores = jax.device_get((metrics, scores))
            seconds = time.perf_counter() - start
            complaint = ppo.first_nonfinite(metrics)
            if complaint is not None:
                if saved != done:
                    checkpoints.save(done, state)
                raise UserError(
                    f"{complaint}; the state before it is safe in {checkpoints.folder}, "
                    "try a lower learning rate: --hyperparameters learning_rate=1e-4"
                )
            state, before, done = moved, done, (chunk + 1) * CHUNK * batch
            if log is not None:
                rate = options.seeds * CHUNK * batch / seconds
                _write(log, options.seeds, before, batch, metrics, scores if validate else None, rate)
                bar.update(done - before)
                bar.set_postfix_str(_told(problem, scores) if validate else bar.postfix or "", refresh=False)
            if validate:
                if log is not None:
                    log.flush()
                    _keep_best(folder, problem, preset, state, options)
                    if options.keep_policies:
                        _keep_current(folder, problem, preset, state, options, done)
                checkpoints.save(done, state)
                saved = done
    return state


def _write(log: TrainingLog, seeds: int, step: int, batch: int, metrics: Any, scores: Any | None, rate: float) -> None:
    """Add the lines of one chunk, which began at `step`, for all runs."""
    for seed in range(seeds):
        own = metrics if seeds == 1 else jax.tree.map(lambda leaf, seed=seed: leaf[seed], metrics)
        for row in range(CHUNK):
            values = {name: value[row] for name, value in own.items() if name != "rollout_steps"}
            log.write("update", step + (row + 1) * batch, seed, values | {"steps_per_second": round(rate, 1)})
        if scores is not None:
            found = scores if seeds == 1 else jax.tree.map(lambda leaf, seed=seed: leaf[seed], scores)
            log.write("validation", step + CHUNK * batch, seed, found)


def _told(problem: Problem, scores: Any) -> str:
    return f"validation return {np.max(scores['return']):.0f} (default weights {problem.baseline['return']:.0f})"


def _best(preset: Preset, state: ppo.TrainingState) -> tuple[ppo.Policy, float, int]:
    """The best policy of all runs, its score and the environment steps that it had."""
    batch = preset.ppo.environments * preset.ppo.rollout_steps
    scores, updates = (np.atleast_1d(np.asarray(leaf)) for leaf in (state.best_score, state.best_update))
    place = int(np.argmax(scores))
    one = state.best if state.best_score.ndim == 0 else jax.tree.map(lambda leaf: leaf[place], state.best)
    return one, float(scores[place]), batch * int(updates[place])


def _keep_best(folder: Path, problem: Problem, preset: Preset, state: ppo.TrainingState, options: TrainOptions) -> None:
    """Write the best policy."""
    policy, score, steps = _best(preset, state)
    about = {"validation_return": score, "default_weights_return": problem.baseline["return"]}
    _save(folder / "policy", problem, preset, options, policy, about | {"steps": steps})


def _keep_current(
    folder: Path, problem: Problem, preset: Preset, state: ppo.TrainingState, options: TrainOptions, done: int
) -> None:
    """Write the policy of every run as it is now."""
    for seed in range(options.seeds):
        one = state if options.seeds == 1 else jax.tree.map(lambda leaf, seed=seed: leaf[seed], state)
        name = str(done) if options.seeds == 1 else f"{done}-seed{seed}"
        policy = ppo.current_policy(preset.ppo, one)
        _save(folder / "policies" / name, problem, preset, options, policy, {"steps": done})


def _save(
    folder: Path, problem: Problem, preset: Preset, options: TrainOptions, policy: ppo.Policy, about: dict[str, Any]
) -> None:
    """Write a policy with all that is to be known about it."""
    about |= {
        "preset": options.preset,
        "sampling": preset.sampling,
        "predictor": options.predictor,
        "command": command_line(options),
    }
    ppo.save_policy(folder, jax.device_get(policy), describe(problem.environment.config) | about)


def _finish(folder: Path, problem: Problem, preset: Preset, state: ppo.TrainingState) -> None:
    """Draw the curve and print how the best policy compares."""
    lines = read_metrics(folder)
    draw_learning_curve(folder / "curve.png", lines)
    steps = _best(preset, state)[2]
    at_best = [one for one in lines if one["kind"] == "validation" and one["step"] == steps]
    best = max(at_best, key=lambda line: line["return"], default=None)
    print(f"{'validation':<28}{'default weights':>16}{'best policy':>14}")
    for name, title, form in SHOWN:
        mine = "-" if best is None else format(best[name], form)
        print(f"  {title:<26}{format(problem.baseline[name], form):>16}{mine:>14}")
    print(f"best after {steps:,} steps; written to {folder / 'policy'}, metrics.jsonl and curve.png")


SHOWN = (
    ("return", "mean return", ".1f"),
    ("outcome/goal_reached_in_time", "goal in time", ".1%"),
    ("outcome/collision_obstacle", "collision", ".1%"),
    ("outcome/timeout", "time-out", ".1%"),
    ("mean_ego_risk", "mean ego risk", ".2e"),
    ("mean_third_party_risk", "mean third-party risk", ".2e"),
)
"""Rows of the table: name, title, format."""


@contextmanager
def _log(folder: Path, resumed_step: int | None, wanted: bool) -> Iterator[TrainingLog | None]:
    if not wanted:
        yield None
        return
    log = TrainingLog(folder, resumed_step)
    try:
        yield log
    finally:
        log.close()


def _report_skipped(path: Path, reason: str) -> None:
    print(f"train: {path}: {reason}; going on from the one before", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(TrainOptions, train, "experiments.train", arguments, partial(with_config, TrainOptions))


if __name__ == "__main__":
    main()
