"""The whole bundle against correct values in float64, recorded for seven planning cycles.

The file holds, per case, the path's tables, the ego's start, the prediction, and for 120 of the 800 trajectories every
quantity. Its prediction counts an obstacle with n entries as valid for n - 1 of them.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet import costs, feasibility
from jaxfrenet.reference_path import project
from jaxfrenet.sampling import sample_end_states
from jaxfrenet.scenario import Lanes
from jaxfrenet.trajectories import initial_ego_state, lay_out, multiply_out

CONFIG = jf.PlannerConfig()
WEIGHTS = jf.CostWeights(acceleration=0.0, jerk=0.0, orientation_offset=0.0)
TOLERANCE = dict(s=2e-3, d=2e-3, x=2e-3, y=2e-3, theta=1e-3, s_dot=1e-3, v=1e-3, s_ddot=1e-2, a=1e-2, kappa=1e-3)

FIELDS = dict(
    s="arc_length",
    d="offset",
    x="x",
    y="y",
    theta="heading",
    s_dot="arc_length_rate",
    v="speed",
    s_ddot="arc_length_acceleration",
    a="acceleration",
    kappa="curvature",
)


def single(value) -> jax.Array:
    return jnp.asarray(np.nan_to_num(value), jnp.float32)


def reference_path(case: dict) -> jf.ReferencePath:
    names = ("path_s", "path_x", "path_y", "path_theta", "path_kappa", "path_kappa_prime")
    return jf.ReferencePath(*(single(case[name]) for name in names), length=single(case["path_s"][-1]))


def prediction(case: dict) -> jf.Prediction:
    steps = CONFIG.horizon_steps
    valid = np.arange(steps) < case["pred_len"][:, None] - 1
    covariance = np.where(valid[..., None, None], case["pred_cov"][:, :steps], np.eye(2))
    return jf.Prediction(
        mean=single(case["pred_pos"][:, :steps]),
        covariance=single(covariance),
        heading=single(case["pred_orientation"][:, :steps]),
        speed=jnp.zeros(valid.shape),
        valid=jnp.asarray(valid),
        length=single(case["pred_shape"][:, 0]),
        width=single(case["pred_shape"][:, 1]),
    )


def bundle_of(path, start, desired_speed, predicted):
    arc_length, offset = project(path, start[0], start[1])
    names = ("x", "y", "heading", "speed", "acceleration")
    ego = initial_ego_state(
        path,
        arc_length=arc_length,
        offset=offset,
        **dict(zip(names, start, strict=False)),
        curvature=jnp.tan(start[5]) / CONFIG.vehicle.wheelbase,
    )
    end = sample_end_states(CONFIG, ego.speed, ego.arc_length_rate, ego.offset)
    rows = lay_out(CONFIG, path, ego, end)
    bundle = multiply_out(rows)
    nodes = path.x.size
    lanes = Lanes(jnp.zeros((nodes, 3)), jnp.ones((nodes, 3)), jnp.ones((nodes, 3), jnp.int32))
    inputs = costs.CostInputs(rows, bundle, predicted, desired_speed, path, lanes)
    terms = costs.evaluate(CONFIG, WEIGHTS, inputs)
    return ego, end, bundle.flat(), feasibility.check(CONFIG, bundle), terms, terms @ WEIGHTS.values()


plan_bundle = jax.jit(bundle_of)


def case_names(golden_file) -> list[str]:
    with np.load(golden_file) as data:
        return sorted({key.split("/")[0] for key in data.files if "/" in key})


@pytest.fixture(scope="module")
def results(golden_file):
    """{case: (recorded, computed)}; the rows of one compiled program per number of path nodes."""
    both = {}
    with np.load(golden_file) as data:
        for name in case_names(golden_file):
            recorded = {key.split("/")[1]: data[key] for key in data.files if key.startswith(f"{name}/")}
            arguments = single(recorded["x0_cart"]), single(recorded["v_desired"]), prediction(recorded)
            both[name] = recorded, jax.tree.map(np.asarray, plan_bundle(reference_path(recorded), *arguments))
    return both


def places(recorded_rows: np.ndarray) -> np.ndarray:
    """Where recorded trajectories are in the bundle: the record has end offsets innermost and end times outermost."""
    time, speed, offset = np.unravel_index(recorded_rows, (8, 10, 10))
    return np.ravel_multi_index((offset, speed, time), (10, 10, 8))


def rows_of(recorded: dict, computed: np.ndarray) -> np.ndarray:
    return computed[places(recorded["rows"])][recorded["valid"]]


def test_initial_state_and_samples(results):
    for recorded, (ego, end, *_) in results.values():
        along = ego.arc_length, ego.arc_length_rate, ego.arc_length_acceleration
        np.testing.assert_allclose(np.array(along), recorded["x_lon"], atol=2e-4)
        rate = np.float64(ego.offset_slope) * (1.0 if recorded["low_velocity_mode"] else ego.arc_length_rate)
        np.testing.assert_allclose([ego.offset, rate], recorded["x_lat"][:2], atol=2e-4)
        np.testing.assert_allclose(end.speed, recorded["v1_values"], atol=1e-4)
        np.testing.assert_allclose(end.offset, recorded["d1_values"], atol=1e-4)
        np.testing.assert_allclose(0.1 * CONFIG.end_steps, recorded["t1_values"], atol=1e-6)


@pytest.mark.parametrize("quantity", TOLERANCE)
def test_points(results, quantity):
    field = FIELDS[quantity]
    for name, (recorded, (_, _, bundle, *_)) in results.items():
        mine = rows_of(recorded, getattr(bundle.motion, field))
        worst = np.abs(mine - recorded[quantity][recorded["valid"]]).max()
        assert worst < TOLERANCE[quantity], f"{name}: {quantity} is off by {worst}"


def test_valid_and_feasible(results):
    agreed = []
    for recorded, (_, _, bundle, checked, *_) in results.values():
        np.testing.assert_array_equal(bundle.valid[places(recorded["rows"])], recorded["valid"])
        agreed.append(checked.feasible[places(recorded["rows"])] == recorded["feasible"])
    assert np.mean(agreed) >= 0.995


def test_violations_are_told_apart(results):
    names = ("yaw_rate", "acceleration", "curvature", "curvature_rate")
    agreed = {name: [] for name in names}
    for recorded, (_, _, _, checked, *_) in results.values():
        for column, name in enumerate(names):
            mine = rows_of(recorded, getattr(checked, name))
            agreed[name].append(mine == (recorded["feas_counts"][recorded["valid"], column] > 0))
    for name in names:
        assert np.concatenate(agreed[name]).mean() >= 0.995, name


def test_costs(results):
    """Relative to the larger of the value and 1e-3 of the term's mean, below which terms are noise."""
    for name, (recorded, (_, _, _, _, terms, _)) in results.items():
        expected = np.concatenate([recorded["cost_terms"], recorded["cost_terms_extra"]], axis=1)[recorded["valid"]]
        scale = np.maximum(np.abs(expected), 1e-3 * np.abs(expected).mean(axis=0))
        worst = np.max(np.abs(rows_of(recorded, terms) - expected) / scale, axis=0)
        assert (worst < 1e-3).all(), f"{name}: {dict(zip(WEIGHTS.names(), worst, strict=True))}"


def test_chosen_trajectory(results):
    for name, (recorded, (_, _, _, checked, _, total)) in results.items():
        ranked = np.where(checked.feasible, total, np.inf)
        best = places(recorded["chosen_row"])
        assert ranked[best] <= 1.001 * ranked.min(), name


def test_the_current_state_is_point_zero(results):
    """Frenet to Cartesian inverts Cartesian to Frenet (Werling et al. 2010, appendix)."""
    for recorded, (_, _, bundle, *_) in results.values():
        x, y, heading, speed, acceleration, steering = recorded["x0_cart"]
        motion = bundle.motion
        first = np.stack([motion.x, motion.y, motion.heading, motion.speed, motion.acceleration])[:, :, 0]
        expected = np.array([x, y, heading, speed, acceleration])[:, None]
        assert np.abs(first - expected)[:2].max() < 1e-3
        assert np.abs(first - expected)[2:4].max() < 1e-4
        if speed > 0:
            np.testing.assert_allclose(first[4], acceleration, atol=1e-3)
            curvature = np.tan(steering) / CONFIG.vehicle.wheelbase
            np.testing.assert_allclose(motion.curvature[:, 0], curvature, atol=1e-4)


def test_jit_agrees_with_eager(golden_file):
    """One case without `jit`, operation by operation."""
    with np.load(golden_file) as data:
        name = case_names(golden_file)[0]
        recorded = {key.split("/")[1]: data[key] for key in data.files if key.startswith(f"{name}/")}
    arguments = (
        reference_path(recorded),
        single(recorded["x0_cart"]),
        single(recorded["v_desired"]),
        prediction(recorded),
    )
    with jax.disable_jit():
        eager = bundle_of(*arguments)
    np.testing.assert_allclose(eager[-1], plan_bundle(*arguments)[-1], rtol=1e-4)
