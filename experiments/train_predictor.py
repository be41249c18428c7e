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
WEIGHT_DECAY = 0.03
"""Of AdamW."""
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
CALIBRATED = 0.92
"""Probability of the ellipse that covariances are scaled for."""
SCALES = 0.2, 2.5
"""Range of the scales."""
LEAST_NEAR = 500
"""Predictions of about a size from which its scale is taken; where there are fewer, it is 1."""
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
    steps: int = 8000
    """Training steps."""
    batch: int = 48
    """Scenes in one step; all their obstacles are predicted."""
    learning_rate: float = 1.5e-3
    """Highest learning rate; it rises at first and then falls to 0."""
    validate_every: int = 1000
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
    """All that training goes on from."""

    network: Any
    """Parameters of `neural.NETWORK`."""
    optimizer: Any
    step: Array
    """`[]`, steps done."""
    average: Any
    """Moving average of the network, which is what is validated and kept."""
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
    best = _calibrated(options.seed, state.best, groups)
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
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=WEIGHT_DECAY))


def _first_state(
    options: TrainPredictorOptions, optimizer: optax.GradientTransformation, traffic: Traffic
) -> TrainingState:
    one = traffic.at(jnp.int32(0))
    network = neural.initial_network(jax.random.key(options.seed), one.obstacles, one.lane_map)
    return TrainingState(network, optimizer.init(network), jnp.int32(0), network, network, jnp.float32(jnp.inf))


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
        value, gradient = jax.value_and_grad(loss)(state.network)
        with jax.numpy_dtype_promotion("standard"):  # optax multiplies floats by step counts
            updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.network)
        network = optax.apply_updates(state.network, updates)
        keep = jnp.minimum(AVERAGING, state.step.astype(jnp.float32) / (state.step.astype(jnp.float32) + 10.0))
        average = jax.tree.map(lambda old, new: keep * old + (1.0 - keep) * new, state.average, network)
        return TrainingState(network, optimizer_state, state.step + 1, average, state.best, state.best_loss), value

    return jax.lax.scan(train_step, state, None, CHUNK)


def _loss(network: Any, key: Array, traffic: Traffic, sampling: Sampling, batch: int) -> Array:
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
        drive, kinds, lanes = jax.random.split(key, 3)
        obstacles = _disturbed_or_not(regular, drive, one.obstacles)
        untold = jax.random.bernoulli(kinds, UNKNOWN, obstacles.kind.shape)
        obstacles = replace(obstacles, kind=jnp.where(untold, jnp.int32(jf.ObstacleKind.UNKNOWN), obstacles.kind))
        lane_map = replace(one.lane_map, valid=one.lane_map.valid & ~jax.random.bernoulli(lanes, UNKNOWN))
        parameters = neural.uncalibrated(network)
        prediction = neural.predict(parameters, obstacles, lane_map, step, neural.LONGEST_HORIZON, first)
        found = score(prediction, obstacles, step)
        return jnp.sum(found.nll + ERROR_WEIGHT * found.error), jnp.sum(found.valid.astype(jnp.float32))

    total, count = jax.vmap(scores)(scene, step, first, regular, draw)
    return jnp.sum(total) / jnp.maximum(jnp.sum(count), 1.0)


def _disturbed_or_not(regular: Array | float, key: Array, obstacles: jf.Obstacles) -> jf.Obstacles:
    """The obstacles of one scene, as they are with probability `regular`."""
    level, drive = jax.random.split(key)
    strength = jnp.maximum(jax.random.uniform(level) - regular, 0.0) / (1.0 - regular)
    other = disturbed(drive, obstacles, strength)
    return jax.tree.map(lambda new, old: jnp.where(strength > 0.0, new, old), other, obstacles)


def _validated(folder: Path, state: TrainingState, groups: list[Group], train_loss: float) -> TrainingState:
    """The state with the best parameters up to now; adds a line to the metrics."""
    losses = _losses(neural.uncalibrated(state.average), groups)
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


@jax.jit
def _validate(parameters: neural.Parameters, traffic: Traffic) -> tuple[Array, Array]:
    found, _ = _predict_all(parameters, traffic)
    count, ends = (jnp.sum(part.astype(jnp.float32)) for part in (found.valid, found.valid[..., END]))
    return jnp.sum(found.nll) / jnp.maximum(count, 1.0), jnp.sum(found.error[..., END]) / jnp.maximum(ends, 1.0)


def _predict_all(parameters: neural.Parameters, traffic: Traffic) -> tuple[Scores, Array]:
    """Scores and logarithmic sizes of predictions at some times, `[scenarios, times, obstacles, steps]`."""
    steps = jnp.arange(0, traffic.obstacles.valid.shape[2] - LEAST_FUTURE, VALIDATION_EVERY)

    def of(one: Traffic) -> tuple[Scores, Array]:
        def at(step: Array) -> tuple[Scores, Array]:
            made = neural.predict(parameters, one.obstacles, one.lane_map, step, neural.LONGEST_HORIZON)
            return score(made, one.obstacles, step), neural.log_size(made.covariance)

        return jax.vmap(at)(steps)

    return jax.lax.map(of, traffic)


def _calibrated(seed: int, network: Any, groups: list[Group]) -> neural.Parameters:
    """The network with such scales that the ellipses of `CALIBRATED` hold that share of held-out positions.

    Scales are found for each step and size, on held-out scenes that are disturbed as the training scenes are.
    """
    parameters = neural.uncalibrated(network)
    distances, sizes, steps, weights = [], [], [], []
    for index, group in enumerate(groups):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), index), len(group.held_out.obstacles.length))
        obstacles = jax.vmap(partial(_disturbed_or_not, group.regular))(keys, group.held_out.obstacles)
        found, size = jax.device_get(jax.jit(_predict_all)(parameters, replace(group.held_out, obstacles=obstacles)))
        distances.append(found.mahalanobis[found.valid])
        sizes.append(size[found.valid])
        steps.append(np.nonzero(found.valid)[-1] + 1)
        weights.append(np.full(len(sizes[-1]), group.weight / max(len(sizes[-1]), 1)))
    distance, size, step, weight = (np.concatenate(part).astype(float) for part in (distances, sizes, steps, weights))
    near_step = [weight * _nearness(step, neural.STEPS, index) for index in range(len(neural.STEPS))]
    near_size = [_nearness(size, np.log(neural.SIZES), index) for index in range(len(neural.SIZES))]
    scale = [[_scale(distance, a * b) for b in near_size] for a in near_step]
    return replace(parameters, scale=jnp.asarray(scale, jnp.float32))


def _nearness(values: np.ndarray, knots: np.ndarray, index: int) -> np.ndarray:
    """Share that a knot has in each value when knots are interpolated linearly."""
    return np.interp(values, knots, np.eye(len(knots))[index])


def _scale(distance: np.ndarray, weight: np.ndarray) -> float:
    """By which covariances are multiplied to hold `CALIBRATED` of the squared Mahalanobis distances."""
    if np.count_nonzero(weight) < LEAST_NEAR:
        return 1.0
    return float(np.clip(_quantile(distance, weight, CALIBRATED) / (-2.0 * np.log(1 - CALIBRATED)), *SCALES))


def _quantile(values: np.ndarray, weight: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    run_command(TrainPredictorOptions, train_predictor, "experiments.train_predictor", arguments)


if __name__ == "__main__":
    main()
