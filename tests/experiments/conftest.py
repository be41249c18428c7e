from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import scenarios
from experiments import evaluate, view


@pytest.fixture(scope="session", autouse=True)
def own_scenario_cache(tmp_path_factory) -> Iterator[None]:
    """Keeps imported scenarios out of the user's cache."""
    folder = tmp_path_factory.mktemp("scenario_cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scenarios.cache.user_cache", lambda: folder)
        yield


@pytest.fixture(scope="session")
def builtin_file() -> Path:
    return Path(scenarios.builtin_paths()[0])


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory) -> Path:
    """Results of `evaluate` on the built-in scenarios."""
    out = tmp_path_factory.mktemp("evaluate")
    evaluate.main(["--scenarios", "builtin", "--out", str(out), "--solutions"])
    return out


@pytest.fixture(scope="session")
def evaluated_generated(tmp_path_factory) -> Path:
    """Results of `evaluate` on two generated scenarios."""
    out = tmp_path_factory.mktemp("evaluate_generated")
    evaluate.main(["--generate", "2", "--generator-seed", "1", "--out", str(out), "--solutions"])
    return out


@pytest.fixture(scope="session")
def viewed(tmp_path_factory) -> Path:
    """Results of `view` on the first built-in scenario."""
    out = tmp_path_factory.mktemp("view")
    view.main(["--scenarios", "builtin", "--out", str(out)])
    return out


@pytest.fixture
def broken_file(tmp_path, builtin_file) -> Path:
    """A CommonRoad file whose second half is missing."""
    path = tmp_path / "broken.xml"
    path.write_bytes(builtin_file.read_bytes()[: builtin_file.stat().st_size // 2])
    return path


@pytest.fixture
def without_planning_problem(tmp_path, builtin_file) -> Path:
    path = tmp_path / "no_problem.xml"
    text = builtin_file.read_text(encoding="utf-8")
    path.write_text(re.sub(r"<planningProblem .*?</planningProblem>", "", text, flags=re.DOTALL), encoding="utf-8")
    return path


@pytest.fixture
def mixed_folder(tmp_path, broken_file) -> Path:
    """A folder with the built-in scenarios and a broken file."""
    folder = tmp_path / "mixed"
    folder.mkdir()
    for file in [*scenarios.builtin_paths(), broken_file]:
        shutil.copy(file, folder)
    return folder
