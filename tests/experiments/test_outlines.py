from __future__ import annotations

import numpy as np

from experiments._outlines import filled_area


def square(x, y, size):
    corners = np.array([[x, y], [x + size, y], [x + size, y + size], [x, y + size]], float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def test_a_hole_is_not_filled():
    segments = np.concatenate([square(0, 0, 10), square(2, 2, 3)[::-1, ::-1], square(20, 0, 5)])
    np.random.default_rng(0).shuffle(segments)
    area = filled_area(segments)
    assert area is not None
    winding = [_winding_number(area.to_polygons(), point) for point in ((1, 1), (3, 3), (22, 2), (15, 2))]
    assert [number != 0 for number in winding] == [True, False, True, False]


def _winding_number(rings, point):
    total = 0.0
    for ring in rings:
        angles = np.unwrap(np.arctan2(*(ring - point).T[::-1]))
        total += angles[-1] - angles[0]
    return round(total / (2 * np.pi))


def test_no_segments_fill_nothing():
    assert filled_area(np.zeros((0, 2, 2))) is None
