"""The benchmark on tiny cases: what it measures, what it writes, and that the reference is given the same as ours."""

from __future__ import annotations

import dataclasses
import json
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
import ppo
from experiments import _measuring, benchmark
from experiments._benchmark_plot import draw_benchmark
from experiments._measuring import Budget, DoesNotFit, compile_ahead, measure, work_of
from experiments._planner_timing import Case, arms, nearest_level, star
from experiments._planning_cases import nearness, planning_batch
from experiments._presets import PRESETS
from experiments._reference import ReferenceCase, ReferencePlanner, Traffic, reference_case
from jaxfrenet.sampling import sample_end_states
from jaxfrenet.trajectories import generate

FULL = jf.PlannerConfig()
LOOPS = ["--generate", "1", "--generator-seed", "1", "--presets", "fast", "--loop-batch", "1", "--steps", "3"]
SMALL_LEARNER = ppo.PPOConfig(environments=1, rollout_steps=6, epochs=1, minibatches=1, network=ppo.NetworkConfig(8))
PLANNER = ["--batch", "2", "1", "--trajectories", "40", "--obstacles", "5", "--layouts", "mixed"]
GOLDEN_CASES = (
    "straight_v12",
    "straight_v5",
    "arc40_v5",
    "turn15_v12",
    "tjunction_v0p5",
    "straight_v0",
    "straight_short_v12",
)


def results_in(folder: Path) -> dict:
    return json.loads((folder / "benchmark.json").read_text())


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    """Results of all parts but training, with as little work as possible."""
    out = tmp_path_factory.mktemp("benchmark")
    parts = ["--parts", "planner", "episode", "environment", "predictor"]
    benchmark.main([*parts, *PLANNER, "--batch", "1", *LOOPS, "--repeats", "2", "--out", str(out)])
    return out


def test_planner_rows(measured):
    results = results_in(measured)
    assert [(row["batch"], row["trajectories"]) for row in results["planner"]] == [(1, 48)]
    assert results["skipped"] == []
    for row in results["planner"]:
        assert (row["layout"], row["obstacles"]) == ("mixed", 5)
        assert 0 < row["ms_per_cycle"] <= row["p99_ms"]
        assert row["cycles_per_second"] == pytest.approx(1e3 / row["ms_per_cycle"], rel=1e-3)
        assert row["trajectories_per_second"] == pytest.approx(48 * row["cycles_per_second"], rel=1e-3)
        assert row["compile_seconds"] > 0 and row["megabytes_per_scenario"] > 0
        assert row["reference_serial_ms"] is row["reference_concurrent_ms"] is row["ratio"] is None
        done = row["flops_per_cycle"] * row["cycles_per_second"]
        assert row["share_of_peak_flops"] == pytest.approx(done / results["machine"]["peak_flops_per_second"], rel=1e-2)
        assert row["flops_per_byte"] == pytest.approx(row["flops_per_cycle"] / row["bytes_per_cycle"], rel=1e-3)


def test_loop_rows(measured):
    results = results_in(measured)
    (episode,), (environment,) = results["episode"], results["environment"]
    assert (episode["preset"], episode["batch"], episode["episodes"]) == ("fast", 1, 1)
    assert episode["steps_per_second"] > 0 and episode["steps"] >= 2
    assert (environment["preset"], environment["batch"], environment["steps"]) == ("fast", 1, 3)
    assert environment["steps_per_second"] > 0 and environment["ended_episodes"] == 0
    assert [(row["predictor"], row["what"], row["batch"]) for row in results["predictor"]] == [
        ("neural", "step", 1),
        ("neural", "table", 1),
        ("constant_velocity", "step", 1),
        ("ground_truth", "step", 1),
    ]
    assert all(row["ms_per_scenario"] > 0 for row in results["predictor"])


def test_training_row(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(PRESETS, "quick", dataclasses.replace(PRESETS["quick"], ppo=SMALL_LEARNER))
    options = ["--parts", "training", "--training", "quick", *LOOPS, "--repeats", "2", "--out", str(tmp_path)]
    benchmark.main(options)
    (training,) = results_in(tmp_path)["training"]
    assert (training["preset"], training["environments"] * training["rollout_steps"]) == ("quick", 6)
    assert training["hours_per_million_steps"] == pytest.approx(1e6 / 3600 / training["steps_per_second"], rel=1e-3)
    assert "h/1M steps" in capsys.readouterr().out


def test_machine_and_picture(measured):
    machine = results_in(measured)["machine"]
    assert machine["cores"] >= 1 and machine["jax"] == jax.__version__ and machine["cpu"] and machine["device"]
    assert machine["peak_flops_per_second"] > 1e8 and machine["peak_bytes_per_second"] > 1e8
    assert machine["process_megabytes"] > 100
    assert (measured / "benchmark.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in measured.iterdir() if path.name.startswith(".")] == []


def test_what_does_not_fit_is_reported(tmp_path, monkeypatch, capsys):
    def refused(case, *_):
        raise DoesNotFit(f"{case.batch} are too many")

    monkeypatch.setattr(benchmark, "measure_case", refused)
    benchmark.main(["--parts", "planner", *PLANNER, "--out", str(tmp_path)])
    results = results_in(tmp_path)
    assert results["planner"] == [] and not (tmp_path / "benchmark.png").exists()
    assert [one["reason"] for one in results["skipped"]] == ["2 are too many", "1 are too many"]
    assert "mixed, 5 obstacles, 48 trajectories, batch 2" in capsys.readouterr().out


def test_a_program_that_needs_too_much_is_not_run(monkeypatch):
    values = jnp.ones((100, 100))
    program = compile_ahead(lambda x: x @ x + 1.0, values)
    np.testing.assert_allclose(program.run(), 101.0)
    assert (work_of(program).memory or 0) >= 2 * values.nbytes
    assert (work_of(program).flops or 0) >= 2e6
    monkeypatch.setattr(_measuring, "free_memory", lambda: values.nbytes - 1)
    with pytest.raises(DoesNotFit, match="MB are free"):
        compile_ahead(lambda x: x @ x + 1.0, values)


def test_calls_alternate_and_quick_ones_come_more_often(monkeypatch):
    """On a clock that only the calls move."""
    now, called = [0.0], []

    def call(name: str, seconds: float) -> None:
        called.append(name)
        now[0] += seconds

    monkeypatch.setattr(_measuring.time, "perf_counter", lambda: now[0])
    calls = [partial(call, "quick", 1.0), partial(call, "slow", 4.0)]
    quick, slow = measure(calls, Budget(seconds=0.0, repeats=2))
    assert called == ["quick", "quick", "slow", "slow", *2 * ["quick", "quick", "quick", "quick", "slow"]]
    assert quick.tolist() == [1.0] * 8 and slow.tolist() == [4.0] * 2
    assert len(measure(calls, Budget(seconds=0.0))[1]) == 3
    assert len(measure(calls, Budget(seconds=41.0))[1]) == 6


def test_the_star_around_the_usual_case():
    cases = star((1, 16, 64, 512), (1, 2, 3, 4), (0, 5, 10, 30), ("near", "mixed", "far"))
    assert cases == [
        *(Case("mixed", 5, batch, 2) for batch in (1, 16, 64, 512)),
        Case("near", 5, 64, 2),
        Case("far", 5, 64, 2),
        *(Case("mixed", count, 64, 2) for count in (0, 10, 30)),
        *(Case("mixed", 5, 1, level) for level in (1, 3, 4)),
    ]
    assert star((4,), (0,), (3,), ("far",)) == [Case("far", 3, 4, 0)]
    rows = [case.as_plain() for case in cases]
    batches, trajectories = arms(rows, cases)
    assert [row["batch"] for row in batches] == [1, 16, 64, 512]
    assert sorted(row["trajectories"] for row in trajectories) == [180, 800, 3564, 12716]


@pytest.mark.parametrize(("wanted", "level"), [(1, 0), (200, 1), (800, 2), (3000, 3), (12000, 4), (10**6, 4)])
def test_nearest_level(wanted, level):
    assert nearest_level(wanted) == level


def test_the_picture_shows_every_series():
    rows = [
        Case("mixed", 5, batch, 2).as_plain()
        | {"ms_per_cycle": 2.0 / batch, "reference_serial_ms": 100.0, "reference_concurrent_ms": 60.0}
        for batch in (1, 64)
    ]
    left, right = draw_benchmark(rows, rows[:1], "machine").axes
    assert left.get_xscale() == left.get_yscale() == right.get_xscale() == "log"
    assert [line.get_label() for line in left.lines] == ["jaxfrenet", "reference, serial", "reference, concurrent"]
    assert np.asarray(left.lines[0].get_xydata()).tolist() == [[1.0, 2.0], [64.0, 2.0 / 64]]
    assert left.get_title(loc="left") == "5 obstacles, mixed; 800 trajectories"
    assert not draw_benchmark(rows, [], "machine").axes[1].lines


@pytest.mark.parametrize(("obstacles", "batch"), [(5, 1), (5, 8), (10, 4), (30, 4)])
def test_shares_of_near_triples(obstacles, batch):
    assert 0.2 <= (nearness(FULL, *planning_batch(FULL, "mixed", obstacles, batch)).share or 0) <= 0.3
    assert (nearness(FULL, *planning_batch(FULL, "near", obstacles, batch)).share or 0) > 0.6
    far_scenario, far_state = planning_batch(FULL, "far", obstacles, batch)
    far = nearness(FULL, far_scenario, far_state)
    assert far.share == 0.0 and 50.0 < far.closest < 80.0
    predict = jax.vmap(partial(jf.predict, FULL))
    predicted = predict(far_scenario, far_state.step, far_state.ego.x, far_state.ego.y)
    assert predicted.valid.shape == (batch, obstacles, 30) and bool(jnp.all(predicted.valid))


def test_near_is_seven_metres_between_centres():
    """Counted one by one."""
    scenario, state = planning_batch(FULL, "mixed", 5, 1)
    empty = planning_batch(FULL, "mixed", 0, 1)
    assert nearness(FULL, *empty) == (None, np.inf)
    ego = jax.tree.map(lambda leaf: leaf[0], state.ego)
    end = sample_end_states(FULL, ego.speed, ego.arc_length_rate, ego.offset)
    path = jax.tree.map(lambda leaf: leaf[0], scenario.path)
    motion = jax.tree.map(np.asarray, generate(FULL, path, ego, end).motion)
    ahead = FULL.vehicle.rear_axle_to_center
    x, y = motion.x + ahead * np.cos(motion.heading), motion.y + ahead * np.sin(motion.heading)
    x, y = (value if value.shape[0] == FULL.points else value.T for value in (x, y))
    first = jax.tree.map(lambda leaf: np.asarray(leaf[0]), scenario.obstacles)
    near = 0
    for index in range(5):
        start, heading, speed = first.position[index, 0], first.heading[index, 0], first.speed[index, 0]
        for step in range(1, 31):
            place = start + 0.1 * step * speed * np.array([np.cos(heading), np.sin(heading)])
            near += np.sum(np.hypot(x[step] - place[0], y[step] - place[1]) <= 7.0)
    assert nearness(FULL, scenario, state).share == pytest.approx(near / (800 * 5 * 30), abs=1e-4)


def test_batches_are_distinct_and_grow():
    small, large = (planning_batch(FULL, "mixed", 3, batch) for batch in (2, 4))
    jax.tree.map(lambda few, many: np.testing.assert_allclose(few, many[:2], rtol=1e-5, atol=1e-4), small, large)
    speeds, starts = np.asarray(large[1].ego.speed), np.asarray(large[0].obstacles.position[:, 0, 0, 0])
    assert len(set(speeds.tolist())) == len(set(starts.tolist())) == 4
    other = planning_batch(FULL, "mixed", 3, 2, seed=1)
    assert not np.allclose(other[0].obstacles.position, small[0].obstacles.position)
    np.testing.assert_allclose(speeds, 9.0, atol=0.5)
    assert np.all(np.asarray(large[1].outcome) == jf.Outcome.RUNNING)


@pytest.fixture(scope="module")
def cycle() -> tuple[jf.Scenario, jf.SimulationState, ReferenceCase]:
    scenario, state = jax.tree.map(lambda leaf: leaf[0], planning_batch(FULL, "mixed", 5, 1))
    return scenario, state, reference_case(FULL, scenario, state)


def our_bundle(scenario: jf.Scenario, state: jf.SimulationState) -> tuple[np.ndarray, np.ndarray]:
    """End step, speed and offset `[trajectories, 3]`, sorted, and positions `[trajectories, points, 2]`."""
    ego = state.ego
    end = sample_end_states(FULL, ego.speed, ego.arc_length_rate, ego.offset)
    bundle = jax.tree.map(np.asarray, generate(FULL, scenario.path, ego, end))
    ends = np.stack([bundle.end_step, bundle.end_speed, bundle.end_offset], axis=-1)
    positions = np.stack([bundle.motion.x, bundle.motion.y], axis=-1)
    positions = positions if len(positions) == len(ends) else np.swapaxes(positions, 0, 1)
    return ends[sorted_rows(ends)], positions[sorted_rows(ends)]


def sorted_rows(ends: np.ndarray) -> np.ndarray:
    return np.lexsort(np.round(ends, 3).T[::-1])


def ends_of(case: ReferenceCase) -> np.ndarray:
    return np.stack([np.rint(case.samples[:, 1] / jf.DT), case.samples[:, 5], case.samples[:, 10]], axis=-1)


def test_the_reference_is_given_the_same(cycle):
    scenario, state, case = cycle
    ego, ends = state.ego, ends_of(case)
    ours, _ = our_bundle(scenario, state)
    assert case.samples.shape == (800, 13)
    np.testing.assert_allclose(ends[sorted_rows(ends)], ours, rtol=1e-5, atol=1e-6)
    start = [ego.arc_length, ego.arc_length_rate, ego.arc_length_acceleration]
    np.testing.assert_allclose(case.samples[:, 2:5], np.tile(np.array(start), (800, 1)))
    prediction = jf.predict(FULL, scenario, state.step, ego.x, ego.y)
    np.testing.assert_allclose(case.traffic.position[:, :30], prediction.mean, rtol=1e-5)
    np.testing.assert_allclose(case.traffic.covariance[:, :30], prediction.covariance, atol=1e-5)
    np.testing.assert_array_equal(case.traffic.entries, 31)
    np.testing.assert_allclose(case.traffic.size, [[5.0, 2.0]] * 5, rtol=1e-6)


def test_the_reference_drives_the_same_trajectories(cycle):
    """Those that end after 1.1 s: of other end times it rounds some steps down."""
    pytest.importorskip("frenetix", reason="the reference is not installed: jaxfrenet[reference]")
    scenario, state, case = cycle
    planner = ReferencePlanner(FULL, jf.CostWeights(), case)
    planner.serial()
    ends, theirs = ends_of(case), np.zeros((800, 31, 2))
    for one in planner._handler.get_sorted_trajectories():
        theirs[one.uniqueId] = np.stack([one.cartesian.x, one.cartesian.y], axis=-1)
    ours, positions = our_bundle(scenario, state)
    earliest = ours[:, 0] == FULL.shortest_end_step
    assert np.sum(earliest) == 100 and planner.evaluated().valid.all()
    np.testing.assert_allclose(theirs[sorted_rows(ends)][earliest], positions[earliest], atol=0.03)


@pytest.mark.data
@pytest.mark.parametrize("name", GOLDEN_CASES)
@pytest.mark.parametrize("concurrent", [False, True])
def test_the_reference_gives_what_was_recorded_of_it(data_root, name, concurrent):
    pytest.importorskip("frenetix", reason="the reference is not installed: jaxfrenet[reference]")
    file = data_root / "golden" / "wheel_cases.npz"
    if not file.is_file():
        pytest.skip(f"{file} does not exist")
    with np.load(file) as data:
        recorded = {key.split("/")[1]: data[key] for key in data.files if key.startswith(f"{name}/")}
    traffic = Traffic(*(recorded[f"pred_{field}"] for field in ("pos", "orientation", "cov", "len", "shape")))
    case = ReferenceCase(
        path=recorded["ref_path"],
        samples=recorded["sampling_matrix"],
        heading=float(recorded["x0_cart"][2]),
        desired_speed=float(recorded["v_desired"]),
        low_velocity=bool(recorded["low_velocity_mode"]),
        traffic=traffic,
    )
    planner = ReferencePlanner(FULL, jf.CostWeights(), case)
    planner.concurrent() if concurrent else planner.serial()
    found = planner.evaluated()
    np.testing.assert_array_equal(found.valid, recorded["valid"])
    np.testing.assert_array_equal(found.feasible, recorded["feasible"])
    np.testing.assert_allclose(found.cost, recorded["cost_total"], rtol=1e-9)
    np.testing.assert_array_equal(found.rank, recorded["rank"])


def test_ratios_are_against_the_faster_variant(tmp_path, capsys):
    pytest.importorskip("frenetix", reason="the reference is not installed: jaxfrenet[reference]")
    arguments = ["--parts", "planner", *PLANNER[3:], "--batch", "2", "--reference", "--repeats", "1"]
    benchmark.main([*arguments, "--out", str(tmp_path)])
    results = results_in(tmp_path)
    (row,) = results["planner"]
    faster = min(row["reference_serial_ms"], row["reference_concurrent_ms"])
    assert row["ratio"] == pytest.approx(faster / row["ms_per_cycle"], rel=1e-3)
    assert results["machine"]["frenetix"] and "concurrent" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--parts", "wheels"], "invalid choice 'wheels' for argument '--parts'"),
        (["--parts"], "--parts names nothing"),
        (["--batch", "0"], "--batch 0: give at least 1"),
        (["--batch", "8", "-1"], "--batch -1: give at least 1"),
        (["--loop-batch", "0"], "--loop-batch 0: give at least 1"),
        (["--trajectories", "0"], "--trajectories 0: give at least 1"),
        (["--obstacles", "-2"], "--obstacles -2: give at least 0"),
        (["--layouts", "dense"], "invalid choice 'dense'"),
        (["--steps", "0"], "--steps 0: give at least 1"),
        (["--repeats", "0"], "--repeats 0: give at least 1"),
        (["--seconds", "nan"], "--seconds nan: give 0 or more"),
        (["--scenarios", "nowhere.xml"], "nowhere.xml"),
    ],
)
def test_bad_input_gets_one_clear_line(arguments, complaint, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        benchmark.main([*arguments, "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and len(error) == 1 and complaint in error[0]


def test_without_the_reference_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "frenetix", None)
    with pytest.raises(SystemExit) as stop:
        benchmark.main(["--reference", "--out", str(tmp_path)])
    assert stop.value.code == 2 and "install jaxfrenet[reference]" in capsys.readouterr().err
