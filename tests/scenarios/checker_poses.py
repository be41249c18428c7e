"""Asks commonroad-drivability-checker which random poses leave the road; run as a program, it writes an `.npz` file.

A program of its own, because the checker prints notices when it ends.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

LENGTH, WIDTH = 4.508, 1.610
NEAR = 0.05
"""A false alarm counts only if the box stays off the road's edge when it is enlarged by this on all sides [m]."""


def main(scenario_file: str, out: str, count: int) -> None:
    import commonroad_dc.collision.collision_detection.scenario  # noqa: F401  (registers conversions)
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad_dc import pycrcc as compiled
    from commonroad_dc.boundary import boundary

    from scenarios.commonroad_file import network_of
    from scenarios.polyline import at_arc_lengths

    pycrcc: Any = compiled  # its stubs do not know all overloads
    scenario, problems = CommonRoadFileReader(scenario_file).open()
    edge: Any = boundary.create_road_boundary_obstacle(
        scenario, method="aligned_triangulation", axis=2, return_scenario_obstacle=False
    )
    checker = pycrcc.CollisionChecker()
    checker.add_collision_object(edge)

    random = np.random.default_rng(0)
    problem: Any = next(iter(problems.planning_problem_dict.values()))
    origin: Any = np.round(problem.initial_state.position[:2])
    lanelets = list(network_of(scenario, origin).values())
    lengths = np.array([lanelet.length for lanelet in lanelets])
    chosen = random.choice(len(lanelets), count, p=lengths / lengths.sum())
    along = random.uniform(0.0, lengths[chosen])
    on_lane = [at_arc_lengths(lanelets[i].center_line, [s])[0] for i, s in zip(chosen, along, strict=True)]
    positions = (np.array(on_lane) + random.normal(0.0, 2.0, (count, 2))).astype(np.float32)
    headings = random.uniform(-np.pi, np.pi, count).astype(np.float32)

    def off_road(margin: float) -> np.ndarray:
        length, width = 0.5 * LENGTH + margin, 0.5 * WIDTH + margin
        places = zip(positions.astype(float) + origin, headings.astype(float), strict=True)
        return np.array([checker.collide(pycrcc.RectOBB(length, width, angle, x, y)) for (x, y), angle in places])

    np.savez(out, positions=positions, headings=headings, off_road=off_road(0.0), near_edge=off_road(NEAR))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
