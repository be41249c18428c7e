"""Pictures of a sweep: how important each setting is, and which settings led to which scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import optuna
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.trial import FrozenTrial, TrialState

from experiments._exhibits import new_figure
from experiments._search_study import quiet
from scenarios.files import written_whole

BAR, PRUNED = "#2f6db3", "#b5b5b5"
COLORS = "viridis"


def find_importances(study: optuna.Study) -> dict[str, float]:
    """Share of each setting in what makes good trials good (PED-ANOVA), the largest first; empty if nothing tells."""
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    varied = [name for name in _names(complete) if len({trial.params.get(name) for trial in complete}) > 1]
    if not varied or len({trial.value for trial in complete}) < 2:
        return {}
    with quiet():
        return optuna.importance.get_param_importances(study, evaluator=PedAnovaImportanceEvaluator(), params=varied)


def _names(trials: Sequence[FrozenTrial]) -> list[str]:
    return list(dict.fromkeys(name for trial in trials for name in trial.params))


def draw_importance(path: Path, importances: Mapping[str, float]) -> None:
    """Draw a bar for each setting.

    Args:
      path: of the picture.
      importances: shares by name, the largest first.
    """
    figure = _figure(7.0, 0.8 + 0.32 * len(importances))
    axes = figure.subplots()
    names, shares = list(importances), list(importances.values())
    bars = axes.barh(names, shares, color=BAR)
    axes.bar_label(bars, [f"{share:.0%}" for share in shares], padding=3)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.12 * max(shares))
    axes.set_xlabel("share in what makes good trials good")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, 0))
    axes.spines[["top", "right"]].set_visible(False)
    _save(figure, path)


def draw_parallel(path: Path, trials: Sequence[FrozenTrial]) -> None:
    """Draw a line for each trial through its settings, coloured by the place of its score; pruned ones are grey.

    Scores themselves would leave one colour for all but a trial that went very wrong.

    Args:
      path: of the picture.
      trials: that have ended.
    """
    names = _names(trials)
    figure = _figure(max(6.0, 1.5 * (len(names) + 1)), 4.0)
    axes = figure.subplots()
    complete = sorted((trial for trial in trials if trial.state == TrialState.COMPLETE), key=_score)
    colors = ScalarMappable(Normalize(0, max(len(complete) - 1, 1)), COLORS)
    for trial in trials:
        if trial.state != TrialState.COMPLETE:
            _line(axes, names, trial, PRUNED, 0.8)
    for place, trial in enumerate(complete):
        _line(axes, names, trial, colors.to_rgba(np.asarray(place)), 1.6)
    for place, name in enumerate(names):
        _axis(axes, place, next(trial.distributions[name] for trial in trials if name in trial.distributions))
    axes.set_xticks(range(len(names)), [name.replace(".", "\n", 1) for name in names])
    axes.set_ylim(-0.04, 1.04)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_title("settings of trials, pruned ones grey", loc="left")
    if complete:
        ticks = sorted({0, (len(complete) - 1) // 2, len(complete) - 1})
        bar = figure.colorbar(colors, ax=axes, label="score, coloured by its place among all", ticks=ticks)
        bar.set_ticklabels([f"{_score(complete[place]):.1f}" for place in ticks])
    _save(figure, path)


def _score(trial: FrozenTrial) -> float:
    assert trial.value is not None
    return trial.value


def _line(axes: Axes, names: Sequence[str], trial: FrozenTrial, color: Any, width: float) -> None:
    places = [place for place, name in enumerate(names) if name in trial.params]
    heights = [_height(trial.distributions[names[place]], trial.params[names[place]]) for place in places]
    axes.plot(places, heights, color=color, lw=width, alpha=0.9)


def _height(distribution: BaseDistribution, value: Any) -> float:
    """Where a value is between the lowest, 0, and the highest, 1; choices are evenly spaced."""
    if isinstance(distribution, FloatDistribution):
        scale = np.log if distribution.log else float
        low, high = scale(distribution.low), scale(distribution.high)
        return float((scale(value) - low) / (high - low))
    choices = _choices(distribution)
    return choices.index(value) / max(len(choices) - 1, 1)


def _choices(distribution: BaseDistribution) -> list[Any]:
    assert isinstance(distribution, optuna.distributions.CategoricalDistribution)
    return list(distribution.choices)


def _axis(axes: Axes, place: int, distribution: BaseDistribution) -> None:
    """Draw the axis of a setting with its ends, or its choices."""
    axes.axvline(place, color="0.3", lw=0.8, zorder=0)
    is_range = isinstance(distribution, FloatDistribution)
    marks = [distribution.low, distribution.high] if is_range else _choices(distribution)
    for value in marks:
        text = f"{value:g}" if isinstance(value, int | float) else str(value)
        axes.annotate(
            text, (place, _height(distribution, value)), (4, 0), textcoords="offset points", va="center", fontsize=8
        )


def _figure(width: float, height: float) -> Figure:
    matplotlib.rcParams.update({"font.size": 9})
    return new_figure(width, height)


def _save(figure: Figure, path: Path) -> None:
    with written_whole(path) as file:
        figure.savefig(file, format="png")
