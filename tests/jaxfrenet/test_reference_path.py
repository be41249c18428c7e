"""Look-ups against numpy, and the way to the Frenet frame and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from jaxfrenet.reference_path import look_up, project, to_cartesian


def winding_path(spacing: float, padding: int = 0) -> jf.ReferencePath:
    """Curvature up to 1/12 m, with uneven spacing, and `padding` nodes beyond the end."""
    rng = np.random.default_rng(0)
    arc_length = np.append(0.0, np.cumsum(rng.uniform(0.5, 1.0, int(120 / spacing)) * spacing))
    fine = np.linspace(0, arc_length[-1], 20_001)
    heading = 0.3 + 2.5 * np.sin(fine / 30)
    x, y = (np.append(0, np.cumsum(np.diff(fine) * wave(heading)[:-1])) for wave in (np.cos, np.sin))
    tables = [np.interp(arc_length, fine, values) for values in (x, y, heading, 2.5 / 30 * np.cos(fine / 30))]
    tables.append(np.interp(arc_length, fine, -2.5 / 900 * np.sin(fine / 30)))
    beyond = np.arange(1, padding + 1)
    last = tables[2][-1]
    more = [tables[0][-1] + beyond * np.cos(last), tables[1][-1] + beyond * np.sin(last), 0 * beyond + last]
    more += [0.0 * beyond, 0.0 * beyond]
    columns = [np.append(a, b) for a, b in zip([arc_length, *tables], [arc_length[-1] + beyond, *more], strict=True)]
    return jf.ReferencePath(*(jnp.asarray(c, jnp.float32) for c in columns), length=jnp.float32(arc_length[-1]))


def test_look_up_is_linear_between_nodes():
    path = winding_path(1.0)
    at = np.random.default_rng(1).uniform(0, float(path.length), (40, 5)).astype(np.float32)
    point = look_up(path, jnp.asarray(at))
    for name in ("x", "y", "heading", "curvature", "curvature_derivative"):
        expected = np.interp(at, path.arc_length, getattr(path, name))
        np.testing.assert_allclose(getattr(point, name), expected, atol=2e-5)


def check_round_trip(path: jf.ReferencePath, width: float):
    rng = np.random.default_rng(2)
    along = jnp.asarray(rng.uniform(0.5, float(path.length) - 0.5, 3000), jnp.float32)
    across = jnp.asarray(rng.uniform(-width, width, 3000), jnp.float32)
    x, y = to_cartesian(path, along, across)
    s, d = jax.jit(project)(path, x, y)
    again_x, again_y = to_cartesian(path, s, d)
    assert float(jnp.max(jnp.hypot(again_x - x, again_y - y))) < 1e-3
    return s - along, d - across


@pytest.mark.parametrize("spacing", [0.25, 1.0])
@pytest.mark.parametrize("padding", [0, 50])
def test_round_trip(spacing, padding):
    moved_along, moved_across = check_round_trip(winding_path(spacing, padding), width=5.0)
    assert float(jnp.max(jnp.abs(moved_along))) < 5e-3
    assert float(jnp.max(jnp.abs(moved_across))) < 1e-3


@pytest.mark.parametrize("index", [0, 1])
def test_round_trip_on_builtin_paths(index):
    pytest.importorskip("commonroad")
    check_round_trip(scenarios.load(scenarios.builtin_paths()[index]).path, width=3.5)


@pytest.mark.data
@pytest.mark.parametrize("name", ["ZAM_Tjunction-1_42_T-1", "DEU_Lohmar-16_1_T-1", "DEU_A9-1_1_T-1"])
def test_round_trip_on_real_paths(name, data_root):
    path = scenarios.load(data_root / "scenarios" / "sample" / f"{name}.xml").path
    narrowest = 1.0 / max(float(jnp.max(jnp.abs(path.curvature))), 1e-3)
    check_round_trip(path, width=min(3.5, 0.7 * narrowest))


def test_projection_stays_on_the_path():
    path = winding_path(1.0, padding=20)
    s, _ = project(path, jnp.asarray([-50.0, 1e4]), jnp.asarray([0.0, 1e4]))
    assert (s >= 0).all() and (s <= path.length).all()
