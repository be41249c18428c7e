"""Filled areas from unordered edge segments (even-odd rule), for drawing."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib.path import Path


def filled_area(segments: np.ndarray) -> Path | None:
    """One path that fills what the segments enclose; holes run the other way round than what surrounds them.

    Args:
      segments: `[segments, end, xy]`, m; together they form closed rings.

    Returns:
      None where there is no closed ring.
    """
    rings = [ring for ring in _rings(segments) if len(ring) > 3]
    if not rings:
        return None
    paths = [Path(ring) for ring in rings]
    wound = []
    for ring, path in zip(rings, paths, strict=True):
        surrounding = sum(other is not path and other.contains_point((ring[0, 0], ring[0, 1])) for other in paths)
        left_round = _signed_area(ring) > 0.0
        wound.append(path if left_round == (surrounding % 2 == 0) else Path(ring[::-1]))
    return Path.make_compound_path(*wound)


def _rings(segments: np.ndarray) -> list[np.ndarray]:
    """Chains of segments whose ends meet (to 1 mm), each closed by repeating its first point."""
    keys = np.round(segments, 3)
    at_point = defaultdict(list)
    for index, ends in enumerate(keys):
        for end in (0, 1):
            at_point[tuple(ends[end])].append((index, end))
    unused = set(range(len(segments)))
    rings = []
    while unused:
        index, end = unused.pop(), 1
        ring = [segments[index, 0], segments[index, 1]]
        while True:
            here = at_point[tuple(keys[index, end])]
            onward = next(((i, e) for i, e in here if i in unused), None)
            if onward is None:
                break
            index, end = onward[0], 1 - onward[1]
            unused.remove(index)
            ring.append(segments[index, end])
        rings.append(np.asarray(ring))
    return rings


def _signed_area(ring: np.ndarray) -> float:
    x, y = ring.T
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
