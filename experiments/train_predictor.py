"""Train the neural predictor on generated traffic and, where there are files, on recorded traffic beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp
import tyro
from tqdm import tqdm

import jaxfrenet as jf
from experiments._disturbance import disturbed
from experiments._predictions import Scores, Traffic, joined, score, traffic_of
from experiments._sources import load_files, named_draws
from jaxfrenet._typing import Array
from jaxfrenet.prediction import neural
from scenarios import Dataset
from scenarios.command_line import UserError, prepare_folder, print_table, run_command
from scenarios.files import written_whole

CHUNK = 50
"""Training steps in one call of the compiled program."""
WARM_UP = 500
"""Steps over which the learning rate rises."""
SHORTENED = 0.3
"""Share of training scenes of which only part of the past is seen."""
REGULAR_FILES, REGULAR_GENERATED = 0.85, 0.35
"""Shares of training scenes that are left as they were recorded or generated; see `experiments._disturbance`."""
UNKNOWN = 0.1
"""Share of obstacles whose kind is not told, and of scenes without lanes."""
ERROR_WEIGHT = 1.0
"""Weight of the mean's distance [m] beside the negative log-likelihood."""
VALIDATION_EVERY = 10
"""Held-out scenarios are predicted every so many steps."""
FILES_WEIGHT = 3.0
"""Files are drawn so many times as often as each kind of generated scenarios."""
AVERAGING = 0.999
"""Share of the moving average that a step keeps."""
CALIBRATED = 0.94
"""Probability of the ellipse that covariances are scaled for."""
SCALES = 0.4, 2.5
"""Range of the scales."""
SMOOTHING = 3
"""The scales are averaged over so many steps to each side."""
END = 29
"""Distances are told for this step: 3 s."""
LEAST_FUTURE = 5
"""Training scenes have at least so many recorded steps to come."""


@dataclass(frozen=True)
class TrainPredictorOptions:
    """Train the neural predictor: predictor.npz (the best on held-out scenarios), metrics.jsonl, checkpoints."""

    generate: int = 1500
    """How many scenarios to generate of every kind."""
    kinds: tuple[str, ...] = ()
    """Kinds to generate, each FAMILY or FAMILY:PRESET, for example tjunction:hard; all where none is named."""
    generator_seed: int = 0
    """Seed of the generated scenarios."""
    scenarios: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH...")] = ()
    """CommonRoad files, folders or archives of them, or .npz sets, to train on as well."""
    steps: int = 20000
    """Training steps."""
    batch: int = 48
    """Scenes in one step; all their obstacles are predicted."""
    learning_rate: float = 1.5e-3
    """Highest learning rate; it rises at first and then falls to 0."""
    validate_every: int = 2500
    """Steps between validations; a checkpoint is written with each."""
    seed: int = 0
    """Seed of everything random in training."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""
    out: Path = Path("runs/predictor")
    """Folder for the results."""


class Group(NamedTuple):
    """Traffic of one kind."""

    name: str
    weight: float
    """How often it is drawn, relative to others."""
    regular: float
    """Share of its training scenes that are left as they are."""
    train: Traffic
    held_out: Traffic

    @property
    def count(self) -> int:
        """Scenarios to train on."""
        return len(self.train.obstacles.length)


class Sampling(NamedTuple):
    """How training scenes are drawn; `[scenarios]` each."""

    chances: Array
    """Cumulative."""
    regular: Array
    """Share that is left as it is."""


class TrainingState(NamedTuple):
    """All that training goes on from; parameters are `neural.Parameters`."""

    parameters: Any
    optimizer: Any
    step: Array
    """`[]`, steps done."""
    average: Any
    """Moving average of the parameters, which is what is validated and kept."""
    best: Any
    """The average that was the best on held-out scenarios."""
    best_loss: Array
    """`[]`, their loss."""


def train_predictor(options: TrainPredictorOptions) -> None:
    """Train, validate, keep the best parameters, and print how good they are."""
    _check(options)
    folder = prepare_folder(options.out)
    _settle_config(folder, options)
    groups = _groups(options)
    traffic = joined([group.train for group in groups])
    sampling = _sampling(groups)
    optimizer = _optimizer(options)
    run = jax.jit(partial(_train_chunk, options, optimizer))
    state = _first_state(options, optimizer, traffic)
    with ocp.CheckpointManager(
        (folder / "checkpoints").absolute(), options=ocp.CheckpointManagerOptions(max_to_keep=2)
    ) as manager:
        if options.resume and manager.latest_step() is not None:
            state = manager.restore(manager.latest_step(), args=ocp.args.StandardRestore(state))
            _forget_later_metrics(folder, int(state.step))
        with tqdm(total=options.steps, initial=int(state.step), desc="training", unit=" steps") as bar:
            while int(state.step) < options.steps:
                state, losses = run(state, traffic, sampling)
                loss = float(jnp.mean(losses))
                if not np.isfinite(loss):
                    raise UserError(f"the loss is {loss} before step {int(state.step)}; lower --learning-rate")
                bar.update(CHUNK)
                bar.set_postfix_str(f"loss {loss:.3f}", refresh=False)
                if int(state.step) % options.validate_every < CHUNK or int(state.step) >= options.steps:
                    state = _validated(folder, state, groups, loss)
                    manager.save(int(state.step), args=ocp.args.StandardSave(state))
    best = _calibrated(state.best, groups)
    neural.save_parameters(folder / "predictor.npz", best)
    rows = [(name, f"{fde:.2f} m") for name, (_, fde) in _losses(best, groups).items()]
    print_table(rows, "mean distance after 3 s, held-out scenarios")
    print(f"written to {folder / 'predictor.npz'}; `evaluate_predictor` tells more")


def _sampling(groups: list[Group]) -> Sampling:
    chances = np.cumsum(np.concatenate([np.full(group.count, group.weight / group.count) for group in groups]))
    regular = np.concatenate([np.full(group.count, group.regular) for group in groups])
    return Sampling(jnp.asarray(chances, jnp.float32), jnp.asarray(regular, jnp.float32))


def _check(options: TrainPredictorOptions) -> None:
    for name, least in (("generate", 0), ("steps", 1), ("batch", 1), ("validate_every", 1)):
        if getattr(options, name) < least:
            raise UserError(f"--{name.replace('_', '-')} {getattr(options, name)}: give at least {least}")
    if not 0.0 < options.learning_rate < 1.0:
        raise UserError(f"--learning-rate {options.learning_rate}: give a number between 0 and 1")
    if not options.generate and not options.scenarios:
        raise UserError("--generate 0 leaves nothing to train on; name files with --scenarios")


def _settle_config(folder: Path, options: TrainPredictorOptions) -> None:
    """Write the options, or make sure that a run that is resumed had the same ones."""
    plain = {name: value for name, value in asdict(options).items() if name not in ("resume", "out")}
    plain |= {"scenarios": [str(path) for path in options.scenarios], "kinds": list(options.kinds)}
    file = folder / "config.json"
    if options.resume and file.is_file():
        earlier = json.loads(file.read_text())
        for name, value in plain.items():
            if earlier.get(name) != value:
                flag = f"--{name.replace('_', '-')}"
                raise UserError(f"{file}: the run had {flag} {earlier.get(name)}; resume with the same options")
        return
    if (folder / "checkpoints").is_dir() and any((folder / "checkpoints").iterdir()):
        raise UserError(f"{folder}: holds another run; go on with --resume, or name another folder with --out")
    with written_whole(file) as handle:
        handle.write(json.dumps(plain, indent=1).encode() + b"\n")


def _groups(options: TrainPredictorOptions) -> list[Group]:
    """What there is to learn from, a tenth of it held out."""
    groups = []
    if options.scenarios:
        groups.append(_divided("files", FILES_WEIGHT, REGULAR_FILES, Dataset.from_set(load_files(options.scenarios))))
    draws = named_draws(options.kinds, options.generate, options.generator_seed) if options.generate else {}
    for name, draw in tqdm(draws.items(), desc="generating", unit=" kinds", delay=2.0):
        groups.append(_divided(name, 1.0, REGULAR_GENERATED, Dataset.from_generator(draw)))
    return groups


def _divided(name: str, weight: float, regular: float, dataset: Dataset) -> Group:
    parts = dataset.split(shares=(0.8, 0.1, 0.1))
    train = (*parts.train.scenarios, *parts.test.scenarios)
    if not train or not len(parts.validation):
        raise UserError(f"{name}: {len(dataset)} scenarios are too few to hold some out; give more")
    return Group(name, weight, regular, traffic_of(train), traffic_of(parts.validation.scenarios))


def _optimizer(options: TrainPredictorOptions) -> optax.GradientTransformation:
    warm_up = min(WARM_UP, options.steps // 2)
    rate = optax.warmup_cosine_decay_schedule(0.0, options.learning_rate, warm_up, options.steps)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))


def _first_state(
    options: TrainPredictorOptions, optimizer: optax.GradientTransformation, traffic: Traffic
) -> TrainingState:
    one = traffic.at(jnp.int32(0))
    parameters: Any = neural.initial_parameters(jax.random.key(options.seed), one.obstacles, one.lane_map)
    start = optimizer.init(parameters), jnp.int32(0), parameters, parameters
    return TrainingState(parameters, *start, jnp.float32(jnp.inf))


def _train_chunk(
    options: TrainPredictorOptions,
    optimizer: optax.GradientTransformation,
    state: TrainingState,
    traffic: Traffic,
    sampling: Sampling,
) -> tuple[TrainingState, Array]:
    """`CHUNK` training steps; the losses `[CHUNK]`. What a step draws depends on its number alone."""

    def train_step(state: TrainingState, _: None) -> tuple[TrainingState, Array]:
        key = jax.random.fold_in(jax.random.key(options.seed), state.step)
        loss = partial(_loss, key=key, traffic=traffic, sampling=sampling, batch=options.batch)
        value, gradient = jax.value_and_grad(loss)(state.parameters)
        with jax.numpy_dtype_promotion("standard"):  # optax multiplies floats by step counts
            updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.parameters)
        parameters = optax.apply_updates(state.parameters, updates)
        keep = jnp.minimum(AVERAGING, state.step.astype(jnp.float32) / (state.step.astype(jnp.float32) + 10.0))
        average = jax.tree.map(lambda old, new: keep * old + (1.0 - keep) * new, state.average, parameters)
        return TrainingState(parameters, optimizer_state, state.step + 1, average, state.best, state.best_loss), value

    return jax.lax.scan(train_step, state, None, CHUNK)


def _loss(parameters: neural.Parameters, key: Array, traffic: Traffic, sampling: Sampling, batch: int) -> Array:
    """Mean over obstacles and steps of randomly drawn scenes."""
    which, when, past, others = jax.random.split(key, 4)
    chosen = jnp.searchsorted(sampling.chances, jax.random.uniform(which, (batch,)) * sampling.chances[-1])
    scene, regular = traffic.at(chosen), sampling.regular[chosen]
    steps = scene.obstacles.valid.shape[2]
    step = jax.random.randint(when, (batch,), 0, steps - LEAST_FUTURE)
    shortened, length = jax.random.uniform(past, (2, batch))
    first = jnp.where(shortened < SHORTENED, step - (30.0 * length).astype(jnp.int32), 0)
    draw = jax.random.split(others, batch)

    def scores(one: Traffic, step: Array, first: Array, regular: Array, key: Array) -> tuple[Array, Array]:
        level, noise, kinds, lanes = jax.random.split(key, 4)
        strength = jnp.maximum(jax.random.uniform(level) - regular, 0.0) / (1.0 - regular)
        obstacles = disturbed(noise, one.obstacles, strength)
        obstacles = jax.tree.map(lambda new, old: jnp.where(strength > 0.0, new, old), obstacles, one.obstacles)
        untold = jax.random.bernoulli(kinds, UNKNOWN, obstacles.kind.shape)
        obstacles = replace(obstacles, kind=jnp.where(untold, jnp.int32(jf.ObstacleKind.UNKNOWN), obstacles.kind))
        lane_map = replace(one.lane_map, valid=one.lane_map.valid & ~jax.random.bernoulli(lanes, UNKNOWN))
        prediction = neural.predict(parameters, obstacles, lane_map, step, neural.LONGEST_HORIZON, first)
        found = score(prediction, obstacles, step)
        return jnp.sum(found.nll + ERROR_WEIGHT * found.error), jnp.sum(found.valid.astype(jnp.float32))

    total, count = jax.vmap(scores)(scene, step, first, regular, draw)
    return jnp.sum(total) / jnp.maximum(jnp.sum(count), 1.0)


def _validated(folder: Path, state: TrainingState, groups: list[Group], train_loss: float) -> TrainingState:
    """The state with the best parameters up to now; adds a line to the metrics."""
    losses = _losses(state.average, groups)
    loss = float(np.mean([nll + ERROR_WEIGHT * fde for nll, fde in losses.values()]))
    line = {"step": int(state.step), "train_loss": round(train_loss, 4), "loss": round(loss, 4)}
    for name, (nll, fde) in losses.items():
        line |= {f"{name} nll": round(nll, 4), f"{name} distance after 3 s": round(fde, 4)}
    with (folder / "metrics.jsonl").open("a") as file:
        file.write(json.dumps(line) + "\n")
    if loss < float(state.best_loss):
        return state._replace(best=state.average, best_loss=jnp.float32(loss))
    return state


def _forget_later_metrics(folder: Path, step: int) -> None:
    """Drop lines that an interrupted run wrote after its last checkpoint: they will be written again."""
    file = folder / "metrics.jsonl"
    lines = file.read_text().splitlines(keepends=True) if file.is_file() else []
    with written_whole(file) as handle:
        handle.write("".join(line for line in lines if json.loads(line)["step"] <= step).encode())


def _losses(parameters: neural.Parameters, groups: list[Group]) -> dict[str, tuple[float, float]]:
    """Mean negative log-likelihood over all steps, and mean distance after 3 s, for each group."""
    found = {group.name: _validate(parameters, group.held_out) for group in groups}
    return {name: (float(nll), float(error)) for name, (nll, error) in found.items()}


def _held_out_scores(parameters: neural.Parameters, traffic: Traffic) -> Scores:
    """Of predictions made every `VALIDATION_EVERY` steps, `[scenarios, steps, obstacles, horizon]`."""
    steps = jnp.arange(0, traffic.obstacles.valid.shape[2] - LEAST_FUTURE, VALIDATION_EVERY)

    def of(one: Traffic) -> Scores:
        def at(step: Array) -> Scores:
            made = neural.predict(parameters, one.obstacles, one.lane_map, step, neural.LONGEST_HORIZON)
            return score(made, one.obstacles, step)

        return jax.vmap(at)(steps)

    return jax.lax.map(of, traffic)


@jax.jit
def _validate(parameters: neural.Parameters, traffic: Traffic) -> tuple[Array, Array]:
    found = _held_out_scores(parameters, traffic)
    count, ends = (jnp.sum(part.astype(jnp.float32)) for part in (found.valid, found.valid[..., END]))
    return jnp.sum(found.nll) / jnp.maximum(count, 1.0), jnp.sum(found.error[..., END]) / jnp.maximum(ends, 1.0)


def _calibrated(parameters: neural.Parameters, groups: list[Group]) -> neural.Parameters:
    """The parameters with covariances scaled, step by step, to hold `CALIBRATED` of the held-out positions."""
    distances, weights = [], []
    for group in groups:
        found = jax.device_get(jax.jit(_held_out_scores)(parameters, group.held_out))
        distance = np.where(found.valid, found.mahalanobis, np.nan).reshape(-1, neural.LONGEST_HORIZON)
        distances.append(distance)
        weights.append(np.full(len(distance), group.weight / max(np.sum(found.valid[..., 0]), 1)))
    every, weight = np.concatenate(distances), np.concatenate(weights)
    scale = np.array([_quantile(column, weight, CALIBRATED) for column in every.T]) / (-2.0 * np.log(1 - CALIBRATED))
    padded = np.pad(np.log(np.clip(scale, *SCALES)), SMOOTHING, mode="edge")
    smooth = np.convolve(padded, np.full(2 * SMOOTHING + 1, 1.0 / (2 * SMOOTHING + 1)), mode="valid")
    return neural.calibrated(parameters, jnp.asarray(np.exp(smooth), jnp.float32))


def _quantile(values: np.ndarray, weight: np.ndarray, share: float) -> float:
    """Of the values that are not NaN."""
    known = np.isfinite(values)
    order = np.argsort(values[known])
    total = np.cumsum(weight[known][order])
    return float(values[known][order][np.searchsorted(total, share * total[-1])])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(TrainPredictorOptions, train_predictor, "experiments.train_predictor", arguments)


if __name__ == "__main__":
    main()
