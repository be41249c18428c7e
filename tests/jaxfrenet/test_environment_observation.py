"""Every field of the observation against values that are computed by hand, and that no field knows where on the map
it is."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.config import DT
from jaxfrenet.environment import PAPER_ADJUSTMENTS, Adjustment, EnvironmentConfig, begin, observation_fields
from jaxfrenet.environment.action import default_weights
from jaxfrenet.environment.observation import observe
from jaxfrenet.simulation import advance

BEHIND = jf.BMW_320I.rear_axle_to_center


@pytest.fixture(scope="module")
def setting(config) -> EnvironmentConfig:
    return EnvironmentConfig(planner=config)


@pytest.fixture(scope="module")
def fields(setting):
    return observation_fields(setting)


@pytest.fixture(scope="module")
def read(fields):
    """`read(observation)`: {field: value in its unit}."""

    def of(observation):
        values = {}
        for field, value in zip(fields, np.asarray(observation, float), strict=True):
            values[field.name] = field.scale * (np.expm1(10 * value) if field.kind == "log" else value)
        return values

    return of


@pytest.fixture(scope="module")
def first(setting, read):
    """`first(scenario)`: what is seen at the start."""
    compiled = jax.jit(partial(begin, setting))
    return lambda scenario: read(compiled(scenario).observation)


@pytest.fixture(scope="module")
def look(setting, config, plan):
    """`look(scenario, state)`: plan with the default weights, drive one step and observe."""
    weights = default_weights(PAPER_ADJUSTMENTS)

    @jax.jit
    def drive_on(scenario, before, start, cycle):
        after, report = advance(config, scenario, before, cycle, jf.CostWeights())
        return after, report, observe(setting, scenario, before, after, start, cycle, report, weights)

    def of(scenario, state, start=None):
        cycle = plan(scenario, state)
        return cycle, *drive_on(scenario, state, state.ego.arc_length if start is None else start, cycle)

    return of


def block(thing, x):
    return [thing(x, y, static=True, width=4.0) for y in (-4.0, 0.0, 4.0)]


def changed(scenario, **parts):
    """The scenario with fields of its parts changed: `changed(scenario, lanes={"width": ...})`."""
    new = {name: dataclasses.replace(getattr(scenario, name), **fields) for name, fields in parts.items()}
    return dataclasses.replace(scenario, **new)


def test_the_fields(fields):
    names = [field.name for field in fields]
    assert len(names) == len(set(names)) == 88
    assert all(field.scale > 0 for field in fields)


def test_fields_follow_the_adjustments(setting):
    """Costs come in the planner's order, weights in the table's."""
    extra = Adjustment("acceleration", 0.1, 0.0, 1.0, 0.5)
    swapped = dataclasses.replace(setting, adjustments=(extra, PAPER_ADJUSTMENTS[0], PAPER_ADJUSTMENTS[1]))
    names = [field.name for field in observation_fields(swapped)]
    assert names[-3:] == ["weight_acceleration", "weight_prediction", "weight_lateral_jerk"]
    chosen = [name for name in names if name.endswith("_chosen")]
    assert chosen == ["cost_lateral_jerk_chosen", "cost_prediction_chosen", "cost_acceleration_chosen"]


def test_the_ego_at_the_start(first, world):
    scenario = world(start=(20.0, 1.0), heading=0.2, speed=5.0, yaw_rate=0.5)
    seen = first(changed(scenario, initial_state={"acceleration": jnp.float32(1.5)}))
    assert seen["speed"] == pytest.approx(5.0, abs=1e-5)
    assert seen["acceleration"] == pytest.approx(1.5, abs=1e-5)
    assert seen["longitudinal_jerk"] == seen["lateral_jerk"] == 0.0
    assert seen["steering_angle"] == pytest.approx(np.arctan(jf.BMW_320I.wheelbase * 0.1), abs=1e-5)
    assert seen["yaw_rate"] == pytest.approx(0.5, abs=1e-5)
    assert seen["heading_to_path"] == pytest.approx(0.2, abs=1e-5)
    assert seen["offset"] == pytest.approx(1.0 - BEHIND * np.sin(0.2), abs=1e-4)


def test_the_ego_after_a_step(look, read, config, world):
    scenario = world(start=(20.0, 1.0), heading=0.1, speed=6.0, yaw_rate=0.2)
    before = jf.reset(config, scenario)
    for _ in range(2):
        _, after, _, observation = look(scenario, before)
        seen, ego, last = read(observation), after.ego, before.ego
        assert seen["longitudinal_jerk"] == pytest.approx(float(ego.acceleration - last.acceleration) / DT, abs=1e-3)
        sideways = float(ego.curvature * ego.speed**2 - last.curvature * last.speed**2) / DT
        assert seen["lateral_jerk"] == pytest.approx(sideways, abs=1e-3)
        assert seen["speed"] == pytest.approx(float(ego.speed), abs=1e-4)
        assert seen["yaw_rate"] == pytest.approx(float(ego.curvature * ego.speed), abs=1e-5)
        assert seen["offset"] == pytest.approx(float(ego.offset), abs=1e-5)
        before = after


def test_linear_fields_end_at_five_scales(first, world):
    seen = first(world(goal=(270.0, 330.0), speed=49.0))
    assert seen["goal_distance"] == pytest.approx(250.0)
    assert first(world(speed=50.1))["speed"] == pytest.approx(50.0)


def test_the_goal_at_the_start(first, world):
    seen = first(world(goal=(70.0, 110.0), goal_steps=(50, 60), goal_speed=(4.0, 9.0), speed=10.0))
    assert seen["goal_distance"] == pytest.approx(70.0, abs=1e-3)
    assert seen["goal_share_of_way"] == pytest.approx(0.0, abs=1e-5)
    assert seen["goal_remaining_time"] == pytest.approx(6.0, abs=1e-5)
    assert seen["goal_region_reached"] == seen["goal_speed_met"] == seen["goal_time_over"] == 0.0
    assert seen["goal_speed_difference"] == 0.0
    inside = first(world(goal=(15.0, 110.0), goal_speed=(9.0, 10.5)))
    assert inside["goal_region_reached"] == inside["goal_speed_met"] == 1.0
    assert first(world(goal_speed=None))["goal_speed_met"] == 1.0


def test_the_goal_after_a_step(look, read, config, world):
    scenario = world(goal=(70.0, 110.0), goal_steps=(50, 60), goal_speed=(4.0, 10.5), speed=11.0)
    state = jf.reset(config, scenario)
    for _ in range(8):
        cycle, state, report, observation = look(scenario, state, jnp.float32(20.0 - BEHIND))
        seen, place = read(observation), float(state.center(config.vehicle)[0])
        assert seen["goal_distance"] == pytest.approx(90.0 - place, abs=1e-3)
        assert seen["goal_share_of_way"] == pytest.approx((place - 20.0) / 70.0, abs=1e-5)
        assert seen["goal_remaining_time"] == pytest.approx(6.0 - DT * int(state.step), abs=1e-5)
        assert seen["goal_speed_difference"] == pytest.approx(float(state.ego.speed - cycle.desired_speed), abs=1e-4)
        assert seen["goal_speed_met"] == (float(state.ego.speed) <= 10.5)
    late = dataclasses.replace(state, step=jnp.int32(60))
    seen = read(look(scenario, late)[-1])
    assert seen["goal_remaining_time"] == pytest.approx(-DT, abs=1e-5)
    assert seen["goal_time_over"] == 1.0
    beyond = world(start=(90.0, 0.0), goal=(70.0, 80.0), goal_steps=(50, 60))
    seen = read(look(beyond, jf.reset(config, beyond))[-1])
    assert seen["goal_distance"] < -15.0 and seen["goal_share_of_way"] == 1.0


def row(seen, place):
    return {name.split("_", 2)[2]: value for name, value in seen.items() if name.startswith(f"obstacle_{place}_")}


def test_obstacles_are_told_in_the_egos_frame_nearest_first(first, world, thing):
    things = [thing(60.0, 3.0, speed=7.0, heading=2.0), thing(35.0, -4.0, 5.0), thing(12.0, 1.0, 3.0, heading=-3.0)]
    seen = first(world(things, start=(20.0, 0.5), heading=0.3))
    assert [row(seen, place)["speed"] for place in (1, 2, 3)] == pytest.approx([3.0, 5.0, 7.0])
    for place, one in zip((1, 2, 3), sorted(things, key=lambda one: one.speed), strict=True):
        told, away = row(seen, place), np.array([one.x - 20.0, one.y - 0.5])
        ahead, left = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]) @ away
        assert told["ahead"] == pytest.approx(ahead, abs=1e-3)
        assert told["left"] == pytest.approx(left, abs=1e-3)
        assert told["distance"] == pytest.approx(np.hypot(*away), abs=1e-3)
        assert told["heading"] == pytest.approx((one.heading - 0.3 + np.pi) % (2 * np.pi) - np.pi, abs=1e-4)
        assert told["valid"] == 1.0
    for place in (4, 5):
        assert set(row(seen, place).values()) == {0.0}


def test_obstacles_that_are_far_or_not_there_are_left_out(first, world, thing, config):
    reach = config.sensor_radius
    things = [thing(20.1 + reach, 0.0), thing(19.9 + reach, 0.0), thing(30.0, 0.0, steps=(5, 61))]
    seen = first(world(things))
    assert row(seen, 1)["distance"] == pytest.approx(reach - 0.1, abs=1e-3)
    assert [row(seen, place)["valid"] for place in range(1, 6)] == [1, 0, 0, 0, 0]
    nobody = first(world())
    assert not any(value for place in range(1, 6) for value in row(nobody, place).values())


def test_only_the_five_nearest_of_many_are_told(first, world, thing):
    places = [(40.0 + 7 * ((3 * i) % 8), float(i % 3)) for i in range(8)]
    parts = [world([thing(*place) for place in places[i : i + 3]]).obstacles for i in (0, 3, 6)]
    together = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    seen = first(dataclasses.replace(world(), obstacles=together))
    told = [row(seen, place)["distance"] for place in range(1, 6)]
    np.testing.assert_allclose(told, sorted(np.hypot(x - 20.0, y) for x, y in places)[:5], atol=1e-3)


def test_obstacles_are_told_where_they_are_now(look, read, config, world, thing):
    """Static ones also after the record's end, others not."""
    scenario = world([thing(60.0, 3.0, speed=2.0), thing(25.0, -4.5, static=True)])
    state = jf.reset(config, scenario)
    _, after, _, observation = look(scenario, dataclasses.replace(state, step=jnp.int32(11)))
    assert row(read(observation), 2)["ahead"] == pytest.approx(62.4 - float(after.center(config.vehicle)[0]), abs=0.05)
    seen = read(look(scenario, dataclasses.replace(state, step=jnp.int32(65)))[-1])
    assert [row(seen, place)["valid"] for place in (1, 2)] == [1.0, 0.0]
    assert row(seen, 1)["left"] < -4.0


def test_same_lane(first, world, thing):
    """The own lane is 3.5 m wide."""

    def told(scenario):
        seen = first(scenario)
        return [row(seen, place)["same_lane"] for place in (1, 2, 3)]

    things = [thing(30.0, 1.7), thing(40.0, 1.8), thing(50.0, -1.7)]
    assert told(world(things)) == [1.0, 0.0, 1.0]
    lanes = world().lanes
    aside = changed(world(things), lanes={"center": lanes.center.at[:, 0].set(1.0)})
    assert told(aside) == [1.0, 1.0, 0.0]
    behind = [thing(270.0, 0.0), thing(304.5, 0.0), thing(306.0, 0.0)]
    assert told(world(behind, start=(280.0, 0.0), goal=(290.0, 310.0))) == [1.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [(-1, 0, [1, 0, 0, 0]), (1, 0, [1, 1, 0, 0]), (0, 1, [0, 0, 1, 1]), (0, -1, [0, 0, 1, 0]), (1, 1, [1, 1, 1, 1])],
)
def test_lanes(first, world, left, right, expected):
    """Only those beside the ego count."""
    direction = np.zeros((301, 3), np.int32)
    direction[18:20] = 1, left, right
    seen = first(changed(world(), lanes={"direction": jnp.asarray(direction)}))
    names = [f"lane_{side}_{what}" for side in ("left", "right") for what in ("exists", "same_direction")]
    assert [seen[name] for name in names] == expected


def test_what_depends_on_planning_is_unknown_at_the_start(first, fields, world, thing):
    seen = first(world([thing(30.0, 0.0)]))
    begins = [index for index, field in enumerate(fields) if field.name == "feasible_share"][0]
    ends = [index for index, field in enumerate(fields) if field.name.startswith("weight_")][0]
    assert not any(seen[field.name] for field in fields[begins:ends])
    for one in PAPER_ADJUSTMENTS:
        middle = (one.default - one.low) / (one.high - one.low)
        assert seen[f"weight_{one.term}"] == pytest.approx(2 * middle - 1, abs=1e-6)


def test_the_trajectory(look, read, config, world, thing):
    near = world([thing(27.0, 3.0, speed=9.0)])
    cycle, _, report, observation = look(near, jf.reset(config, near))
    seen = read(observation)
    assert seen["feasible_share"] == pytest.approx(np.mean(np.asarray(cycle.feasibility.feasible)), abs=1e-5)
    assert 0.0 < float(report.ego_risk) == pytest.approx(seen["ego_risk"], rel=1e-3)
    assert 0.0 < float(report.third_party_risk) == pytest.approx(seen["third_party_risk"], rel=1e-3)
    assert seen["colliding"] == seen["infeasible"] == 0.0


@pytest.mark.parametrize("mode", ["EMERGENCY", "STANDSTILL", "INFEASIBLE"])
def test_flags_of_the_planning_cycle(look, read, config, world, thing, mode):
    scenario = {
        "EMERGENCY": lambda: world(block(thing, 32.0)),
        "STANDSTILL": lambda: world(block(thing, 24.8), speed=0.05),
        "INFEASIBLE": lambda: changed(world(), path={"length": jnp.float32(21.0)}),
    }[mode]()
    cycle, _, _, observation = look(scenario, jf.reset(config, scenario))
    assert jf.PlanMode(int(cycle.mode)).name == mode
    seen = read(observation)
    assert seen["infeasible"] == (mode == "INFEASIBLE")
    assert seen["colliding"] == (mode != "INFEASIBLE")
    assert seen["cost_velocity_offset_chosen"] == pytest.approx(
        float(cycle.costs[cycle.chosen, 3]) if mode == "EMERGENCY" else 0.0, rel=1e-3
    )
    assert all(np.isfinite(value) for value in seen.values())


def test_costs_are_told_of_the_chosen_and_over_the_valid_trajectories(look, read, config, world, thing):
    """Fast trajectories leave the path, which ends soon; they do not count."""
    scenario = changed(world([thing(37.0, 0.5, speed=4.0)], start=(20.0, 0.3)), path={"length": jnp.float32(52.0)})
    cycle, _, _, observation = look(scenario, jf.reset(config, scenario))
    valid = np.asarray(cycle.feasibility.valid)
    assert 0.2 < valid.mean() < 0.9
    seen, costs = read(observation), np.asarray(cycle.costs, float)
    for place, name in enumerate(jf.CostWeights().names()):
        assert seen[f"cost_{name}_chosen"] == pytest.approx(costs[int(cycle.chosen), place], rel=2e-4, abs=1e-5)
        assert seen[f"cost_{name}_mean"] == pytest.approx(costs[valid, place].mean(), rel=2e-4)
        assert seen[f"cost_{name}_variance"] == pytest.approx(costs[valid, place].var(), rel=2e-3)
        assert seen[f"cost_{name}_variance"] > 0.0


def outermost(cycle, quantity):
    """{(speed, side): value} of the trajectories whose ends are extreme, found by their ends."""
    bundle, costs = cycle.bundle, np.asarray(quantity)
    speeds, offsets = np.asarray(bundle.end_speed), np.asarray(bundle.end_offset)
    low, high = speeds.min(), speeds.max()
    found = {}
    for speed, wanted in (("slow", low), ("medium", 0.5 * (low + high)), ("fast", high)):
        for side, offset in (("right", -3.5), ("middle", 0.0), ("left", 3.5)):
            ends = (np.abs(speeds - wanted) < 1e-3) & (np.abs(offsets - offset) < 1e-3)
            place = np.flatnonzero(ends & (np.asarray(bundle.end_step) == 30))
            assert len(place) == 1
            found[speed, side] = costs[place[0]]
    return found


def test_the_outermost_trajectories(look, read, config, world, thing):
    scenario = world([thing(35.0, 0.9, speed=1.0), thing(57.0, -1.2)], start=(20.0, 0.3))
    cycle, _, _, observation = look(scenario, jf.reset(config, scenario))
    seen, expected = read(observation), outermost(cycle, cycle.costs[:, jf.CostWeights().names().index("prediction")])
    assert len({float(value) for value in expected.values() if value > 1e-6}) == 9
    for (speed, side), value in expected.items():
        assert seen[f"prediction_{speed}_{side}"] == pytest.approx(float(value), rel=2e-4, abs=1e-8), (speed, side)


def test_outermost_trajectories_that_leave_the_path_tell_nothing(look, read, config, world, thing):
    scenario = changed(world([thing(35.0, 0.9, speed=1.0)], start=(20.0, 0.3)), path={"length": jnp.float32(50.0)})
    cycle, _, _, observation = look(scenario, jf.reset(config, scenario))
    valid = outermost(cycle, cycle.feasibility.valid)
    assert valid["slow", "middle"] and not valid["fast", "middle"]
    seen = read(observation)
    for (speed, side), there in valid.items():
        assert there or seen[f"prediction_{speed}_{side}"] == 0.0
    assert seen["prediction_slow_middle"] > 0.0


def moved(scenario, angle, shift):
    """The whole world turned about the origin and shifted."""
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def put(points):
        return jnp.asarray(np.asarray(points, float) @ turn + shift, jnp.float32)

    nodes = put(np.stack([scenario.path.x, scenario.path.y], axis=-1))
    turned, goal = np.float32(angle), scenario.goal
    return changed(
        scenario,
        path={"x": nodes[:, 0], "y": nodes[:, 1], "heading": scenario.path.heading + turned},
        lane_map={"center": put(scenario.lane_map.center)},
        road={"segments": put(scenario.road.segments)},
        obstacles={"position": put(scenario.obstacles.position), "heading": scenario.obstacles.heading + turned},
        goal={"edges": put(goal.edges), "heading": goal.heading + jnp.asarray([angle, 0.0], jnp.float32)},
        initial_state={
            "position": put(scenario.initial_state.position),
            "heading": scenario.initial_state.heading + turned,
        },
    )


@pytest.mark.parametrize(
    ("angle", "shift"), [(0.0, (150.0, -90.0)), (np.pi, (10.0, 20.0)), (2.0, (0.0, 0.0)), (-2.6, (-120.0, 60.0))]
)
def test_where_on_the_map_it_is_cannot_be_told(look, first, config, world, thing, angle, shift):
    """Probabilities of collisions are masses of boxes along the map's axes, so half turns alone keep them."""
    near = [thing(40.0, 2.5, speed=8.0), thing(70.0, 4.0, speed=6.0, heading=np.pi), thing(5.0, -0.4, speed=4.0)]
    far = [thing(20.0, 20.0, speed=8.0), thing(70.0, -30.0, speed=6.0, heading=2.0), thing(25.0, 40.0)]
    things = near if np.isclose(np.sin(angle), 0.0) else far
    here = world(things, start=(20.0, 0.6), heading=0.05, speed=7.0)
    there = moved(here, angle, shift)
    assert first(there) == pytest.approx(first(here), rel=1e-3, abs=2e-3)
    states = [jf.reset(config, one) for one in (here, there)]
    for _ in range(6):
        (one, state_here, _, seen_here), (_, state_there, _, seen_there) = (
            look(scenario, state) for scenario, state in zip((here, there), states, strict=True)
        )
        np.testing.assert_allclose(seen_there, seen_here, atol=2e-3)
        states = [state_here, state_there]
    assert (float(one.costs[:, 4].max()) > 1e-3) == (things is near)


@pytest.mark.parametrize(
    "start",
    [
        dict(speed=0.0),
        dict(speed=1e-4),
        dict(speed=2.01, heading=1.2),
        dict(speed=50.0, yaw_rate=2.0),
        dict(start=(299.0, 0.0)),
        dict(start=(1.0, 0.0)),
        dict(start=(20.0, 5.9), heading=-1.5),
        dict(goal=None),
    ],
)
def test_nothing_is_ever_nan(look, config, world, thing, start):
    scenario = world([thing(30.0, 0.0, 5.0), thing(20.0, 0.0, 0.0)], **start)
    observation = look(scenario, jf.reset(config, scenario))[-1]
    assert np.isfinite(observation).all()
