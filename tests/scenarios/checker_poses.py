"""Asks commonroad-drivability-checker which random poses leave the road, and which hit traffic; writes an `.npz` file.

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
    from commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch import create_collision_checker

    from scenarios.commonroad import local_origin
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
    origin: Any = local_origin(problem.initial_state.position[:2])
    lanelets = list(network_of(scenario, origin).values())
    lengths = np.array([lanelet.length for lanelet in lanelets])
    chosen = random.choice(len(lanelets), count, p=lengths / lengths.sum())
    along = random.uniform(0.0, lengths[chosen])
    on_lane = [at_arc_lengths(lanelets[i].center_line, [s])[0] for i, s in zip(chosen, along, strict=True)]
    positions = (np.array(on_lane) + random.normal(0.0, 2.0, (count, 2))).astype(np.float32)
    headings = random.uniform(-np.pi, np.pi, count).astype(np.float32)

    near = traffic_poses(scenario, problem, origin, random, count)
    traffic = create_collision_checker(scenario)
    first = problem.initial_state.time_step

    def hits(margin: float) -> np.ndarray:
        verdicts = []
        for step, x, y, angle in near:
            ego = pycrcc.TimeVariantCollisionObject(first + int(step))
            x, y = x + origin[0], y + origin[1]
            ego.append_obstacle(pycrcc.RectOBB(0.5 * LENGTH + margin, 0.5 * WIDTH + margin, angle, x, y))
            verdicts.append(traffic.collide(ego))
        return np.array(verdicts, bool)

    def off_road(margin: float) -> np.ndarray:
        length, width = 0.5 * LENGTH + margin, 0.5 * WIDTH + margin
        places = zip(positions.astype(float) + origin, headings.astype(float), strict=True)
        return np.array([checker.collide(pycrcc.RectOBB(length, width, angle, x, y)) for (x, y), angle in places])

    np.savez(
        out,
        positions=positions,
        headings=headings,
        off_road=off_road(0.0),
        near_edge=off_road(NEAR),
        traffic_poses=near,
        hit=hits(0.0),
        near_hit=hits(NEAR),
    )


def traffic_poses(scenario: Any, problem: Any, origin: Any, random: np.random.Generator, count: int) -> np.ndarray:
    """`[count, 4]`: step, x, y, heading around random obstacles at random steps."""
    first, tracks = problem.initial_state.time_step, []
    for obstacle in scenario.dynamic_obstacles:
        for state in [obstacle.initial_state, *obstacle.prediction.trajectory.state_list]:
            if state.time_step >= first and isinstance(state.position, np.ndarray):
                tracks.append((state.time_step - first, *(state.position - origin)))
    chosen = np.array(tracks)[random.integers(0, len(tracks), count)]
    chosen[:, 1:] += random.normal(0.0, 2.5, (count, 2))
    poses = np.column_stack([chosen, random.uniform(-np.pi, np.pi, count)])
    return poses.astype(np.float32).astype(float)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
