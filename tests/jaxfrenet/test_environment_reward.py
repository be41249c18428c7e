"""Actions, rewards, collisions from behind, settings that are refused; and that the documentation's tables agree."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.environment import (
    PAPER_ADJUSTMENTS,
    REWARD_TERMS,
    Adjustment,
    EnvironmentConfig,
    RewardFactors,
    observation_fields,
)
from jaxfrenet.environment.action import adjust, cost_weights, default_weights
from jaxfrenet.environment.driving import _struck_from_behind
from jaxfrenet.environment.reward import reward_terms

DEFAULT = [200.0, 1.0, 1.0, 1.0, 1.0]


def report(desired_speed=8.0, ego_risk=2e-4, third_party_risk=5e-5) -> jf.StepReport:
    zero, none, terms = jnp.zeros(()), jnp.int32(0), jnp.zeros(5)
    speed, ego, others = (jnp.float32(value) for value in (desired_speed, ego_risk, third_party_risk))
    return jf.StepReport(none, speed, terms, terms, zero, zero, zero, none, ego, others)


@pytest.fixture(scope="module")
def states(world, config):
    """Before and after a step of 0.7 m, to 6.5 m/s and an offset of -0.4 m."""
    before = jf.reset(config, world(speed=7.0))
    moved = {"speed": 6.5, "offset": -0.4, "arc_length": float(before.ego.arc_length) + 0.7}
    ego = dataclasses.replace(before.ego, **{name: jnp.float32(value) for name, value in moved.items()})
    return before, dataclasses.replace(before, ego=ego)


@pytest.fixture(scope="module")
def terms(states):
    def of(outcome=jf.Outcome.RUNNING, weights=DEFAULT, factors=None, told=None):
        before, after = states
        after = dataclasses.replace(after, outcome=jnp.int32(outcome))
        given = factors or RewardFactors(), PAPER_ADJUSTMENTS, jnp.asarray(weights, jnp.float32)
        found = reward_terms(*given, before, after, told or report())
        return {name: float(value) for name, value in found.items()}

    return of


DENSE = {"speed": -0.12 * 1.5, "ego_risk": -3000 * 2e-4, "third_party_risk": -3000 * 5e-5}
SPARSE = {
    jf.Outcome.RUNNING: {},
    jf.Outcome.GOAL_REACHED_IN_TIME: {"goal_reached_in_time": 1000.0},
    jf.Outcome.GOAL_REACHED_FASTER: {"goal_reached_faster": 300.0},
    jf.Outcome.GOAL_REACHED_LATE: {"goal_reached_late": 300.0},
    jf.Outcome.COLLISION_OBSTACLE: {"collision": -10000.0},
    jf.Outcome.COLLISION_ROAD: {"collision": -10000.0},
    jf.Outcome.INFEASIBLE: {"infeasible": -8000.0},
    jf.Outcome.TIMEOUT: {"timeout": -8000.0},
    jf.Outcome.PAST_GOAL: {"past_goal": -8000.0},
}


@pytest.mark.parametrize("outcome", jf.Outcome)
def test_each_outcome_has_its_reward(terms, outcome):
    expected = dict.fromkeys(REWARD_TERMS, 0.0) | DENSE | SPARSE[outcome]
    assert terms(outcome) == pytest.approx(expected, rel=1e-5)


def test_weights_away_from_the_default_cost(terms):
    found = terms(weights=[260.0, 0.7, 1.0, 1.2, 0.001])
    assert found["prediction_weight"] == pytest.approx(-0.0005 * 60.0, rel=1e-5)
    assert found["weights"] == pytest.approx(-0.1 * (0.3 + 0.2 + 0.999), rel=1e-5)


def test_terms_that_are_off_by_default(terms):
    factors = RewardFactors(offset=-2.0, progress=3.0, risk_magnitude=-0.5)
    found = terms(factors=factors)
    assert found["offset"] == pytest.approx(-2.0 * 0.4, rel=1e-5)
    assert found["progress"] == pytest.approx(3.0 * 0.7, rel=1e-5)
    assert found["risk_magnitude"] == pytest.approx(-0.5 * np.log10(1 + 2.5e-4 / 1e-6), rel=1e-5)
    assert terms(factors=factors, told=report(ego_risk=0.0, third_party_risk=0.0))["risk_magnitude"] == 0.0


def test_every_factor_multiplies_its_term(terms):
    doubled = RewardFactors(**{name: 2.0 * getattr(RewardFactors(), name) for name in REWARD_TERMS})
    once, twice = (terms(jf.Outcome.TIMEOUT, [180.0, 0.5, 1.0, 1.0, 1.5], one) for one in (RewardFactors(), doubled))
    assert twice == pytest.approx({name: 2.0 * value for name, value in once.items()}, rel=1e-6)


def test_the_first_weights_are_the_default_planners(config):
    weights = cost_weights(PAPER_ADJUSTMENTS, default_weights(PAPER_ADJUSTMENTS))
    assert weights.names() == jf.CostWeights().names()
    np.testing.assert_array_equal(weights.values(), jf.CostWeights().values())


@pytest.mark.parametrize("action", [0.0, np.nan, -0.0])
def test_actions_that_change_nothing(action):
    before = jnp.asarray([33.3, 0.1, 0.7, 1.9, 0.001])
    np.testing.assert_array_equal(adjust(PAPER_ADJUSTMENTS, before, jnp.full(5, action)), before)


def test_a_table_in_another_order():
    table = (Adjustment("yaw_rate", 0.5, 0.0, 3.0, 1.0), PAPER_ADJUSTMENTS[4], PAPER_ADJUSTMENTS[0])
    weights = adjust(table, default_weights(table), jnp.asarray([1.0, -1.0, 0.5]))
    np.testing.assert_allclose(weights, [1.5, 0.9, 210.0], rtol=1e-6)
    named = cost_weights(table, weights)
    assert named.names() == ("velocity_offset", "prediction", "yaw_rate")
    np.testing.assert_allclose(named.values(), [0.9, 210.0, 1.5], rtol=1e-6)


@pytest.mark.parametrize(
    ("term", "numbers", "message"),
    [
        ("speed", (1, 0, 2, 1), "adjustment of 'speed': there is no such cost term; there are lateral_jerk, "),
        (
            "jerk",
            (0, 0, 2, 1),
            "adjustment of 'jerk': choose finite numbers, a scale above 0, and 0 ≤ low ≤ default ≤ high",
        ),
        ("jerk", (-1, 0, 2, 1), "a scale above 0"),
        ("jerk", (np.nan, 0, 2, 1), "a scale above 0"),
        ("jerk", (np.inf, 0, 2, 1), "choose finite numbers"),
        ("jerk", (1, 0, np.inf, 1), "choose finite numbers"),
        ("jerk", (1, -1, 2, 1), "0 ≤ low ≤ default ≤ high"),
        ("jerk", (1, 0, 2, 3), "0 ≤ low ≤ default ≤ high"),
        ("jerk", (1, 1.5, 2, 1), "0 ≤ low ≤ default ≤ high"),
        ("jerk", (1, 1, 1, 1), "0 ≤ low ≤ default ≤ high"),
        ("jerk", (1, 0, np.nan, 1), "0 ≤ low ≤ default ≤ high"),
    ],
)
def test_what_cannot_be_adjusted_is_refused(term, numbers, message):
    scale, low, high, default = map(float, numbers)
    with pytest.raises(ValueError, match=re.escape(message)):
        Adjustment(term, scale, low, high, default)


@pytest.mark.parametrize("table", [(), (PAPER_ADJUSTMENTS[0], PAPER_ADJUSTMENTS[0])])
def test_tables_that_are_no_actions_are_refused(table):
    with pytest.raises(ValueError, match=r"adjustments are \[.*\]: name at least one cost term, and each once"):
        EnvironmentConfig(adjustments=table)


@pytest.mark.parametrize("turn", [0.0, 2.5])
@pytest.mark.parametrize(
    ("ahead", "aside", "behind"),
    [
        (-4.0, 0.0, True),
        (-4.0, 1.5, True),
        (4.0, 0.0, False),
        (4.0, -1.0, False),
        (0.0, 1.5, False),
        (-1.0, 1.4, False),
    ],
)
def test_collisions_from_behind(world, thing, config, turn, ahead, aside, behind):
    """An obstacle that follows, one that is run into, and one beside; whichever way the ego points."""
    x, y = 20.0 + ahead * np.cos(turn) - aside * np.sin(turn), ahead * np.sin(turn) + aside * np.cos(turn)
    scenario = world([thing(x, y, heading=turn)], heading=turn)
    state = jf.reset(config, world(heading=0.0))
    ego = dataclasses.replace(state.ego, heading=jnp.float32(turn))
    ego = dataclasses.replace(
        ego,
        x=jnp.float32(20.0 - config.vehicle.rear_axle_to_center * np.cos(turn)),
        y=jnp.float32(-config.vehicle.rear_axle_to_center * np.sin(turn)),
    )
    setting = EnvironmentConfig(planner=config)
    for outcome in (jf.Outcome.COLLISION_OBSTACLE, jf.Outcome.RUNNING, jf.Outcome.COLLISION_ROAD):
        ended = dataclasses.replace(state, ego=ego, outcome=jnp.int32(outcome))
        struck = bool(_struck_from_behind(setting, scenario, ended))
        assert struck == (behind and outcome is jf.Outcome.COLLISION_OBSTACLE)


def test_who_is_behind_but_does_not_touch_has_not_struck(world, thing, config):
    scenario = world([thing(24.0, 0.0), thing(14.0, 0.0), thing(16.0, 0.0, steps=(1, 61))])
    state = dataclasses.replace(jf.reset(config, scenario), outcome=jnp.int32(jf.Outcome.COLLISION_OBSTACLE))
    assert not _struck_from_behind(EnvironmentConfig(planner=config), scenario, state)
    later = dataclasses.replace(state, step=jnp.int32(1))
    assert _struck_from_behind(EnvironmentConfig(planner=config), scenario, later)


def tables() -> dict[str, list[dict[str, str]]]:
    """{a column's title: rows} of the documentation's tables; code marks are left out."""
    text = (Path(__file__).parents[2] / "docs" / "environment.md").read_text(encoding="utf-8")
    found = {}
    for table in re.findall(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines())
        rows = [dict(zip(head, (cell.replace("`", "") for cell in row), strict=True)) for row in rows]
        found |= dict.fromkeys(head, rows)
    return found


def expanded(name: str) -> list[str]:
    """`a_{b, c}_d` is `a_b_d` and `a_c_d`."""
    head, *braces = re.split(r"[{}]", name)
    return [f"{head}{each}{braces[1]}" for each in braces[0].split(", ")] if braces else [head]


def number(cell: str) -> float:
    return np.pi if cell == "π" else float(cell.replace("−", "-"))


def test_the_documented_observation_is_the_one_there_is():
    documented = {}
    for row in tables()["Field"]:
        names, places = expanded(row["Field"]), [int(place) for place in row["Index"].split(", ")]
        assert len(names) == len(places) and row["What it is"]
        for name, place in zip(names, places, strict=True):
            assert place not in documented
            documented[place] = name, row["Unit"], number(row["Scale"]), row["Kind"]
    fields = observation_fields(EnvironmentConfig())
    assert [documented[place] for place in sorted(documented)] == [
        (field.name, field.unit, field.scale, field.kind) for field in fields
    ]
    assert sorted(documented) == list(range(len(fields)))


def test_the_documented_actions_are_those_there_are():
    documented = [
        Adjustment(
            row["Cost weight"],
            scale=number(row["Change per step"]),
            low=number(row["Lowest"]),
            high=number(row["Highest"]),
            default=number(row["Start"]),
        )
        for row in tables()["Cost weight"]
    ]
    assert tuple(documented) == PAPER_ADJUSTMENTS
    assert [int(row["Index"]) for row in tables()["Cost weight"]] == list(range(len(PAPER_ADJUSTMENTS)))


def test_the_documented_rewards_are_those_there_are():
    documented = {row["Reward term"]: number(row["Factor"]) for row in tables()["Reward term"]}
    assert documented == dataclasses.asdict(RewardFactors())
