"""Geometry of polylines and polygons in the plane, float64 numpy arrays of shape `[points, 2]`, metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""`[points, 2]`, m."""


def arc_lengths(points: Points) -> NDArray[np.float64]:
    """`[points]`, m, distance along the polyline from its first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def without_repeats(points: Points, tolerance: float = 1e-6) -> Points:
    """The polyline without points that lie within `tolerance` [m] of the one before."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > tolerance])
    return points[keep]


def at_arc_lengths(points: Points, arc_length: NDArray | Sequence[float]) -> Points:
    """Points at the given arc lengths [m]; beyond the ends the last segment is prolonged."""
    along, query = arc_lengths(points), np.asarray(arc_length, float)
    index = np.clip(np.searchsorted(along, query, side="right") - 1, 0, len(points) - 2)
    weight = (query - along[index]) / np.maximum(along[index + 1] - along[index], 1e-12)
    return points[index] + weight[..., None] * (points[index + 1] - points[index])


def project(points: Points, queries: Points) -> tuple[NDArray[np.float64], Points]:
    """Arc lengths [m] `[queries]` and positions `[queries, 2]` of the points of a polyline nearest to the queries."""
    start, step = points[:-1], np.diff(points, axis=0)
    relative = queries[:, None] - start
    share = np.sum(relative * step, axis=-1) / np.maximum(np.sum(step**2, axis=-1), 1e-12)
    share = np.clip(share, 0.0, 1.0)
    nearest = start + share[..., None] * step
    best = np.argmin(np.sum((queries[:, None] - nearest) ** 2, axis=-1), axis=1)
    rows = np.arange(len(queries))
    along = arc_lengths(points)
    return along[best] + share[rows, best] * (along[best + 1] - along[best]), nearest[rows, best]


def heading_at(points: Points, position: Points) -> float:
    """Direction [rad] of the polyline at its point nearest to `position` `[2]`."""
    along, _ = project(points, position[None])
    behind, ahead = at_arc_lengths(points, along + np.array([-0.5, 0.5]))
    return float(np.arctan2(ahead[1] - behind[1], ahead[0] - behind[0]))


def angle_between(first: float, second: float) -> float:
    """Size of the angle between two directions [rad], in [0, π]."""
    return abs((first - second + np.pi) % (2.0 * np.pi) - np.pi)


def contains(edges: NDArray[np.float64], queries: Points) -> NDArray[np.bool_]:
    """Whether each query lies inside an outline by the even-odd rule.

    Args:
      edges: `[edges, end, xy]`, m, in any order.
      queries: `[queries, 2]`, m.
    """
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    x, y = queries[:, :1], queries[:, 1:]
    straddles = (y0 > y) != (y1 > y)
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    crossings = straddles & (x < x0 + (y - y0) / rise * (x1 - x0))
    return np.sum(crossings, axis=1) % 2 == 1


def ring_edges(ring: Points) -> NDArray[np.float64]:
    """Edges `[points, end, xy]` of a closed ring whose last point need not repeat its first."""
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
