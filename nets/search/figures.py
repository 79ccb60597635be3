"""Pictures of a search's report.

Optuna has such figures too (``optuna.visualization.matplotlib``). They leave out
pruned trials, half of all here, do not tell complete from pruned ones in the
learning curves, name each of hundreds of curves in a legend, and change
matplotlib's style for the whole program. Its importances are used, its bars not.
"""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

COLOURS = {TrialState.COMPLETE: "#1f77b4", TrialState.PRUNED: "#c9c9c9"}
MAP = "viridis"
"""Dark is low, so good."""

DIVERGED = 100.0
"""Losses so many times the best are all drawn alike."""


def history(trials: Sequence[FrozenTrial]) -> bytes | None:
    """Loss of each trial in the order of their numbers, and the best so far (PNG); None without trials."""
    judged = [trial for trial in trials if _loss(trial) is not None]
    if not judged:
        return None
    figure, axes = _figure(9.0, 3.4)
    for state, name in ((TrialState.COMPLETE, "complete"), (TrialState.PRUNED, "pruned")):
        some = [trial for trial in judged if trial.state == state]
        axes.plot([t.number for t in some], [_loss(t) for t in some], "o", ms=5, color=COLOURS[state], label=name)
    numbers, best, lowest = [], [], math.inf
    for trial in judged:
        if trial.state == TrialState.COMPLETE:
            lowest = min(lowest, _loss(trial) or math.inf)
        numbers.append(trial.number)
        best.append(lowest)
    axes.step(numbers, best, where="post", color="#d62728", label="best so far")
    axes.set(xlabel="trial", ylabel="best validation loss", yscale="log", title="History")
    axes.legend()
    return _png(figure)


def curves(trials: Sequence[FrozenTrial]) -> bytes | None:
    """Best loss so far over epochs, one line per trial (PNG); None where no trial had an epoch."""
    told = [trial for trial in trials if trial.intermediate_values]
    if not told:
        return None
    figure, axes = _figure(9.0, 3.4)
    for trial in told:
        epochs, losses = zip(*sorted(trial.intermediate_values.items()), strict=True)
        colour = COLOURS.get(trial.state, "#f2b134")
        axes.plot(epochs, losses, "-", lw=1.2, marker=".", ms=3, color=colour, zorder=2 if trial.value else 1)
    axes.set(xlabel="epoch", ylabel="best validation loss", yscale="log", title="Trials by epoch (grey: pruned)")
    return _png(figure)


def slices(trials: Sequence[FrozenTrial], space: Mapping[str, BaseDistribution]) -> bytes | None:
    """Loss over each number of Tab. 2 (PNG), capped at DIVERGED times the best; None without trials."""
    judged = [trial for trial in trials if _loss(trial) is not None]
    if not judged:
        return None
    # A trial that diverged would squeeze all others into a line: it is drawn at the top edge.
    most = DIVERGED * min(_loss(trial) or math.inf for trial in judged)
    columns = 4
    rows = -(-len(space) // columns)
    figure, grid = _figure(12.0, 2.6 * rows, rows, columns)
    for axes, (name, found) in zip(grid.flat, space.items(), strict=False):
        values = [_place(found, trial.params[name]) for trial in judged]
        pruned = [trial.state == TrialState.PRUNED for trial in judged]
        colours = [COLOURS[TrialState.PRUNED] if is_pruned else COLOURS[TrialState.COMPLETE] for is_pruned in pruned]
        axes.scatter(values, [min(_loss(trial) or 0.0, most) for trial in judged], c=colours, s=18)
        axes.set(xlabel=name, yscale="log")
        _ticks(axes.xaxis, found)
        if getattr(found, "log", False):
            axes.set_xscale("log")
        if not isinstance(found, CategoricalDistribution):
            axes.set_xlim(_limits(found))
    for axes in list(grid.flat)[len(space) :]:
        axes.axis("off")
    for axes in grid[:, 0]:
        axes.set_ylabel("loss")
    return _png(figure)


def parallel(trials: Sequence[FrozenTrial], space: Mapping[str, BaseDistribution]) -> bytes | None:
    """One line per finished trial through all its numbers, dark where it was good (PNG); None without trials."""
    import matplotlib
    from matplotlib.colors import LogNorm, Normalize

    done = sorted((t for t in trials if t.state == TrialState.COMPLETE), key=lambda t: -t.value)  # type: ignore[operator]
    if not done:
        return None
    figure, axes = _figure(12.0, 3.6)
    losses = [float(trial.value or 0.0) for trial in done]
    is_log = min(losses) > 0 and max(losses) > min(losses)
    norm: Any = LogNorm(min(losses), max(losses)) if is_log else Normalize(min(losses) - 1e-12, max(losses) + 1e-12)
    colours = matplotlib.colormaps[MAP]
    for trial, loss in zip(done, losses, strict=True):
        heights = [_share(found, trial.params[name]) for name, found in space.items()]
        axes.plot(range(len(heights)), heights, color=colours(norm(loss)), lw=1.5, alpha=0.8)
    axes.set_xticks(range(len(space)), [f"{name}\n{_ends(found)}" for name, found in space.items()], fontsize=8)
    axes.set(yticks=[], ylabel="lowest to highest", title="Complete trials")
    figure.colorbar(matplotlib.cm.ScalarMappable(norm, MAP), ax=axes, label="loss")
    return _png(figure)


def importances(study: optuna.Study) -> tuple[dict[str, float], bytes | None]:
    """How much each number decides (PED-ANOVA, which needs no further package), and a picture (PNG).

    Empty and None where the trials are too few or too equal to tell.
    """
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len({trial.value for trial in done}) < 4:
        return {}, None
    found = optuna.importance.get_param_importances(study, evaluator=optuna.importance.PedAnovaImportanceEvaluator())
    if not found or not all(math.isfinite(value) for value in found.values()):
        return {}, None
    figure, axes = _figure(9.0, 0.8 + 0.3 * len(found))
    names = list(found)[::-1]
    axes.barh(names, [found[name] for name in names], color=COLOURS[TrialState.COMPLETE])
    axes.set(xlabel="share of the variation among good trials", title="Importance (PED-ANOVA)")
    return found, _png(figure)


def _loss(trial: FrozenTrial) -> float | None:
    """Value of a complete trial, last value of a pruned one, if it can stand on a logarithmic axis."""
    if trial.state not in COLOURS or trial.value is None or not trial.value > 0:
        return None
    return trial.value


def _place(found: BaseDistribution, value: Any) -> float:
    """Where a value stands on its axis: its number, or the number of the choice."""
    return float(found.choices.index(value)) if isinstance(found, CategoricalDistribution) else float(value)


def _share(found: BaseDistribution, value: Any) -> float:
    """Where a value lies in its range, 0 to 1."""
    if isinstance(found, CategoricalDistribution):
        return found.choices.index(value) / max(1, len(found.choices) - 1)
    (low, high), at = _limits(found), float(value)
    if getattr(found, "log", False):
        return math.log(at / low) / math.log(high / low)
    return (at - low) / (high - low)


def _ends(found: BaseDistribution) -> str:
    if isinstance(found, CategoricalDistribution):
        return f"{found.choices[0]} ... {found.choices[-1]}"
    low, high = _limits(found)
    return f"{low:g} ... {high:g}"


def _limits(found: BaseDistribution) -> tuple[float, float]:
    assert isinstance(found, FloatDistribution | IntDistribution)
    return float(found.low), float(found.high)


def _ticks(axis: Any, found: BaseDistribution) -> None:
    if isinstance(found, CategoricalDistribution):
        axis.set_ticks(range(len(found.choices)), [str(choice) for choice in found.choices])


def _figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=rows * columns == 1)


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
