"""Risk against the definition, one pair at a time in float64, and against values worked out by hand."""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.harm import Party, harm, obstacle_mass
from jaxfrenet.risk import PAIRS, TRAJECTORIES, collision_probability, surrogate_probability
from jaxfrenet.trajectories import Pose

multivariate_normal = pytest.importorskip("scipy.stats").multivariate_normal

CAR = jf.BMW_320I
THIRD = CAR.length / 3
CONFIG = jf.PlannerConfig(sampling_level=0)
OBSTACLES = jf.ObstacleKind.STRUCTURE.value
"""One of every kind before the last, which harms both sides alike and would hide the others."""


def single(value) -> jax.Array:
    return jnp.asarray(value, jnp.float32)


@jax.jit
def probability(ego, mean, heading, covariance, length):
    """`ego` holds x, y, heading."""
    still = jnp.float32(0)
    at, obstacle = Party(ego[0], ego[1], ego[2], still, still), Party(mean[0], mean[1], heading, still, still)
    return collision_probability(CAR, at, obstacle, covariance, length)


def box_mass(center, mean, covariance) -> float:
    """Of a third of the car, along the map's axes; inclusion and exclusion of the cumulative distribution."""
    total = 0.0
    for a, b in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        corner = center + np.array([a * THIRD / 2, b * CAR.width / 2])
        total += a * b * multivariate_normal.cdf(corner, mean, covariance, abseps=1e-9, releps=1e-9)
    return total


def plain_probability(ego, mean, heading, covariance, length) -> float:
    center, along = np.array(ego[:2]), np.array([math.cos(ego[2]), math.sin(ego[2])])
    ahead = 0.5 * length * np.array([math.cos(heading), math.sin(heading)])
    points = [mean, mean + ahead, mean - ahead]
    if all(np.linalg.norm(point - center) > 5.0 for point in points):
        return 0.0
    boxes = [center + shift * along for shift in (-THIRD, 0.0, THIRD)]
    return sum(box_mass(box, point, covariance) for box in boxes for point in points) / 3


def check_probability(*case):
    rounded = [np.asarray(value, np.float32) for value in case]
    expected = plain_probability(*(value.astype(np.float64) for value in rounded))
    assert abs(float(probability(*rounded)) - expected) < 1e-4


def covariance_of(sigma_x, sigma_y, correlation) -> np.ndarray:
    mixed = correlation * sigma_x * sigma_y
    return np.array([[sigma_x**2, mixed], [mixed, sigma_y**2]])


def test_probability_agrees_with_scipy():
    rng = np.random.default_rng(0)
    for _ in range(150):
        sigmas = np.exp(rng.uniform(np.log(0.1), np.log(5.0), 2))
        correlation = rng.choice([rng.uniform(-0.99, 0.99), 0.99, -0.99])
        ego = [*rng.uniform(-4, 4, 2), rng.uniform(-7, 7)]
        mean, heading, length = np.array([0.5, -0.3]), rng.uniform(-7, 7), rng.uniform(0.3, 12)
        check_probability(ego, mean, heading, covariance_of(sigmas[0], sigmas[1], correlation), length)


@pytest.mark.parametrize("sigmas", [(0.1, 0.1), (5.0, 5.0), (0.1, 5.0), (5.0, 0.1)])
@pytest.mark.parametrize("correlation", [-0.99, 0.0, 0.99])
@pytest.mark.parametrize("heading", [0.0, math.pi / 4, -2.5])
def test_probability_of_tiny_large_and_correlated_covariances(sigmas, correlation, heading):
    check_probability([1.0, -0.9, heading], np.zeros(2), 2.0, covariance_of(sigmas[0], sigmas[1], correlation), 4.5)


def test_probability_by_hand():
    """Certainly there: all three points in the boxes; front and rear beyond the ego's ends; all of them away."""
    exact = 1e-4 * np.eye(2)
    for length, mean, heading, expected in (
        (1.0, [0.0, 0.0], 0.0, 1.0),
        (6.0, [0.0, 0.0], 0.0, 1 / 3),
        (6.0, [0.0, 2.0], math.pi / 2, 0.0),
        (4.0, [0.0, 2.0], math.pi / 2, 1 / 3),
    ):
        got = probability(*map(single, ([0.0, 0.0, 0.0], mean, heading, exact, length)))
        assert float(got) == pytest.approx(expected, abs=1e-5), (length, mean)


def test_nothing_is_probable_beyond_five_meters():
    wide = 9.0 * np.eye(2)
    for away, length, counts in ((4.99, 0.0, True), (5.01, 0.0, False), (7.4, 4.84, True), (7.4, 4.76, False)):
        got = float(probability(*map(single, ([30.0, 2.0, 0.6], [30.0, 2.0 + away], math.pi / 2, wide, length))))
        assert (got > 1e-3) if counts else (got == 0.0), (away, length)


def test_surrogate():
    covariance = covariance_of(2.0, 0.5, 0.8)
    mean, places = np.array([3.0, -1.0]), np.array([[3.0, -1.0], [3.5, -1.0], [9.0, 4.0], [2000.0, 0.0]])
    away = places - mean
    squared = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
    assert squared[1] < 1.0 < squared[2]
    got = surrogate_probability(*map(single, (*places.T, mean, covariance)))
    np.testing.assert_allclose(got, 1 / np.maximum(squared, 1.0) ** 2, rtol=1e-4)
    assert float(got[0]) == 1.0


def random_case(rng, base: jf.Scenario):
    """A bundle of random poses among obstacles of every such kind with random covariances, some not valid."""
    shape, steps = (CONFIG.trajectories, CONFIG.points), CONFIG.horizon_steps
    kinds = jnp.asarray(rng.permutation(OBSTACLES), jnp.int32)
    size = rng.uniform([1.9, 1.8], [9.0, 2.6], (OBSTACLES, 2))
    track = (OBSTACLES, steps)
    everywhere = jnp.zeros(track)
    obstacles = jf.Obstacles(
        position=jnp.zeros((*track, 2)),
        heading=everywhere,
        speed=everywhere,
        valid=jnp.ones(track, bool),
        length=single(size[:, 0]),
        width=single(size[:, 1]),
        kind=kinds,
        static=jnp.zeros(OBSTACLES, bool),
    )
    root = rng.normal(0, 0.8, (*track, 2, 2))
    prediction = jf.Prediction(
        mean=single(rng.uniform([150, -9], [170, 9], (*track, 2))),
        covariance=single(root @ np.swapaxes(root, -1, -2) + 0.05 * np.eye(2)),
        heading=single(rng.uniform(-7, 7, track)),
        speed=single(rng.uniform(0, 20, track)),
        valid=jnp.asarray(rng.random(track) < 0.8),
        length=single(size[:, 0] + 0.5),
        width=single(size[:, 1] + 0.2),
    )
    names = [field.name for field in dataclasses.fields(jf.EgoState)]
    motion = jf.EgoState(**dict.fromkeys(names, jnp.zeros(shape)))
    poses = dict(x=rng.uniform(150, 170, shape), y=rng.uniform(-9, 9, shape), heading=rng.uniform(-7, 7, shape))
    motion = dataclasses.replace(
        motion, **{n: single(v) for n, v in poses.items()}, speed=single(rng.uniform(0, 20, shape))
    )
    return dataclasses.replace(base, obstacles=obstacles), prediction, bundle_of(motion)


def bundle_of(motion: jf.EgoState) -> jf.Bundle:
    one = jnp.zeros(motion.x.shape[0])
    cos, sin = jnp.cos(motion.heading), jnp.sin(motion.heading)
    pose = Pose(motion.x, motion.y, cos, sin, motion.offset, jnp.zeros_like(cos))
    return jf.Bundle(motion, pose, one == 0, jnp.zeros(one.shape, jnp.int32), *[one] * 4)


def stacked(cases):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *cases)


def row(tree, index):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def plain_risk(scenario, prediction, motion) -> tuple[float, float, int]:
    """Largest p · H over every pair of one trajectory, and how many pairs are near; harm has its own tests."""
    ego_risk = third_party_risk = 0.0
    near = 0
    ahead = CAR.rear_axle_to_center
    for obstacle, step in np.argwhere(np.asarray(prediction.valid)):
        heading = float(motion.heading[step + 1])
        x, y = motion.x[step + 1] + ahead * math.cos(heading), motion.y[step + 1] + ahead * math.sin(heading)
        mean = np.asarray(prediction.mean[obstacle, step], np.float64)
        turned, length = float(prediction.heading[obstacle, step]), float(prediction.length[obstacle])
        covariance = np.asarray(prediction.covariance[obstacle, step], np.float64)
        p = plain_probability([float(x), float(y), heading], mean, turned, covariance, length)
        if p == 0.0:
            continue
        near += 1
        kind, size = scenario.obstacles.kind[obstacle], (scenario.obstacles.length, scenario.obstacles.width)
        mass = obstacle_mass(kind, *(side[obstacle] for side in size))
        ego = Party(x, y, motion.heading[step + 1], motion.speed[step + 1], jnp.float32(CAR.mass))
        other = Party(single(mean[0]), single(mean[1]), single(turned), prediction.speed[obstacle, step], mass)
        harmed = harms(ego, other, kind)
        ego_risk = max(ego_risk, p * float(harmed.ego))
        third_party_risk = max(third_party_risk, p * float(harmed.third_party))
    return ego_risk, third_party_risk, near


harms = jax.jit(partial(harm, "symmetric_areas"))
bundles = jax.jit(jax.vmap(partial(jf.assess_bundle, CONFIG)))
one = jax.jit(partial(jf.assess, CONFIG))


@pytest.fixture(scope="module")
def assessed(world):
    """Two random cases and their risks, found in one batch."""
    rng = np.random.default_rng(5)
    cases = [random_case(rng, world()) for _ in range(2)]
    return cases, bundles(*stacked(cases))


def test_risk_is_the_definition_over_every_pair(assessed):
    cases, risks = assessed
    for index, (scenario, prediction, bundle) in enumerate(cases):
        for trajectory in (13 + index, 47 - index):
            ego, third_party, near = plain_risk(scenario, prediction, row(bundle.motion, trajectory))
            assert near > PAIRS
            assert 0.0 < ego != third_party > 0.0
            assert float(risks.ego[index, trajectory]) == pytest.approx(ego, abs=1e-4)
            assert float(risks.third_party[index, trajectory]) == pytest.approx(third_party, abs=1e-4)


def test_a_batch_of_bundles_gives_what_each_trajectory_gives_alone(assessed):
    cases, risks = assessed
    assert risks.ego.shape == (2, CONFIG.trajectories) and CONFIG.trajectories % TRAJECTORIES
    for index, (scenario, prediction, bundle) in enumerate(cases):
        for trajectory in range(CONFIG.trajectories):
            alone = one(scenario, prediction, row(bundle.motion, trajectory))
            for got, expected in zip(jax.tree.leaves(risks), jax.tree.leaves(alone), strict=True):
                assert float(got[index, trajectory]) == pytest.approx(float(expected), abs=2e-6)


def test_who_is_not_valid_is_no_risk(assessed):
    """Whatever the entries hold: prediction of nobody, and nobody but a standing one far away."""
    (scenario, prediction, bundle), _ = assessed[0]
    nobody = dataclasses.replace(prediction, valid=jnp.zeros_like(prediction.valid))
    huge = jax.tree.map(lambda leaf: jnp.full_like(leaf, 1e30), nobody)
    huge = dataclasses.replace(huge, valid=nobody.valid, covariance=nobody.covariance)
    for empty in (nobody, huge):
        risk = one(scenario, empty, row(bundle.motion, 3))
        assert float(risk.ego) == float(risk.third_party) == 0.0
        assert np.isfinite(float(risk.boundary_harm))


def test_point_i_meets_entry_i_minus_1(assessed, world):
    """An obstacle at the ego's place at one entry only, in a prediction longer than the trajectory."""
    (_, prediction, bundle), _ = assessed[0]
    motion = row(bundle.motion, 0)
    base = dataclasses.replace(world(), obstacles=assessed[0][0][0].obstacles)
    for entry in (0, 7, CONFIG.horizon_steps - 1):
        cos, sin = jnp.cos(motion.heading[entry + 1]), jnp.sin(motion.heading[entry + 1])
        ahead = CAR.rear_axle_to_center
        mean = jnp.stack([motion.x[entry + 1] + ahead * cos, motion.y[entry + 1] + ahead * sin])
        valid = jnp.zeros_like(prediction.valid).at[:, entry].set(True)
        there = dataclasses.replace(
            prediction, mean=jnp.full_like(prediction.mean, -50.0).at[2, entry].set(mean), valid=valid
        )
        assert float(one(base, there, motion).third_party) > 1e-3
        moved = dataclasses.replace(there, valid=jnp.roll(valid, 1, axis=1))
        assert float(one(base, moved, motion).third_party) == 0.0


def test_leaving_the_road_counts_from_the_first_step_across_its_edge(assessed, world):
    """The ego slides sideways by 0.3 m per step; the edge is 6 m away, its side is 0.805 m from its axis."""
    (scenario, prediction, bundle), _ = assessed[0]
    nobody = dataclasses.replace(prediction, valid=jnp.zeros_like(prediction.valid))
    points = np.arange(CONFIG.points)
    motion = jax.tree.map(jnp.zeros_like, row(bundle.motion, 0))
    motion = dataclasses.replace(motion, x=single(100 + points), arc_length=single(100 + points), speed=single(points))
    for slide in (0.3, 0.1):
        y = single(slide * points)
        risk = one(scenario, nobody, dataclasses.replace(motion, y=y, offset=y))
        across = np.flatnonzero(slide * points + CAR.width / 2 > 6.0)
        expected = 1 / (1 + math.exp(4.591 - 0.185 * across[0])) if across.size else 0.0
        assert float(risk.boundary_harm) == pytest.approx(expected, abs=1e-6)
        assert float(risk.total) == float(risk.boundary_harm)


def test_the_edge_counts_as_one_more_that_is_hit():
    risk = jf.Risk(ego=single([0.2, 0.1]), third_party=single([0.05, 0.3]), boundary_harm=single([0.0, 0.4]))
    np.testing.assert_allclose(risk.total, [0.25, 0.7], rtol=1e-6)
