"""What all tests share: annotations checked, no implicit promotion of types, compiled programs kept."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import jax
import pytest
from jaxtyping import install_import_hook

# Before the packages are imported: array shapes and types in annotations are checked at every call.
install_import_hook(["jaxfrenet", "scenarios"], "beartype.beartype")

jax.config.update("jax_numpy_dtype_promotion", "strict")
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    jax.config.update("jax_compilation_cache_dir", str(Path(tempfile.gettempdir()) / "jaxfrenet-tests-xla"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder with public scenario files in `scenarios/`; tests that need it are skipped where there is none."""
    named = os.environ.get("JAXFRENET_DATA")
    if not named:
        pytest.skip("JAXFRENET_DATA names no folder with scenario files")
    root = Path(named)
    if not (root / "scenarios").is_dir():
        pytest.skip(f"JAXFRENET_DATA={named} has no folder named scenarios")
    return root


@pytest.fixture(scope="session")
def golden_file() -> Path:
    """Correct values of whole planning cycles; `JAXFRENET_GOLDEN` names another file of the same format."""
    return Path(os.environ.get("JAXFRENET_GOLDEN") or Path(__file__).parent / "data" / "correct_cases.npz")
