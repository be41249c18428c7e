"""The neural predictor with the parameters that come with the package."""

import dataclasses
from functools import partial
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.prediction import neural
from jaxfrenet.prediction.features import Scene
from jaxfrenet.prediction.lane_paths import PATHS
from jaxfrenet.prediction.network import MOTION, SPREAD, Modes

HORIZON = neural.LONGEST_HORIZON


@pytest.fixture(scope="module")
def predict():
    compiled = jax.jit(partial(neural.predict, neural.default_parameters()), static_argnums=3)

    def of(scenario, step=0, first_step=0) -> jf.Prediction:
        return compiled(scenario.obstacles, scenario.lane_map, jnp.int32(step), HORIZON, jnp.int32(first_step))

    return of


@pytest.fixture(scope="module")
def traffic(world, thing):
    """A car ahead, one that comes along later and leaves again, and a parked one."""
    scenario = world([thing(30.0, 0.0, speed=8.0), thing(60.0, 1.0, speed=5.0, steps=(10, 40)), thing(80.0, -3.0)])
    kind = scenario.obstacles.kind.at[2].set(jf.ObstacleKind.PARKED_VEHICLE)
    return dataclasses.replace(scenario, obstacles=dataclasses.replace(scenario.obstacles, kind=kind))


def assert_sound(prediction: jf.Prediction) -> None:
    """Finite everywhere, positive definite covariances with room for float32."""
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(prediction))
    smallest = np.linalg.eigvalsh(np.asarray(prediction.covariance, float))[..., 0]
    assert (smallest >= 0.5 * neural.SMALLEST_SIGMA**2 * (1 - 0.98)).all()


def changed(scenario, **fields) -> jf.Scenario:
    return dataclasses.replace(scenario, obstacles=dataclasses.replace(scenario.obstacles, **fields))


def test_a_steady_car_goes_on_along_its_lane(predict, world, thing):
    got = predict(world([thing(30.0, 0.0, speed=8.0)]), step=35)
    assert_sound(got)
    expected = 30 + 8 * 3.5 + 8 * 0.1 * np.arange(1, HORIZON + 1)
    np.testing.assert_allclose(got.mean[0, :30, 0], expected[:30], atol=0.5)
    np.testing.assert_allclose(got.mean[0, :30, 1], 0.0, atol=0.2)
    np.testing.assert_allclose(got.heading[0], 0.0, atol=0.1)
    np.testing.assert_allclose(got.speed[0, :30], 8.0, atol=0.6)
    assert float(got.covariance[0, -1, 0, 0]) > float(got.covariance[0, 0, 0, 0])
    assert got.valid[0].all() and not got.valid[1:].any()


def test_parked_and_static_ones_stay_with_small_covariance(predict, traffic, world, thing):
    static = world([thing(30.0, 2.0, speed=3.0, heading=0.3, static=True)])
    for scenario, obstacle in ((traffic, 2), (static, 0)):
        got = predict(scenario, 20)
        place = np.asarray(scenario.obstacles.position[obstacle, 20])
        np.testing.assert_array_equal(got.mean[obstacle], np.broadcast_to(place, (HORIZON, 2)))
        np.testing.assert_allclose(got.covariance[obstacle], np.broadcast_to(0.02 * np.eye(2), (HORIZON, 2, 2)))
        assert not got.speed[obstacle].any() and got.valid[obstacle].all()
    assert predict(static, 500).valid[0].all()


def test_who_comes_and_leaves_is_predicted_while_there(predict, traffic):
    for step, there in ((0, False), (9, False), (10, True), (11, True), (39, True), (40, False), (500, False)):
        got = predict(traffic, step)
        assert_sound(got)
        assert bool(got.valid[1].all()) == there and bool(got.valid[1].any()) == there


def test_nothing_but_the_seen_past_is_read(predict, traffic):
    reference = predict(traffic, 25, first_step=15)
    obstacles = traffic.obstacles
    for hidden in (slice(26, None), slice(0, 15)):
        other = changed(
            traffic,
            position=obstacles.position.at[:, hidden].add(7.0),
            speed=obstacles.speed.at[:, hidden].add(3.0),
            valid=obstacles.valid.at[:, hidden].set(False),
        )
        got = predict(other, 25, first_step=15)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), got, reference)
    seen = changed(traffic, position=obstacles.position.at[0, 20].add(1.0))
    assert np.abs(predict(seen, 25, first_step=15).mean[0] - reference.mean[0]).max() > 1e-3


def test_a_single_step_of_past_is_enough(predict, traffic):
    got = predict(traffic, 30, first_step=30)
    assert_sound(got)
    assert got.valid.all()
    np.testing.assert_allclose(got.mean[0, 9], [30 + 8 * 4, 0], atol=1.0)


@pytest.mark.parametrize("things", [0, 70])
def test_none_and_many_at_once(world, things):
    scenario = world()
    rng = np.random.default_rng(0)
    count = max(things, 1)
    position = rng.uniform([0, -8], [300, 8], (count, 1, 2)).astype(np.float32)
    heading = rng.choice([0, np.pi], (count, 1)).astype(np.float32)
    position = np.repeat(position, 3, axis=1)
    obstacles = jf.Obstacles(
        position=jnp.asarray(position),
        heading=jnp.repeat(jnp.asarray(heading), 3, axis=1),
        speed=jnp.asarray(rng.uniform(-1, 30, (count, 3)), jnp.float32),
        valid=jnp.full((count, 3), things > 0),
        length=jnp.full(count, 4.0),
        width=jnp.full(count, 2.0),
        kind=jnp.asarray(np.arange(count) % len(jf.ObstacleKind), jnp.int32),
        static=jnp.zeros(count, bool),
    )
    got = jax.jit(partial(neural.predict, neural.default_parameters()), static_argnums=3)(
        obstacles, scenario.lane_map, jnp.int32(2), 30
    )
    assert_sound(got)
    assert got.valid.shape == (count, 30) and bool(got.valid.all()) == bool(got.valid.any()) == (things > 0)


def test_padding_and_the_batch_change_nothing(predict, traffic):
    alone = predict(traffic, 20)

    def padded(leaf, count, fill=0):
        widths = [(0, count)] + [(0, 0)] * (leaf.ndim - 1)
        return jnp.pad(leaf, widths, constant_values=jnp.asarray(fill, leaf.dtype))

    obstacles = jax.tree.map(lambda leaf: padded(leaf, 4), traffic.obstacles)
    lane_map = jax.tree.map(lambda leaf: padded(leaf, 3), traffic.lane_map)
    lane_map = dataclasses.replace(
        lane_map,
        length=padded(traffic.lane_map.length, 3, 1),
        successors=padded(traffic.lane_map.successors, 3, -1),
    )
    more = dataclasses.replace(traffic, obstacles=obstacles, lane_map=lane_map)
    got = jax.tree.map(lambda leaf: leaf[:3], predict(more, 20))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-4), got, alone)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), traffic)
    both = jax.jit(
        jax.vmap(lambda one, step: neural.predict(
            neural.default_parameters(), one.obstacles, one.lane_map, step, HORIZON
        ))
    )(batch, jnp.asarray([20, 33], jnp.int32))  # fmt: skip
    for row, step in enumerate((20, 33)):
        expected = predict(traffic, step)
        jax.tree.map(lambda a, b, i=row: np.testing.assert_allclose(a[i], b, atol=2e-4), both, expected)


def test_turning_and_moving_the_world_turns_and_moves_the_prediction(predict, traffic):
    angle, shift = 2.0, np.array([40.0, -70.0])
    cos, sin = np.cos(angle), np.sin(angle)
    turn = jnp.asarray([[cos, sin], [-sin, cos]], jnp.float32)

    def moved(points):
        return points @ turn + jnp.asarray(shift, jnp.float32)

    other = changed(
        traffic, position=moved(traffic.obstacles.position), heading=traffic.obstacles.heading + np.float32(angle)
    )
    center = moved(traffic.lane_map.center)
    other = dataclasses.replace(other, lane_map=dataclasses.replace(traffic.lane_map, center=center))
    before, after = predict(traffic, 30), predict(other, 30)
    np.testing.assert_allclose(after.mean, moved(before.mean), atol=5e-3)
    turned = np.einsum("ji,okjl,lm->okim", turn, before.covariance, turn)
    np.testing.assert_allclose(after.covariance, turned, atol=5e-3)
    np.testing.assert_allclose(after.heading, before.heading + angle, atol=5e-3)
    np.testing.assert_allclose(after.speed, before.speed, atol=5e-3)


def test_looked_up_predictions_are_those_of_each_step(config, traffic):
    config = dataclasses.replace(config, predictor="neural")
    tabled = jax.jit(jf.with_predictions, static_argnums=0)(config, traffic)
    live = jax.jit(partial(jf.predict, config))
    for step in (0, 10, 25, 60, 70):
        where = jnp.int32(step), jnp.float32(20.0), jnp.float32(0.0)
        expected, got = live(traffic, *where), live(tabled, *where)
        np.testing.assert_array_equal(got.valid, expected.valid)
        for name in ("mean", "covariance", "heading", "speed"):
            mask = np.asarray(expected.valid)
            a, b = (np.asarray(getattr(one, name))[mask] for one in (got, expected))
            np.testing.assert_allclose(a, b, atol=2e-4, err_msg=name)
    with pytest.raises(ValueError, match="horizon_steps is 40, .* have 30"):
        jf.predict(dataclasses.replace(config, horizon_steps=40), tabled, *where)
    with pytest.raises(ValueError, match="1 … 50"):
        jf.predict(dataclasses.replace(config, horizon_steps=51), traffic, *where)
    assert jf.with_predictions(dataclasses.replace(config, predictor="ground_truth"), traffic) is traffic


def test_the_table_is_used_only_by_the_neural_predictor(config, traffic):
    neural_config = dataclasses.replace(config, predictor="neural")
    tabled = jf.with_predictions(neural_config, traffic)
    assert tabled.predictions is not None
    wrong = dataclasses.replace(tabled.predictions, mean=tabled.predictions.mean + 100.0)
    tabled = dataclasses.replace(tabled, predictions=wrong)
    where = jnp.int32(20), jnp.float32(20.0), jnp.float32(0.0)
    np.testing.assert_array_equal(jf.predict(config, tabled, *where).mean, jf.predict(config, traffic, *where).mean)
    assert np.abs(jf.predict(neural_config, tabled, *where).mean[0] - tabled.obstacles.position[0, 21]).max() > 50


def test_calibration_scales_covariances_by_step_and_size(traffic):
    plain = dataclasses.replace(neural.default_parameters(), scale=jnp.ones((len(neural.STEPS), len(neural.SIZES))))
    chosen = jnp.where(jnp.asarray(neural.STEPS)[:, None] <= 10, 4.0, 1.0) * plain.scale
    chosen = chosen.at[-1].set(jnp.asarray(np.geomspace(0.5, 2.0, len(neural.SIZES)), jnp.float32))
    predict = jax.jit(neural.predict, static_argnums=4)
    arguments = traffic.obstacles, traffic.lane_map, jnp.int32(25), HORIZON
    before, after = predict(plain, *arguments), predict(dataclasses.replace(plain, scale=chosen), *arguments)
    np.testing.assert_array_equal(before.mean, after.mean)
    factor = np.asarray(after.covariance[0, :, 0, 0] / before.covariance[0, :, 0, 0])
    np.testing.assert_allclose(factor[:10], 4.0, rtol=1e-4)
    np.testing.assert_allclose(factor[14], 2.5, rtol=1e-4)
    np.testing.assert_allclose(factor[19:40], 1.0, rtol=1e-4)
    size = np.linalg.det(np.asarray(before.covariance[0, -1], float)) ** 0.25
    expected = np.interp(np.log(size), np.log(neural.SIZES), np.geomspace(0.5, 2.0, len(neural.SIZES)))
    np.testing.assert_allclose(factor[-1], expected, rtol=2e-3)
    np.testing.assert_allclose(after.covariance[2], before.covariance[2])


def modes(logit, along, across, spread) -> Modes:
    """One obstacle; the given modes are the straight one and the last lane paths, the others have no weight."""
    rest = PATHS + 1 - len(logit)
    return Modes(
        logit=jnp.asarray([[-1e3] * rest + list(logit)], jnp.float32),
        along=jnp.pad(jnp.asarray(along, jnp.float32), ((rest, 0), (0, 0)))[None],
        across=jnp.pad(jnp.asarray(across, jnp.float32), ((rest, 0), (0, 0)))[None],
        spread=jnp.pad(jnp.asarray(spread, jnp.float32), ((rest, 0), (0, 0), (0, 0)))[None],
    )


@pytest.fixture(scope="module")
def scene(world):
    """An obstacle at (50, 1) at 6 m/s, heading 0.2 rad to the left of the straight lane."""
    lane_map = world().lane_map
    direction = jnp.asarray([[np.cos(0.2), np.sin(0.2)]], jnp.float32)
    paths = jax.vmap(lambda p, d: neural.lane_paths.find(lane_map, p, d[0], d[1]))(
        jnp.asarray([[50.0, 1.0]]), direction
    )
    everywhere = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:, :1], leaf.shape), paths)
    return lane_map, Scene(
        jnp.asarray([[50.0, 1.0]]), jnp.asarray([0.2]), direction, jnp.asarray([6.0]), jnp.asarray([True]), everywhere
    )


def test_moments_of_two_modes_are_those_of_their_mixture(scene):
    """Against the formulas of `neural`, evaluated in float64 with NumPy."""
    lane_map, scene = scene
    rng = np.random.default_rng(3)
    logit, along, across = [0.3, -0.4], rng.normal(0, 0.3, (2, MOTION)), rng.normal(0, 0.3, (2, MOTION))
    spread = rng.normal(0, 0.5, (2, 3, SPREAD))
    found = jax.jit(neural._moments, static_argnums=3)(scene, lane_map, modes(logit, along, across, spread), HORIZON)
    mean, covariance, heading, speed = (np.asarray(part[0], float) for part in found)

    tau = np.arange(1, HORIZON + 1) / HORIZON
    time = 5.0 * tau
    weight = np.exp(logit) / np.exp(logit).sum()
    powers = np.stack([tau ** (j + 2) for j in range(MOTION)])
    basis = np.stack([np.ones(HORIZON), np.log(tau + 0.02) + 1, tau, tau**2])
    places, covariances = [], []
    for mode, (angle, offset) in enumerate(((0.0, 1.0), (0.2, 0.0))):  # on the lane, then straight on
        relative = 0.2 - angle
        s = 6 * np.cos(relative) * time + 10 * along[mode] @ powers
        d = offset + 6 * np.sin(relative) * time * (1 - tau) ** 2 + 5 * across[mode] @ powers
        tangent, normal = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        start = np.array([50.0, 1.0]) - offset * normal
        places.append(start + s[:, None] * tangent + d[:, None] * normal)
        raw = spread[mode] @ basis
        sigma = np.exp(np.clip(raw[:2] - 1, np.log(neural.SMALLEST_SIGMA), np.log(neural.LARGEST_SIGMA)))
        rho = 0.98 * np.tanh(raw[2])
        turn = np.stack([tangent, normal])
        local = np.array([[sigma[0] ** 2, rho * sigma[0] * sigma[1]], [rho * sigma[0] * sigma[1], sigma[1] ** 2]])
        covariances.append(np.einsum("ai,abt,bj->tij", turn, local, turn))
    expected = sum(w * place for w, place in zip(weight, places, strict=True))
    np.testing.assert_allclose(mean, expected, atol=2e-4)
    total = sum(
        w * (own + np.einsum("ti,tj->tij", place - expected, place - expected))
        for w, own, place in zip(weight, covariances, places, strict=True)
    )
    np.testing.assert_allclose(covariance, total, rtol=2e-3, atol=2e-4)
    assert np.isfinite(heading).all() and (speed >= 0).all()


def test_heading_follows_the_motion(scene):
    lane_map, scene = scene
    none = np.zeros((1, MOTION))
    straight = neural._moments(scene, lane_map, modes([0.0], none, none, np.zeros((1, 3, SPREAD))), HORIZON)
    np.testing.assert_allclose(straight[2][0], 0.2, atol=1e-5)
    np.testing.assert_allclose(straight[3][0], 6.0, atol=1e-4)
    on_lane = modes([0.0, -1e3], np.zeros((2, MOTION)), np.zeros((2, MOTION)), np.zeros((2, 3, SPREAD)))
    mean, _, heading, _ = (np.asarray(part[0]) for part in neural._moments(scene, lane_map, on_lane, HORIZON))
    step = np.gradient(mean, axis=0)
    np.testing.assert_allclose(heading[1:-1], np.arctan2(step[1:-1, 1], step[1:-1, 0]), atol=5e-3)


def test_shipped_parameters_are_small_and_others_can_be_read(tmp_path):
    shipped = resources.files("jaxfrenet.prediction") / "neural.npz"
    assert len(shipped.read_bytes()) < 3e6
    parameters = neural.default_parameters()
    neural.save_parameters(tmp_path / "mine.npz", parameters)
    jax.tree.map(np.testing.assert_array_equal, neural.load_parameters(tmp_path / "mine.npz"), parameters)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "mine.npz").read_bytes()[:5000])
    (tmp_path / "empty.npz").write_bytes(b"")
    np.savez(tmp_path / "other.npz", weights=np.zeros(3))
    for name in ("cut", "empty", "other"):
        with pytest.raises(ValueError, match=f"{name}.npz: holds no parameters of this network; train anew"):
            neural.load_parameters(tmp_path / f"{name}.npz")
    wide = jax.tree.map(lambda leaf: np.zeros((*leaf.shape, 2), np.float32), parameters)
    neural.save_parameters(tmp_path / "wide.npz", wide)
    with pytest.raises(ValueError, match="this network has"):
        neural.load_parameters(tmp_path / "wide.npz")
    with pytest.raises(FileNotFoundError):
        neural.load_parameters(tmp_path / "none.npz")
