"""Asks commonroad-drivability-checker about pairs of boxes; a program of its own: the checker litters stderr at exit.

Reads `before` and `after` `[count, 5]` (x, y, heading, length, width); writes whether each pair overlaps, and the hull
that it sweeps `[count, 5]` (x, y, heading, half length, half width).
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np


def main(source: str, out: str) -> None:
    import commonroad_dc.pycrcc as compiled
    from commonroad_dc.collision.trajectory_queries.trajectory_queries import trajectory_preprocess_obb_sum

    pycrcc: Any = compiled  # its stubs do not know all overloads

    def box(x: float, y: float, heading: float, length: float, width: float) -> Any:
        return pycrcc.RectOBB(length / 2, width / 2, heading, x, y)

    def hull(first: Any, second: Any) -> tuple[float, ...]:
        moving = pycrcc.TimeVariantCollisionObject(0)
        moving.append_obstacle(first)
        moving.append_obstacle(second)
        swept: Any = trajectory_preprocess_obb_sum(moving)
        both = swept[0].obstacle_at_time(0)
        return (*both.center(), both.orientation(), both.r_x(), both.r_y())

    pairs = np.load(source)
    boxes = [(box(*a), box(*b)) for a, b in zip(pairs["before"], pairs["after"], strict=True)]
    overlap = np.array([first.collide(second) for first, second in boxes])
    np.savez(out, overlap=overlap, hull=np.array([hull(*pair) for pair in boxes]))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
