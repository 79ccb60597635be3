"""Errors against iterations, and against how much of a field is folded."""

import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from cli.comparison.figures import DPI, png
from cli.figures import new_figure
from nets.evaluation.method_spec import CONVERGED, ONCE
from nets.evaluation.table import Row

# Okabe and Ito's colours, told apart by nearly everyone; markers tell the rest.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31")
_MARKERS = "osD^vPX*<>hp"

PANELS = (("rmse_um", "relief RMSE [um]"), ("image_error", "image error, relative"))


def iteration_curves(rows: Sequence[Row], budgets: Sequence[str]) -> bytes:
    """PNG of medians over the fields against iterations; methods that do not iterate are level lines."""
    figure, panels = _figure(len(PANELS))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    for axes, (measure, label) in zip(panels, PANELS, strict=True):
        for index, method in enumerate(methods):
            style = _style(index) | {"label": method}
            mine = [row for row in rows if row["method"] == method and row[measure] is not None]
            medians = {
                budget: statistics.median(values)
                for budget in (*budgets, ONCE)
                if (values := [row[measure] for row in mine if row["budget"] == budget])
            }
            if ONCE in medians:
                axes.plot([0, len(budgets) - 1], [medians[ONCE]] * 2, linestyle="--", **(style | {"marker": ""}))
            elif medians:
                places = [budgets.index(budget) for budget in medians]
                axes.plot(places, list(medians.values()), **style)
        axes.set_xticks(range(len(budgets)), ["at its\nown stop" if b == CONVERGED else b for b in budgets])
        axes.set(xlabel="iterations", ylabel=f"{label}, median of fields")
        _finish(axes)
    _legend(figure, panels)
    return png(figure)


def fold_scatter(rows: Sequence[Row], budgets: Sequence[str]) -> bytes:
    """PNG of errors at each method's last column against the fold fraction of the field."""
    figure, panels = _figure(len(PANELS))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    for axes, (measure, label) in zip(panels, PANELS, strict=True):
        for index, method in enumerate(methods):
            mine = [row for row in rows if row["method"] == method and row["budget"] in (budgets[-1], ONCE)]
            points = sorted((100 * row["fold_fraction"], row[measure]) for row in mine if row[measure] is not None)
            if points:
                style = _style(index) | {"label": method, "linestyle": "", "alpha": 0.85}
                axes.plot(*zip(*points, strict=True), **style)
        axes.set(xlabel="share of the plate that is folded [%]", ylabel=label)
        most = 100 * max((row["fold_fraction"] for row in rows), default=0.0)
        axes.set_xlim(-0.04 * max(most, 1.0), 1.04 * max(most, 1.0))
        _finish(axes)
    _legend(figure, panels)
    return png(figure)


def _figure(count: int) -> tuple[Figure, Any]:
    figure = new_figure(5.2 * count, 4.4, dpi=DPI)
    return figure, figure.subplots(1, count, squeeze=False)[0]


def _style(index: int) -> dict[str, Any]:
    colour = _COLOURS[index % len(_COLOURS)]
    return {"color": colour, "marker": _MARKERS[index % len(_MARKERS)], "markersize": 5, "linewidth": 1.5}


def _finish(axes: Axes) -> None:
    """Grid; a logarithmic axis with plain numbers where values differ enough, and none of them is exactly 0."""
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines] or [np.ones(1)])
    low, high = float(values.min()), float(values.max())
    if low > 0 and high > 1.5 * low:
        axes.set_yscale("log")
        labelled = "123456789" if high < 8 * low else "25"
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: _label(value, labelled)))
        axes.tick_params(axis="y", which="minor", labelsize=8)
    axes.grid(True, which="both", alpha=0.25)


def _label(value: float, digits: str) -> str:
    """A number, if its first digit is one of those that are labelled."""
    return f"{value:g}" if f"{value:e}"[0] in digits else ""


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), fontsize=8, frameon=False)
