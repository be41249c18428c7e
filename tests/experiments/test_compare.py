from __future__ import annotations

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from scipy.stats import ks_2samp

import jaxfrenet as jf
import scenarios
from experiments import compare
from experiments._scenario_statistics import QUANTITIES, ks_distance, scenario_statistics

STEPS = 51


def single(values) -> jnp.ndarray:
    return jnp.asarray(values, jnp.float32)


def tracks(*starts_and_velocities) -> jf.Obstacles:
    """Obstacles from (x, y, vx, vy) that keep their velocity for 5 s; the last of them stands and is static."""
    x, y, vx, vy = np.array(starts_and_velocities, float).T[..., None]
    time = jf.DT * np.arange(STEPS)
    count, still = len(x), (vx == 0.0) & (vy == 0.0)
    every = (count, STEPS)
    return jf.Obstacles(
        position=single(np.stack([x + vx * time, y + vy * time], axis=-1)),
        heading=single(np.broadcast_to(np.arctan2(vy, vx), every)),
        speed=single(np.broadcast_to(np.hypot(vx, vy), every)),
        valid=jnp.ones(every, bool),
        length=jnp.full(count, 5.0),
        width=jnp.full(count, 2.0),
        kind=jnp.full(count, jf.ObstacleKind.CAR, jnp.int32),
        static=jnp.asarray(still[:, 0]),
    )


@pytest.fixture(scope="module")
def straight() -> jf.Scenario:
    """An ego at x = 10 m that drives 5 m/s along the x axis to a goal from x = 60 to 80 m, and traffic."""
    original = scenarios.load(scenarios.builtin_paths()[0])
    nodes = np.arange(101.0)
    zero = single(np.zeros(101))
    return dataclasses.replace(
        original,
        path=jf.ReferencePath(single(nodes), single(nodes), zero, zero, zero, zero, single(90.0)),
        goal=dataclasses.replace(original.goal, arc_length=single([[60.0, 80.0]])),
        initial_state=dataclasses.replace(original.initial_state, position=single([10.0, 0.5]), speed=single(5.0)),
        obstacles=tracks(
            (40.0, -20.0, 0.0, 10.0),  # crosses at 2.0 s; the ego would be there at 6.0 s
            (15.0, 20.0, 0.0, -5.0),  # crosses at 4.0 s; the ego would be there at 1.0 s
            (5.0, -20.0, 0.0, 10.0),  # crosses behind the ego
            (90.0, 3.5, -8.0, 0.0),  # meets it on the other lane
            (30.0, -1.0, 6.0, 0.5),  # drives along the path
            (50.0, 0.0, 0.0, 0.0),
        ),
    )


def test_statistics_of_a_case_worked_out_by_hand(straight):
    found = scenario_statistics(straight)
    assert set(found) == set(QUANTITIES)
    np.testing.assert_allclose(found["start_speed"], [5.0])
    np.testing.assert_allclose(found["goal_start"], [50.0], atol=1e-5)
    np.testing.assert_allclose(found["goal_middle"], [60.0], atol=1e-5)
    np.testing.assert_allclose(found["traffic_speed"], [10.0, 5.0, 10.0, 8.0, np.hypot(6.0, 0.5)], rtol=1e-5)
    np.testing.assert_allclose(found["time_gap"], [2.0 - 6.0, 4.0 - 1.0], atol=1e-5)


def test_an_ego_that_stands_has_no_time_gaps(straight):
    standing = dataclasses.replace(straight.initial_state, speed=single(0.0))
    assert scenario_statistics(dataclasses.replace(straight, initial_state=standing))["time_gap"].size == 0


def test_unrecorded_steps_do_not_count(straight):
    late = straight.obstacles.valid & (jnp.arange(STEPS) > 25)
    obstacles = dataclasses.replace(straight.obstacles, valid=late)
    found = scenario_statistics(dataclasses.replace(straight, obstacles=obstacles))
    np.testing.assert_allclose(found["time_gap"], [4.0 - 1.0], atol=1e-5)
    np.testing.assert_allclose(found["traffic_speed"][0], 10.0)


def test_distance_between_samples():
    assert ks_distance(np.array([1.0, 2.0]), np.array([3.0, 4.0])) == 1.0
    assert ks_distance(np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 2.0])) == 0.5
    assert ks_distance(np.array([]), np.array([1.0])) is None
    first, second = np.random.default_rng(0).normal(size=(2, 50)).round(1) + [[0.0], [0.4]]
    assert ks_distance(first, second) == pytest.approx(ks_2samp(first, second)[0])


def test_two_sources_side_by_side(tmp_path, capsys):
    compare.main(["--scenarios", "builtin", "--generate", "2", "--preset", "default", "--out", str(tmp_path)])
    assert {path.name for path in tmp_path.iterdir()} == {"compare.json", "compare.png"}
    results = json.loads((tmp_path / "compare.json").read_bytes())
    assert results["files"] == {"scenarios": ["builtin"], "count": 2}
    assert results["generated"] == {"count": 2, "seed": 0, "family": "tjunction", "preset": "default"}
    assert set(results["quantities"]) == set(QUANTITIES)
    table = capsys.readouterr().out
    for name, one in results["quantities"].items():
        assert 0.0 <= one["ks_distance"] <= 1.0
        for source in ("files", "generated"):
            quantiles = one[source]["quantiles"]
            assert list(quantiles) == ["0%", "5%", "25%", "50%", "75%", "95%", "100%"]
            assert list(quantiles.values()) == sorted(quantiles.values())
        assert QUANTITIES[name][0] in table
    with Image.open(tmp_path / "compare.png") as picture:
        assert picture.size == (1040, 560)
