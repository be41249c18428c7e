"""What must hold for every generated scenario; JAXFRENET_GENERATED says how many to look at (256)."""

from __future__ import annotations

import dataclasses
import os
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxfrenet as jf
from scenarios import families
from scenarios.errors import ScenarioError
from scenarios.families import FAMILIES, Draw
from scenarios.junction_task import LONGEST_CURVE, JunctionTask, Stream
from scenarios.road import nearby_segments
from scenarios.tjunction import TJunctionConfig, sample
from scenarios.vehicle_types import CAR

COUNT = int(os.environ.get("JAXFRENET_GENERATED", "256"))
KINDS = [
    ("tjunction", "default"),
    ("tjunction", "commonroad"),
    ("tjunction", "hard"),
    ("highway", "default"),
    ("crossing", "default"),
]


class Drawn(NamedTuple):
    family: families.Family
    config: Any
    chunks: list[tuple[range, Any, Any]]
    """Numbers, scenarios and maps, as NumPy arrays."""


@pytest.fixture(scope="session", params=KINDS, ids="-".join)
def drawn(request: pytest.FixtureRequest) -> Drawn:
    family, preset = request.param
    draw = Draw(COUNT, 7, family, preset)
    return Drawn(FAMILIES[family], FAMILIES[family].presets[preset], list(families.chunks(draw)))


def many(family: str, preset: str = "default") -> Any:
    """256 scenarios as one batch."""
    batches = [batch for _, batch, _ in families.chunks(Draw(256, 7, family, preset))]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches)


def corners(position: np.ndarray, heading: np.ndarray, length: np.ndarray, width: np.ndarray) -> np.ndarray:
    """`[..., 4, 2]`, m."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    local = 0.5 * signs * np.stack([length, width], axis=-1)[..., None, :]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    x = position[..., :1] + cos * local[..., 0] - sin * local[..., 1]
    y = position[..., 1:] + sin * local[..., 0] + cos * local[..., 1]
    return np.stack([x, y], axis=-1)


def test_nothing_is_nan_and_shapes_are_those_of_the_config(drawn: Drawn) -> None:
    for _, batch, _ in drawn.chunks:
        assert all(np.isfinite(np.asarray(leaf, float)).all() for leaf in jax.tree.leaves(batch))
        assert batch.path.x.shape[1] == drawn.config.path_nodes
        assert batch.obstacles.valid.shape[2] == drawn.config.steps
        assert (np.diff(batch.path.arc_length, axis=1) > 0.0).all()
        assert (batch.path.length < batch.path.arc_length[:, -1]).all()


def test_no_two_road_users_ever_overlap(drawn: Drawn) -> None:
    checked = 0
    for _, batch, _ in drawn.chunks:
        obstacles = batch.obstacles
        size = np.hypot(obstacles.length, obstacles.width)
        for first in range(obstacles.length.shape[1]):
            for second in range(first):
                both = obstacles.valid[:, first] & obstacles.valid[:, second]
                away = np.linalg.norm(obstacles.position[:, first] - obstacles.position[:, second], axis=-1)
                row, step = np.nonzero(both & (away < 0.5 * (size[:, first] + size[:, second])[:, None]))
                boxes: list[Any] = [
                    shapely.polygons(
                        corners(
                            obstacles.position[row, one, step].astype(float),
                            obstacles.heading[row, one, step].astype(float),
                            obstacles.length[row, one],
                            obstacles.width[row, one],
                        )
                    )
                    for one in (first, second)
                ]
                assert not shapely.intersects(*boxes).any()
                checked += len(row)
    assert checked > COUNT


def test_the_ego_starts_free_and_on_the_road(drawn: Drawn) -> None:
    vehicle = jf.BMW_320I
    for _, batch, _ in drawn.chunks:
        start, obstacles = batch.initial_state, batch.obstacles
        size = np.full(len(start.speed), vehicle.length), np.full(len(start.speed), vehicle.width)
        ego: Any = shapely.polygons(corners(start.position, start.heading, *size))
        others = shapely.polygons(
            corners(obstacles.position[:, :, 0], obstacles.heading[:, :, 0], obstacles.length, obstacles.width)
        )
        assert not (shapely.intersects(ego[:, None], others) & obstacles.valid[:, :, 0]).any()
        roads = shapely.polygons(batch.road.segments[:, :, 0])
        assert shapely.is_valid(roads).all()
        assert shapely.contains(roads, ego).all()
        goals = shapely.polygons(batch.goal.edges[:, 0, :, 0])
        assert shapely.contains(shapely.buffer(roads, 1e-3), goals).all()


def test_paths_can_be_driven_and_lead_through_the_goal(drawn: Drawn) -> None:
    for _, batch, _ in drawn.chunks:
        path, goal = batch.path, batch.goal
        assert np.abs(path.curvature).max() <= 0.2 < jf.BMW_320I.max_curvature
        heading = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
        turns = (heading[:, :1] - path.heading[:, :1]) / (2.0 * np.pi)
        middle = 0.5 * (path.heading[:, 1:] + path.heading[:, :-1])
        np.testing.assert_allclose(heading - 2.0 * np.pi * np.round(turns), middle, atol=2e-3)
        turned = np.diff(path.heading) / 0.25
        between = 0.5 * (path.curvature[:, 1:] + path.curvature[:, :-1])
        exists = path.arc_length[:, 1:] <= path.length[:, None]
        np.testing.assert_allclose(turned[exists], between[exists], atol=2e-3)
        enters, leaves = np.moveaxis(goal.arc_length[:, 0], -1, 0)
        assert (leaves > enters + 10.0).all() and (leaves + 29.0 < path.length).all()
        assert (goal.steps[:, 0, 0] > 0).all() and (goal.steps[:, 0, 1] < drawn.config.steps).all()


def test_no_stretch_has_more_road_edge_nearby_than_fits(drawn: Drawn) -> None:
    for _, batch, _ in drawn.chunks:
        assert (batch.road.nearby[..., -1] == -1).all()
    _, batch, _ = drawn.chunks[0]
    for row in range(5):
        exists = batch.path.arc_length[row] <= batch.path.length[row]
        nodes = np.stack([batch.path.x[row], batch.path.y[row]], axis=1)[exists].astype(float)
        expected = nearby_segments(
            batch.path.arc_length[row][exists].astype(float), nodes, batch.road.segments[row].astype(float)
        )
        found = batch.road.nearby[row]
        for stretch, wanted in enumerate(expected):
            wanted, listed = set(wanted[wanted >= 0]), set(found[stretch][found[stretch] >= 0])
            assert wanted <= listed and len(listed - wanted) <= 1, "roundings differ at the very limit only"
        assert (found[len(expected) :] == -1).all()


def test_lanelets_hang_together(drawn: Drawn) -> None:
    _, batch, maps = drawn.chunks[0]
    for index, link in enumerate(drawn.family.links):
        for after in link.successors:
            for side in (maps.left, maps.right):
                np.testing.assert_array_equal(side[index][:, -1], side[after][:, 0])
        if link.left is not None and link.left_same_direction:
            np.testing.assert_allclose(maps.left[index], maps.right[link.left], atol=1e-4)
            assert drawn.family.links[link.left].right == index
        elif link.left is not None:
            np.testing.assert_allclose(maps.left[index], maps.left[link.left][:, ::-1], atol=1e-3)
    assert (maps.is_goal.sum(axis=1) == 1).all()
    lengths = [np.linalg.norm(np.diff(border, axis=1), axis=-1).sum(axis=1).max() for border in maps.right]
    assert max(lengths) < 400.0
    if isinstance(drawn.config, JunctionTask):
        arms = sum(not link.successors for link in drawn.family.links)
        assert max(lengths[2 * arms :]) < LONGEST_CURVE
    assert (batch.goal.arc_length[:, 0, 1] - batch.goal.arc_length[:, 0, 0] > 10.0).all()


@pytest.mark.parametrize(("family", "preset"), KINDS[::3])
def test_a_scenario_depends_on_its_key_alone(family: str, preset: str) -> None:
    found, more = families.generate(Draw(3, 7, family, preset)), families.generate(Draw(5, 7, family, preset))
    other = families.generate(Draw(3, 8, family, preset))
    for one, same in zip(found.scenarios, more.scenarios, strict=False):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-4), one, same)
    assert found.infos == more.infos[:3]
    assert np.abs(found.scenarios[0].road.segments - other.scenarios[0].road.segments).max() > 1.0
    assert found.infos[0].name != other.infos[0].name


def test_sample_works_without_vmap_and_gives_the_same() -> None:
    key = families.scenario_keys(7, jnp.arange(1, 2))[0]
    alone = jax.jit(sample, static_argnums=1)(key, TJunctionConfig())
    _, batch, _ = next(families.chunks(Draw(families.CHUNK, 7)))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b[1], rtol=1e-5, atol=1e-3), alone, batch)


def test_every_kind_of_road_user_and_turn_occurs() -> None:
    batch = many("tjunction")
    exists = batch.obstacles.valid.any(-1)
    kinds = jf.ObstacleKind.CAR, jf.ObstacleKind.TRUCK, jf.ObstacleKind.MOTORCYCLE, jf.ObstacleKind.BICYCLE
    assert set(np.unique(batch.obstacles.kind[exists])) == {int(kind) for kind in kinds}
    turned = batch.path.heading[:, -1] - batch.path.heading[:, 0]
    left, right = (turned > 0.9).mean(), (turned < -0.9).mean()
    assert 0.6 < left < 0.8 and 0.07 < right < 0.25
    assert {0, 8} & set(exists.sum(axis=1)) and exists.sum(axis=1).max() > 6
    batch = many("crossing")
    assert (batch.obstacles.kind == jf.ObstacleKind.PEDESTRIAN).any()


def test_the_hard_preset_has_more_and_closer_traffic() -> None:
    default, hard = many("tjunction"), many("tjunction", "hard")
    count = [batch.obstacles.valid[:, :, 0].sum(axis=1).mean() for batch in (default, hard)]
    assert count[1] > count[0] + 1.0


def test_the_ego_reaches_every_goal_on_an_empty_road() -> None:
    _, batch, _ = next(families.chunks(Draw(families.CHUNK, 7)))
    alone = jax.tree.map(lambda leaf: jnp.asarray(leaf[:8]), batch)
    nobody = jax.tree.map(lambda leaf: leaf[:, :1], alone.obstacles)
    nobody = dataclasses.replace(nobody, valid=jnp.zeros_like(nobody.valid))
    alone = dataclasses.replace(alone, obstacles=nobody)
    config = jf.PlannerConfig(sampling_level=1)
    steps = jf.max_steps(alone)
    episodes = jax.jit(jax.vmap(lambda one: jf.roll_out(config, one, jf.CostWeights(), steps)))(alone)
    assert (np.asarray(episodes.outcome) == jf.Outcome.GOAL_REACHED_IN_TIME).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lane_width": (-3.0,)}, "lane_width has the value -3.0: give one or more non-decreasing numbers within 2.5"),
        ({"lane_width": (4.0, 3.0)}, "lane_width is (4.0, 3.0), which decreases"),
        ({"start_speed": ()}, r"start_speed is ()"),
        ({"start_speed": (float("nan"),)}, "start_speed has the value nan"),
        ({"density": 1.5}, "density is 1.5: give a number within 0 … 1"),
        ({"streams": (Stream("other", vehicles=9),)}, "streams hold 9 vehicles: give at most 8"),
        ({"streams": (Stream("fourth"),)}, "'fourth', which a T-junction has not"),
        ({"streams": (Stream("own", "own"),)}, "stream from own to own: give two different ones"),
        ({"streams": (Stream("own", vehicles=0),)}, "stream from own has 0 vehicles: give at least 1"),
        ({"vehicle_types": ()}, "vehicle_types is empty"),
        ({"streams": ()}, "streams is empty: name at least one, and density=0.0"),
        ({"turns": (0.0, 0.0, 0.0)}, "turns is (0.0, 0.0, 0.0)"),
        ({"goal_steps": (140, 200)}, "goal_steps is (140, 200): give two steps within 1 … 147"),
        ({"goal_in_junction": "at start speed"}, "goal_steps is None: give both"),
    ],
)
def test_impossible_configurations_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as error:
        TJunctionConfig(**change)
    assert message in str(error.value)


def test_impossible_draws_are_refused() -> None:
    for draw, message in (
        (Draw(0), "cannot draw 0 scenarios: give at least 1"),
        (Draw(1, family="roundabout"), "no family 'roundabout' of generated scenarios; there are tjunction, highway"),
        (Draw(1, preset="easy"), "family tjunction has no preset 'easy'; there are default, commonroad, hard"),
        (Draw(1, seed=-1), "seed -1 is out of range"),
    ):
        with pytest.raises(ScenarioError, match="^" + message.replace("(", r"\(")):
            next(families.chunks(draw))
    with pytest.raises(ScenarioError, match="share of cars is -1"):
        dataclasses.replace(CAR, share=-1.0)
    with pytest.raises(ScenarioError, match="give at least"):
        dataclasses.replace(FAMILIES["highway"].presets["default"], start_speed=(14.0, 35.0))


def test_the_commonroad_preset_is_like_its_family() -> None:
    batch = many("tjunction", "commonroad")
    assert np.median(batch.initial_state.speed) == pytest.approx(5.06, abs=0.3)
    assert set(np.unique(batch.goal.steps)) == {146, 147}
    assert batch.obstacles.valid[:, :, 0].sum(axis=1).mean() > 4.8
    assert (batch.path.heading[:, -1] - batch.path.heading[:, 0] > 0.9).all()
