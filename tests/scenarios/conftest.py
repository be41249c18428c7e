"""CommonRoad files for tests: the built-in ones, and edited copies of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

import jaxfrenet as jf
import scenarios

Edit = Callable[[ElementTree.Element], None]


@pytest.fixture(scope="session")
def t_junction_file() -> Path:
    pytest.importorskip("commonroad")
    return scenarios.builtin_paths()[0]


@pytest.fixture(scope="session")
def two_lane_file() -> Path:
    pytest.importorskip("commonroad")
    return scenarios.builtin_paths()[1]


@pytest.fixture(scope="session")
def t_junction(t_junction_file: Path) -> jf.Scenario:
    return scenarios.load(t_junction_file)


@pytest.fixture(scope="session")
def two_lanes(two_lane_file: Path) -> jf.Scenario:
    return scenarios.load(two_lane_file)


@pytest.fixture
def edited(tmp_path: Path, t_junction_file: Path) -> Callable[..., Path]:
    """Writes a copy of a built-in file (the T-junction if not named) after `edit` has changed its tree."""

    def write(edit: Edit, original: Path = t_junction_file, name: str = "edited.xml") -> Path:
        root = ElementTree.fromstring(original.read_bytes())
        edit(root)
        path = tmp_path / name
        path.write_bytes(ElementTree.tostring(root))
        return path

    return write
