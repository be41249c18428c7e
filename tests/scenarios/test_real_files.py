"""Every public file loads, quickly, into sensible arrays, or is skipped with a reason."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import jaxfrenet as jf
import scenarios
from scenarios.batching import leaves_of

pytestmark = pytest.mark.data
EVERY = 12
"""Of the T-junction files, which share one map, every so-manieth is read here."""


def assert_sensible(scenario: jf.Scenario, name: str) -> None:
    for leaf, values in leaves_of(scenario).items():
        assert np.isfinite(values).all(), (name, leaf)
    path = scenario.path
    assert np.abs(np.asarray(path.curvature)).max() < 0.5, name
    np.testing.assert_allclose(np.diff(np.asarray(path.arc_length)), 0.25, atol=1e-3)
    away = np.hypot(*(np.stack([path.x, path.y]) - np.asarray(scenario.initial_state.position)[:, None]))
    nearest = int(np.argmin(away))
    assert away[nearest] < 1.8, name
    assert abs(float(scenario.initial_state.heading) - float(path.heading[nearest])) < 0.5, name
    assert float(path.arc_length[nearest]) > 28.0, name
    entry, leave = np.asarray(scenario.goal.arc_length).T
    assert (entry <= leave).all() and (leave <= float(path.length)).all(), name


def archive(data_root: Path, name: str) -> Path:
    path = data_root / "scenarios" / f"{name}.tar.xz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    return path


@pytest.mark.timeout(200)
def test_diverse_files(data_root):
    loaded = scenarios.load_set([archive(data_root, "commonroad-diverse")])
    assert len(loaded) + len(loaded.skipped) == 100
    assert len(loaded) >= 95, loaded.skipped
    for scenario, info in zip(loaded.scenarios, loaded.infos, strict=True):
        assert_sensible(scenario, info.name)


@pytest.mark.parametrize(("name", "count"), [("tjunction-train", 410), ("tjunction-validation", 82)])
def test_t_junction_files(data_root, name, count):
    from scenarios.collection import scenario_files  # noqa: PLC2701
    from scenarios.commonroad import from_bytes

    sources = scenario_files(archive(data_root, name))
    assert len(sources) == count
    seconds = []
    for source in sources[::EVERY]:
        start = time.perf_counter()
        scenario, info = from_bytes(source.read(), source.name)
        seconds.append(time.perf_counter() - start)
        assert_sensible(scenario, info.name)
        assert scenario.obstacles.valid.shape == (5, 148)
    assert np.median(seconds[1:]) < 0.5
