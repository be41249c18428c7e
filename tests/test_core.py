"""The core runs with its core dependencies alone, as it does on machines without the extras."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import scenarios

PROGRAM = """
import sys

EXTRAS = "jaxtyping beartype commonroad shapely networkx matplotlib tyro tqdm".split()

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in EXTRAS:
            raise ImportError(name)

sys.meta_path.insert(0, Refuse())
import jaxfrenet as jf
import scenarios

found = scenarios.load_set([sys.argv[1]])
config = jf.PlannerConfig(sampling_level=0)
episode = jf.roll_out(config, found.scenarios[0], jf.CostWeights(), 3)
print(jf.Outcome(int(episode.outcome)).name, int(episode.steps))

import jax
from scenarios.families import FAMILIES

for family in FAMILIES.values():
    one, _ = jax.eval_shape(lambda key: family.sample_with_map(key, family.presets["default"]), jax.random.key(0))
    print(one.obstacles.valid.shape[1])
"""


def test_core_drives_an_npz_set_without_any_extra(tmp_path):
    pytest.importorskip("commonroad")
    saved = tmp_path / "set.npz"
    scenarios.save_npz(saved, scenarios.load_set(scenarios.builtin_paths()[:1]))
    environment = os.environ | {"PYTHONPATH": str(Path(scenarios.__file__).parents[1])}
    command = [sys.executable, "-c", PROGRAM, str(saved)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, env=environment)
    assert done.stdout.split() == ["RUNNING", "3", "148", "148", "148"], done.stderr[-2000:]
