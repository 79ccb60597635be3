"""How a process drifts: peak deviation, RMS and volume of plate after plate."""

import datetime
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cli.inspection.figure import VERDICT_COLOURS

MAX_NAMED = 30
"""Plates up to which each is named."""


def trend_figure(rows: Sequence[Mapping[str, Any]], tolerance_m: float) -> Figure:
    """Three panels over the plates in the order of their images' time.

    Args:
        rows: of plates.csv; those without a verdict are left out.
        tolerance_m: drawn as a line [m].
    """
    done = sorted((row for row in rows if row["status"] == "done"), key=lambda row: row["modified"])
    figure = Figure(figsize=(9.0, 8.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, 1, sharex=True)
    number = range(1, len(done) + 1)
    colours = [VERDICT_COLOURS.get(str(row["verdict"]), "black") for row in done]
    tolerance_um = tolerance_m * 1e6
    # Upright, a flank may be off by more than the tolerance and yet be within its zone.
    worst = "largest deviation [um],\nalong the normal"
    for axes, column, unit, label, limit in (
        (panels[0], "worst_of_limit", tolerance_um, worst, tolerance_um),
        (panels[1], "rms_deviation_um", 1.0, "RMS deviation [um]", tolerance_um),
        (panels[2], "volume_mm3", 1.0, "volume [mm$^3$]", None),
    ):
        values = [float(row[column]) * unit for row in done]
        axes.plot(number, values, color="#888888", linewidth=0.8, zorder=1)
        axes.scatter(number, values, c=colours, zorder=2)
        if limit is not None:
            axes.axhline(limit, color="#b42318", linestyle="--", linewidth=1.0, label=f"tolerance {tolerance_um:g} um")
            axes.legend(loc="upper left", fontsize=8)
            axes.set_ylim(bottom=0)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    nominal = {float(row["nominal_volume_mm3"]) for row in done}
    for value in nominal:
        panels[2].axhline(value, color="#444444", linestyle=":", linewidth=1.0, label=f"nominal {value:.4g} mm$^3$")
    if nominal:
        panels[2].legend(loc="upper left", fontsize=8)
    panels[2].set_xlabel("plate, in the order of the images' time")
    panels[2].xaxis.get_major_locator().set_params(integer=True)
    if 0 < len(done) <= MAX_NAMED:
        panels[2].set_xticks(list(number), [str(row["image"]) for row in done], rotation=60, ha="right", fontsize=7)
    counts = {verdict: sum(row["verdict"] == verdict for row in done) for verdict in VERDICT_COLOURS}
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count)
    figure.suptitle(f"{len(done)} plates: {told or 'none yet'} ({datetime.date.today():%Y-%m-%d})", fontsize=11)
    return figure
