"""Box tests against shapely and the CommonRoad drivability checker, on thousands of random boxes."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfrenet.collision import Box, box_meets_segment, boxes_overlap, contact_margin, swept_box
from jaxfrenet.road import is_inside, is_off_road

shapely = pytest.importorskip("shapely")
COUNT = 10_000
NEAR = 3 * float(contact_margin(jnp.float32(40.0), jnp.float32(20.0)))
"""False alarms must be nearer than this [m]."""


def random_boxes(rng, spread: float) -> np.ndarray:
    """`[count, 5]`: x, y, heading, length, width."""
    place = rng.uniform(-spread, spread, (COUNT, 2))
    return np.column_stack([place, rng.uniform(-4, 4, COUNT), rng.uniform(0.3, 12, COUNT), rng.uniform(0.3, 3, COUNT)])


def as_box(values: np.ndarray) -> Box:
    return Box.from_heading(*(jnp.asarray(column, jnp.float32) for column in values.T))


def corners(values: np.ndarray) -> np.ndarray:
    x, y, heading, length, width = values.T
    along = np.stack([np.cos(heading), np.sin(heading)], -1) * length[:, None] / 2
    left = np.stack([-np.sin(heading), np.cos(heading)], -1) * width[:, None] / 2
    center = np.stack([x, y], -1)
    return np.stack([center + a * along + b * left for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))], axis=1)


def check(ours: np.ndarray, distance: np.ndarray):
    """Touching boxes are never missed; a false alarm is all but touching."""
    assert ours[distance == 0].all()
    assert (distance[ours] <= NEAR).all()
    assert 0.1 < ours.mean() < 0.9


def test_boxes_against_shapely():
    rng = np.random.default_rng(0)
    a, b = random_boxes(rng, 6), random_boxes(rng, 6)
    ours = np.asarray(jax.jit(boxes_overlap)(as_box(a), as_box(b)))
    check(ours, shapely.distance(shapely.polygons(corners(a)), shapely.polygons(corners(b))))


def test_segments_against_shapely():
    rng = np.random.default_rng(1)
    box, ends = random_boxes(rng, 6), rng.uniform(-8, 8, (COUNT, 2, 2))
    start, end = (jnp.asarray(ends[:, i], jnp.float32) for i in (0, 1))
    ours = np.asarray(jax.jit(box_meets_segment)(as_box(box), start, end))
    check(ours, shapely.distance(shapely.polygons(corners(box)), shapely.linestrings(ends)))


@pytest.fixture(scope="module")
def checker(tmp_path_factory) -> dict[str, np.ndarray]:
    """Random pairs of boxes, and what the drivability checker says of them."""
    pytest.importorskip("commonroad_dc")
    folder = tmp_path_factory.mktemp("checker")
    before, after, _ = swept_pairs(np.random.default_rng(4))
    np.savez(folder / "pairs.npz", before=before, after=after)
    program = Path(__file__).parent / "checker_boxes.py"
    command = [sys.executable, str(program), str(folder / "pairs.npz"), str(folder / "verdicts.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert (folder / "verdicts.npz").is_file(), done.stderr[-2000:]
    return dict(np.load(folder / "verdicts.npz")) | {"before": before, "after": after}


def test_boxes_against_the_drivability_checker(checker):
    ours = np.asarray(boxes_overlap(as_box(checker["before"]), as_box(checker["after"])))
    assert not (checker["overlap"] & ~ours).any()
    assert (ours != checker["overlap"]).sum() < 0.002 * COUNT


def swept_pairs(rng) -> tuple[np.ndarray, np.ndarray, Box]:
    before = random_boxes(rng, 6)
    after = before + np.column_stack([rng.normal(0, 2, (COUNT, 2)), rng.normal(0, 0.5, COUNT), np.zeros((COUNT, 2))])
    return before, after, jax.jit(swept_box)(as_box(before), as_box(after))


def test_a_swept_box_is_the_tight_hull_of_both():
    before, after, swept = swept_pairs(np.random.default_rng(3))
    points = np.concatenate([corners(before), corners(after)], axis=1) - np.stack([swept.x, swept.y], -1)[:, None]
    along = points[..., 0] * np.asarray(swept.cos)[:, None] + points[..., 1] * np.asarray(swept.sin)[:, None]
    across = points[..., 1] * np.asarray(swept.cos)[:, None] - points[..., 0] * np.asarray(swept.sin)[:, None]
    for reached, half in ((along, swept.half_length), (across, swept.half_width)):
        np.testing.assert_allclose(np.abs(reached).max(axis=1), half, atol=1e-4)


def test_a_swept_box_is_the_checkers_hull(checker):
    """Of boxes that move mostly ahead; where they do not, the checker takes another direction."""
    moved = checker["after"] - checker["before"]
    heading = 0.5 * (checker["after"] + checker["before"])[:, 2]
    ahead = np.abs(moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading))
    aside = np.abs(moved[:, 1] * np.cos(heading) - moved[:, 0] * np.sin(heading))
    usual = (aside < 0.3 * ahead) & (checker["before"][:, 3] > 1.5 * checker["before"][:, 4])
    assert usual.sum() > 0.1 * COUNT
    swept = jax.jit(swept_box)(as_box(checker["before"]), as_box(checker["after"]))
    mine = np.stack([swept.x, swept.y, swept.half_length, swept.half_width], axis=1)
    agree = np.abs(mine - checker["hull"][:, [0, 1, 3, 4]]).max(axis=1) < 1e-3
    assert agree[usual].mean() > 0.98


def test_inside_and_off_road_against_shapely():
    """A road with a hole in it."""
    rng = np.random.default_rng(5)
    outer = np.array([[0, 0], [30, -3], [34, 14], [12, 18], [-4, 9.0]])
    hole = np.array([[12, 5], [18, 6], [15, 11.0]])
    rings = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in (outer, hole)]
    segments = jnp.asarray(np.concatenate(rings), jnp.float32)
    valid = jnp.ones(len(segments), bool)
    surface = shapely.Polygon(outer, [hole])
    poses = random_boxes(rng, 1)
    poses[:, :2] = rng.uniform([-8, -6], [38, 22], (COUNT, 2))

    inside = jax.vmap(lambda point: is_inside(segments[:, 0], segments[:, 1], valid, point))
    points = jnp.asarray(poses[:, :2], jnp.float32)
    apart = shapely.distance(surface.boundary, shapely.points(poses[:, :2])) > 1e-4
    expected = shapely.contains_xy(surface, *poses[:, :2].T)
    np.testing.assert_array_equal(np.asarray(inside(points))[apart], expected[apart])

    def off_road(pose):
        return is_off_road(segments, valid, pose[:2], pose[2], pose[3], pose[4])

    ours = np.asarray(jax.jit(jax.vmap(off_road))(jnp.asarray(poses, jnp.float32)))
    boxes = shapely.polygons(corners(poses))
    left = ~shapely.contains(surface, boxes)
    assert not (left & ~ours).any()
    assert (shapely.distance(surface.boundary, boxes)[ours & ~left] < NEAR).all()
