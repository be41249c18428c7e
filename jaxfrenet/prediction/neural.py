"""Prediction by a neural network: lanes, neighbours and the past become one Gaussian per coming step.

Each mode of `network.Modes` is a motion along a path, in the path's own coordinates; over τ = t / 5 s

    s(t) = v cos Δθ t + 10 m Σ_j a_j τ^(j+1),    d(t) = d₀ + v sin Δθ t (1 - τ)² + 5 m Σ_j b_j τ^(j+1),

with log-linear standard deviations along and across it. The prediction is the Gaussian with the mean and covariance of
the mixture of all modes, so that it is positive definite whatever the network says.
"""

from __future__ import annotations

import functools
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfrenet._pytree import pytree_dataclass
from jaxfrenet._typing import Array, Float, Int
from jaxfrenet.config import DT
from jaxfrenet.prediction import lane_paths
from jaxfrenet.prediction.constant_velocity import STATIC_VARIANCE
from jaxfrenet.prediction.features import Scene, in_frame, observe
from jaxfrenet.prediction.network import Modes, MotionNetwork
from jaxfrenet.prediction.types import Prediction
from jaxfrenet.scenario import LANE_NODES, LaneMap, ObstacleKind, Obstacles

LONGEST_HORIZON = 50
"""Most steps that can be predicted: 5 s."""
SMALLEST_SIGMA, LARGEST_SIGMA = 0.02, 60.0
"""Range of a mode's standard deviations [m]."""
SIZES = np.geomspace(0.01, 10.24, 11)
"""Sizes of Gaussians, the geometric mean of their two standard deviations [m], at which covariances are calibrated."""
STEPS = np.array([1, 10, 20, 30, 40, 50])
"""Steps ahead at which they are."""
ROUNDING = 1e-6
"""Share of a covariance's trace added to its diagonal, so that it is positive definite in float32 as well."""
SLOWEST = 1.0
"""Below this speed [m/s] motion across a path turns the heading less."""
NETWORK = MotionNetwork()


@pytree_dataclass
class Parameters:
    """All that training finds."""

    network: Any
    """Parameters of `NETWORK`, a pytree."""
    scale: Float[Array, "steps sizes"]
    """`[len(STEPS), len(SIZES)]`, factors of covariances at these steps and sizes, from calibration."""


def predict(
    parameters: Parameters,
    obstacles: Obstacles,
    lane_map: LaneMap,
    step: Int[Array, ""],
    horizon_steps: int,
    first_step: Int[Array, ""] | int = 0,
) -> Prediction:
    """What the network says at `step`, of which nothing later is read.

    Obstacles that do not exist at the step are not valid; static and parked ones stay where they are.

    Args:
      parameters: see `load_parameters`.
      obstacles: recorded obstacles.
      lane_map: the lanes around them.
      step: the current step.
      horizon_steps: number of coming steps, at most `LONGEST_HORIZON`.
      first_step: steps before this one are taken for not observed.

    Raises:
      ValueError: the horizon is too long.
    """
    if not 0 < horizon_steps <= LONGEST_HORIZON:
        raise ValueError(f"horizon of {horizon_steps} steps: the neural predictor sees 1 … {LONGEST_HORIZON} ahead")
    scene, seen = observe(obstacles, lane_map, step, first_step)
    modes: Modes = NETWORK.apply(parameters.network, seen)  # pyright: ignore[reportAssignmentType]
    mean, covariance, heading, speed = _moments(scene, lane_map, modes, horizon_steps)
    covariance = _calibrated(jnp.asarray(parameters.scale), covariance)
    covariance = covariance + ROUNDING * jnp.trace(covariance, axis1=-2, axis2=-1)[..., None, None] * jnp.eye(2)
    still = obstacles.static | (obstacles.kind == ObstacleKind.PARKED_VEHICLE)
    valid = scene.present | obstacles.static
    still_covariance = STATIC_VARIANCE * jnp.eye(2)
    covariance = jnp.where(still[:, None, None, None], still_covariance, covariance)
    return Prediction(
        mean=jnp.where(still[:, None, None], scene.position[:, None], mean),
        covariance=jnp.where(valid[:, None, None, None], covariance, jnp.eye(2)),
        heading=jnp.where(still[:, None], scene.heading[:, None], heading),
        speed=jnp.where(still[:, None], 0.0, speed),
        valid=jnp.broadcast_to(valid[:, None], heading.shape),
        length=obstacles.length,
        width=obstacles.width,
    )


def _moments(scene: Scene, lane_map: LaneMap, modes: Modes, steps: int) -> tuple[Array, Array, Array, Array]:
    """Mean `[obstacles, steps, 2]`, covariance, heading and speed of the mixture of all modes."""
    exists = jnp.pad(scene.paths.valid, ((0, 0), (0, 1)), constant_values=True)
    weight = jax.nn.softmax(jnp.where(exists, modes.logit, -1e9), axis=-1)[..., None]
    cos, sin = (_with_straight(part, last) for part, last in ((scene.paths.cos, 1.0), (scene.paths.sin, 0.0)))
    offset = _with_straight(scene.paths.offset, 0.0)
    speed = scene.speed[:, None]
    s, rate, d, drift = _motion(modes, speed * cos, offset, speed * sin, steps)
    base, tangent = jax.vmap(lane_paths.look_up, in_axes=(None, 0, 0))(lane_map, scene.paths, s[:, :-1])
    direction = jnp.broadcast_to(scene.direction[:, None, None], (*s[:, -1:].shape, 2))
    tangent = jnp.concatenate([tangent, direction], axis=1)
    base = base - scene.position[:, None, None]
    base = jnp.concatenate([base, s[:, -1:, :, None] * direction], axis=1)
    normal = jnp.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    place = base + d[..., None] * normal
    place = jnp.where(exists[..., None, None], place, 0.0)
    mean = jnp.sum(weight[..., None] * place, axis=1)
    away = place - mean[:, None]
    between = away[..., 0] ** 2, away[..., 0] * away[..., 1], away[..., 1] ** 2
    within = _covariance(modes, tangent, normal, steps)
    xx, xy, yy = (jnp.sum(weight * (a + b), axis=1) for a, b in zip(within, between, strict=True))
    covariance = jnp.stack([jnp.stack([xx, xy], axis=-1), jnp.stack([xy, yy], axis=-1)], axis=-2)
    # Heading and speed are not trained: at zero they have no gradient.
    weight, rate, drift = jax.lax.stop_gradient((weight, rate, drift))
    slope = drift / jnp.maximum(jnp.abs(rate), SLOWEST)
    pointing = jnp.sum(weight[..., None] * (tangent + slope[..., None] * normal), axis=1)
    turned = in_frame(pointing, scene.direction[:, None])
    heading = scene.heading[:, None] + jnp.arctan2(turned[..., 1], turned[..., 0])
    velocity = jnp.sum(weight * jnp.hypot(jnp.maximum(rate, 0.0), drift), axis=1)
    return scene.position[:, None] + mean, covariance, heading, velocity


def _calibrated(scale: Array, covariance: Array) -> Array:
    """Covariances `[obstacles, steps, 2, 2]` multiplied by a factor for their step and size."""
    steps = covariance.shape[1]
    shares = np.array([np.interp(np.arange(1, steps + 1), STEPS, row) for row in np.eye(len(STEPS))])
    of_step = jnp.asarray(shares.T, jnp.float32) @ scale
    at = jnp.asarray(np.log(SIZES), jnp.float32)
    interpolated = jax.vmap(jnp.interp, in_axes=(1, None, 0), out_axes=1)
    factor = interpolated(log_size(jax.lax.stop_gradient(covariance)), at, of_step)
    return factor[..., None, None] * covariance


def log_size(covariance: Float[Array, "*shape 2 2"]) -> Float[Array, "*shape"]:
    """Logarithm of a Gaussian's size, the geometric mean of its two standard deviations [m]."""
    determinant = covariance[..., 0, 0] * covariance[..., 1, 1] - covariance[..., 0, 1] ** 2
    return 0.25 * jnp.log(jnp.maximum(determinant, 1e-12))


def _with_straight(of_paths: Array, of_straight: float) -> Array:
    return jnp.pad(of_paths, ((0, 0), (0, 1)), constant_values=of_straight)


def _motion(modes: Modes, ahead: Array, offset: Array, aside: Array, steps: int) -> tuple[Array, Array, Array, Array]:
    """Arc length, its rate, offset and its rate at the coming steps, each `[obstacles, modes, steps]`."""
    horizon = LONGEST_HORIZON * DT
    tau = np.arange(1, steps + 1) / LONGEST_HORIZON
    powers = np.stack([tau ** (j + 2) for j in range(modes.along.shape[-1])])
    rates = np.stack([(j + 2) * tau ** (j + 1) / horizon for j in range(modes.along.shape[-1])])
    powers, rates = jnp.asarray(powers, jnp.float32), jnp.asarray(rates, jnp.float32)
    time = jnp.asarray(horizon * tau, jnp.float32)
    fading = jnp.asarray(horizon * tau * (1 - tau) ** 2, jnp.float32)
    fading_rate = jnp.asarray((1 - tau) * (1 - 3 * tau), jnp.float32)
    s = ahead[..., None] * time + 10.0 * modes.along @ powers
    d = offset[..., None] + aside[..., None] * fading + 5.0 * modes.across @ powers
    rate = ahead[..., None] + 10.0 * modes.along @ rates
    drift = aside[..., None] * fading_rate + 5.0 * modes.across @ rates
    return s, rate, d, drift


def _covariance(modes: Modes, tangent: Array, normal: Array, steps: int) -> tuple[Array, Array, Array]:
    """Each mode's own covariance in the map's axes: xx, xy, yy `[obstacles, modes, steps]`."""
    tau = np.arange(1, steps + 1) / LONGEST_HORIZON
    basis = jnp.asarray(np.stack([np.ones(steps), np.log(tau + 0.02) + 1.0, tau, tau**2]), jnp.float32)
    raw = modes.spread @ basis
    lowest, highest = np.log(SMALLEST_SIGMA), np.log(LARGEST_SIGMA)
    along, across = (jnp.exp(jnp.clip(raw[:, :, i] - 1.0, lowest, highest)) for i in range(2))
    mixed = 0.98 * jnp.tanh(raw[:, :, 2]) * along * across

    def entry(i: int, j: int) -> Array:
        t, n = (tangent[..., i], tangent[..., j]), (normal[..., i], normal[..., j])
        crossed = t[0] * n[1] + n[0] * t[1]
        return along**2 * t[0] * t[1] + across**2 * n[0] * n[1] + mixed * crossed

    return entry(0, 0), entry(0, 1), entry(1, 1)


def initial_network(key: Array, obstacles: Obstacles, lane_map: LaneMap) -> Any:
    """Random parameters of `NETWORK` for training; the obstacles and lanes of any scenario give the shapes."""
    return NETWORK.init(key, observe(obstacles, lane_map, jnp.int32(0))[1])


def uncalibrated(network: Any) -> Parameters:
    """Parameters of `NETWORK` with covariances as they come from it."""
    return Parameters(network, jnp.ones((len(STEPS), len(SIZES))))


def save_parameters(path: str | Path, parameters: Parameters) -> None:
    """Write parameters as a `.npz` file of one array per layer, replacing an existing file as a whole."""
    named = {jax.tree_util.keystr(where, simple=True, separator="/"): np.asarray(leaf)
             for where, leaf in jax.tree_util.tree_leaves_with_path(parameters)}  # fmt: skip
    partial = Path(f"{path}.partial")
    with partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **named)
    partial.replace(path)


def load_parameters(path: str | Path | None = None) -> Parameters:
    """Read parameters; those that come with the package if there is no path.

    Raises:
      OSError: the file cannot be read.
      ValueError: it does not hold parameters of this network.
    """
    file = resources.files("jaxfrenet.prediction") / "neural.npz" if path is None else Path(path)
    expected = jax.tree_util.tree_leaves_with_path(_parameter_shapes())
    names = [jax.tree_util.keystr(where, simple=True, separator="/") for where, _ in expected]
    try:
        with file.open("rb") as handle, np.load(handle, allow_pickle=False) as archive:
            leaves = [archive[name] for name in names]
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile):
        raise ValueError(f"{file}: holds no parameters of this network; train anew") from None
    for name, leaf, (_, shape) in zip(names, leaves, expected, strict=True):
        if leaf.shape != shape.shape:
            raise ValueError(f"{file}: {name} is {leaf.shape}, this network has {shape.shape}; train anew")
    structure = jax.tree.structure(_parameter_shapes())
    return jax.tree.unflatten(structure, [jnp.asarray(leaf, jnp.float32) for leaf in leaves])


@functools.cache
def default_parameters() -> Parameters:
    """The parameters that come with the package, read once, as NumPy arrays."""
    with jax.ensure_compile_time_eval():
        return jax.device_get(load_parameters())


@functools.cache
def _parameter_shapes() -> Parameters:
    """Shapes of the network's parameters; no array is made."""

    def made(key: Array) -> Parameters:
        return uncalibrated(initial_network(key, *_nothing()))

    return jax.eval_shape(made, jax.random.key(0))


def _nothing() -> tuple[Obstacles, LaneMap]:
    """One obstacle and one piece of lane, neither of which exists."""
    zero, no = jnp.zeros((1, 1)), jnp.zeros((1, 1), bool)
    obstacles = Obstacles(
        jnp.zeros((1, 1, 2)), zero, zero, no, zero[0], zero[0], jnp.zeros(1, jnp.int32), jnp.zeros(1, bool)
    )
    center = jnp.zeros((1, LANE_NODES, 2))
    return obstacles, LaneMap(center, jnp.ones(1), jnp.full((1, 3), -1, jnp.int32), jnp.zeros(1, bool))
