"""What the study as a whole shows: outcomes, risk, driving behaviour, run time, training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments import _paper
from experiments._comparison import compare
from experiments._exhibits import COLLISION, DEFAULT, HYBRID, OTHER, Comparison, Exhibit, box_plot, new_figure, plain
from experiments._learning_curve import learning_curve
from experiments._results import OUTCOMES, SIDES
from experiments._run_time import PARTS
from experiments._study import Driven

LEAST_DRAWN = 1e-15
"""Smaller risks are drawn as this one: most episodes are all but free of it."""
UNITS = {"speed": "m/s", "offset": "m", "unweighted_cost": "1"}
TITLES = {"speed": "speed", "offset": "offset d from the reference path", "unweighted_cost": "unweighted cost"}


def label(name: str) -> str:
    """A planner's name for people: `default_200` is DP with that weight of the collision probability."""
    return "HP" if name == "hybrid" else f"DP {name.removeprefix('default_')}"


def outcomes(every: Mapping[str, Driven]) -> Exhibit:
    """Stacked bars of successes and collisions for each planner."""
    data = [_counted(name, driven) for name, driven in every.items()]
    figure = new_figure(7.0, 3.6)
    axes = plain(figure.subplots(), y="share of scenarios [%], axis cut")
    labels, below = [label(name) for name in every], np.zeros(len(data))
    for part, color in (("success", HYBRID), ("collision", COLLISION), ("other", OTHER)):
        share = 100.0 * np.array([row[part] / row["scenarios"] for row in data])
        bars = axes.bar(labels, share, bottom=below, color=color, label=part, width=0.6)
        counts = [str(row[part]) if row[part] else "" for row in data]
        axes.bar_label(bars, counts, label_type="center", fontsize=8)
        below += share
    axes.set_ylim(max(0.0, 100.0 * min(row["success"] / row["scenarios"] for row in data) - 8.0), 100.5)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8, frameon=False)
    compared = [
        Comparison(
            f"{label(row['configuration'])}: collisions in {row['scenarios']} scenarios",
            str(row["collision"]),
            f"{_paper.HYBRID_COLLISIONS if row['configuration'] == 'hybrid' else _paper.DEFAULT_COLLISIONS} "
            f"in {_paper.SCENARIOS}",
        )
        for row in data
    ]
    text = (
        "How episodes end with the default planner (DP), whose weight of the collision probability is the number, and "
        "with the hybrid planner (HP). A success is a goal reached in time, faster or late; other ends are time-outs, "
        "goals passed, and no feasible trajectory."
    )
    return Exhibit("outcomes", "Success and collisions", text, figure, data, compared)


def _counted(name: str, driven: Driven) -> dict[str, Any]:
    ends = {outcome: sum(row["outcome"] == outcome for row in driven.rows) for outcome in OUTCOMES}
    success = sum(count for outcome, count in ends.items() if outcome.startswith("goal"))
    collision = sum(count for outcome, count in ends.items() if outcome.startswith("collision"))
    total = len(driven.rows)
    told = {"configuration": name, "scenarios": total, "success": success, "collision": collision}
    return told | {"other": total - success - collision} | ends


def risk(default: Driven, hybrid: Driven) -> Exhibit:
    """Box plots of the episodes' mean risks."""
    planners = {"hybrid": hybrid, "default": default}
    figure = new_figure(7.0, 3.6)
    for axes, side in zip(figure.subplots(1, 2), SIDES, strict=True):
        values = [np.maximum(_risks(one, side), LEAST_DRAWN) for one in planners.values()]
        plain(axes, f"mean {side.replace('_', '-')} risk of an episode").set_yscale("log")
        box_plot(axes, values, ["HP", "DP"], [HYBRID, DEFAULT])
    data = [
        {"scenario": row["scenario"]}
        | {f"{side}_risk_{name}": _risks(one, side)[at] for side in SIDES for name, one in planners.items()}
        for at, row in enumerate(default.rows)
    ]
    text = (
        "Boxes reach from quartile to quartile, whiskers from the 5th to the 95th percentile, triangles are means. The "
        f"axis is logarithmic, and risks below {LEAST_DRAWN:g} are drawn there. Few episodes decide the means: so the "
        "table gives the medians, the means without episodes in which either planner collided, and 95 % bootstrap "
        "intervals of the ratio, too."
    )
    return Exhibit("risk", "Risk", text, figure, data, _risk_comparison(default, hybrid))


def _risks(driven: Driven, side: str) -> np.ndarray:
    return np.array([row[f"mean_{side}_risk"] or 0.0 for row in driven.rows])


def _risk_comparison(default: Driven, hybrid: Driven) -> list[Comparison]:
    told = compare({"default": default.rows, "hybrid": hybrid.rows})
    found = []
    for side in SIDES:
        name, paper = side.replace("_", "-"), _paper.RISK[side]
        mine = {planner: told[planner][f"{side}_risk"] for planner in ("default", "hybrid")}
        for planner, short in (("default", "DP"), ("hybrid", "HP")):
            found.append(
                Comparison(f"mean {name} risk, {short}", f"{mine[planner]['mean']:.3g}", f"{paper[planner]:g}")
            )
        ratio, interval = mine["hybrid"]["ratio"], mine["hybrid"]["ratio_interval"]
        share = "-" if ratio is None else f"{ratio:.0%}"
        span = "" if interval is None else f" ({interval[0]:.0%} to {interval[1]:.0%})"
        found.append(Comparison("HP's share of DP's", share + span, f"{paper['hybrid'] / paper['default']:.0%}"))
        medians = " / ".join(f"{mine[planner]['median']:.2g}" for planner in ("default", "hybrid"))
        found.append(Comparison("medians, DP / HP", medians))
        calm = [mine[planner]["mean_without_collided"] for planner in ("default", "hybrid")]
        if None not in calm:
            means = " / ".join(f"{one:.3g}" for one in calm)
            found.append(Comparison("means without collided episodes, DP / HP", means))
    return found


def driving(default: Driven, hybrid: Driven) -> Exhibit:
    """The table of driving characteristics over all steps."""
    planners = {"default": default, "hybrid": hybrid}
    data, compared = [], []
    for quantity, unit in UNITS.items():
        for (name, driven), short in zip(planners.items(), ("DP", "HP"), strict=True):
            values = statistics(driven.column(quantity))
            data.append({"quantity": quantity, "unit": unit, "planner": name} | values)
            ours, paper = (
                " / ".join(f"{one:.3f}" for one in numbers)
                for numbers in (values.values(), _paper.DRIVING[quantity, name])
            )
            what = f"{TITLES[quantity]} [{unit}], {short}: max / mean / median / σ"
            compared.append(Comparison(what, ours, paper))
    text = "Over all steps of all scenarios; the unweighted cost is the sum of the cost terms of the driven trajectory."
    return Exhibit("driving", "Driving characteristics", text, _drawn_table(data), data, compared)


def statistics(values: np.ndarray) -> dict[str, float]:
    """The paper's statistics of a quantity, without what is not a number."""
    known = values[np.isfinite(values)]
    numbers = np.max(known), np.mean(known), np.median(known), np.std(known)
    return dict(zip(_paper.STATISTICS, (float(f"{one:.6g}") for one in numbers), strict=True))


def _drawn_table(data: Sequence[Mapping[str, Any]]) -> Any:
    figure = new_figure(7.0, 2.2)
    axes = figure.subplots()
    axes.axis("off")
    cells = [[f"{row[one]:.3f}" for one in _paper.STATISTICS] for row in data]
    names = [
        f"{TITLES[row['quantity']]} [{row['unit']}], {'HP' if row['planner'] == 'hybrid' else 'DP'}" for row in data
    ]
    table = axes.table(
        cells, rowLabels=names, colLabels=["max", "mean", "median", "σ"], loc="center", edges="horizontal"
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    table.scale(0.6, 1.3)
    return figure


def run_time(rows: Sequence[Mapping[str, Any]]) -> Exhibit:
    """Box plots of what the parts of a step take."""
    figure = new_figure(7.0, 3.2)
    times = {part: np.array([row[part] for row in rows]) for part in PARTS}
    titles = {"policy": "policy", "bundle": "trajectory bundle", "step": "whole step"}
    for axes, (part, values) in zip(figure.subplots(1, len(PARTS)), times.items(), strict=True):
        plain(axes, titles[part], y="ms").set_yscale("log")
        box_plot(axes, [values], [""], [HYBRID])
    compared = [
        Comparison(f"{titles[part]}: mean (median, 95th percentile) [ms]", _times(values), f"{_paper.RUN_TIME[part]:g}")
        for part, values in times.items()
    ]
    text = (
        "One scenario at a time, on the machine named above. The bundle is a planning cycle with predictions at hand; "
        "the whole step predicts the traffic, asks the policy, plans, moves the vehicle and observes."
    )
    return Exhibit("run_time", "Run time", text, figure, rows, compared)


def _times(values: np.ndarray) -> str:
    return f"{np.mean(values):.3g} ({np.median(values):.3g}, {np.quantile(values, 0.95):.3g})"


def training(lines: Sequence[Mapping[str, Any]]) -> Exhibit:
    """The curves of the policy's training."""
    shown = [line for line in lines if line["kind"] in ("baseline", "validation")]
    steps = max(line["step"] for line in shown)
    names = dict.fromkeys(name for line in shown for name in line)
    data = [{name: line.get(name) for name in names} for line in shown]
    text = (
        "How validation went while the policy learned; the dashed line is the default planner. Validation draws the "
        "reward of the policy's own training, whose factors its config.json tells."
    )
    compared = [Comparison("environment steps of the run", f"{steps:,}", _paper.TRAINING)]
    return Exhibit("training", "Training", text, learning_curve(shown), data, compared)
