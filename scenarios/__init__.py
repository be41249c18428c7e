"""Where scenarios come from: CommonRoad files, folders and archives of them, `.npz` sets, and generators."""

from scenarios.batching import pad_to, sizes_of, stack, without_traffic
from scenarios.buckets import Bucket
from scenarios.builtin import builtin_paths
from scenarios.cache import load_cached
from scenarios.collection import ScenarioSet, Skipped, load_set
from scenarios.commonroad import ScenarioInfo, load, load_with_info
from scenarios.dataset import Dataset, Splits
from scenarios.errors import ScenarioError
from scenarios.families import Draw
from scenarios.solution import write_solution
from scenarios.storage import load_npz, save_npz

__all__ = [
    "Bucket",
    "Dataset",
    "Draw",
    "ScenarioError",
    "ScenarioInfo",
    "ScenarioSet",
    "Skipped",
    "Splits",
    "builtin_paths",
    "load",
    "load_cached",
    "load_npz",
    "load_set",
    "load_with_info",
    "pad_to",
    "save_npz",
    "sizes_of",
    "stack",
    "without_traffic",
    "write_solution",
]
