from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import scenarios
from experiments import evaluate, view
from experiments._recording import Recording, record


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


class Viewed(NamedTuple):
    """What `view` wrote, and the recordings that it made for that."""

    folder: Path
    recordings: list[Recording]


@pytest.fixture(scope="session")
def viewed(tmp_path_factory) -> Viewed:
    """Results of `view` on the first built-in scenario: other weights, with the default ones laid over."""
    out, recordings = tmp_path_factory.mktemp("view"), []

    def kept(*arguments) -> Recording:
        recordings.append(record(*arguments))
        return recordings[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view, "record", kept)
        view.main(["--scenarios", "builtin", "--weights", "prediction=20", "--compare", "default", "--out", str(out)])
    return Viewed(out, recordings)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium: what CHROMIUM names, the system's, or Playwright's own; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api")
    named = os.environ.get("CHROMIUM")
    program = named or next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with playwright.sync_playwright() as driver:
        try:
            started = driver.chromium.launch(executable_path=program)
        except playwright.Error as error:
            if named:
                raise
            pytest.skip(f"no Chromium can be started; name one with CHROMIUM=PATH ({error.message.splitlines()[0]})")
        yield started
        started.close()


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
