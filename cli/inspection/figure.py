"""The picture of an inspection: nominal, measured, deviation with its regions."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cli.figures import new_figure, plate_extent_mm, show_plate
from warp_caustics.inspection.findings import Inspection
from warp_caustics.scene import Scene

MAX_NUMBERED = 20
"""Regions with a number in the picture."""
SPAN = 3.0
"""The colours of the deviation reach to this multiple of the tolerance."""
VERDICT_COLOURS = {"pass": "#1a7f37", "fail": "#b42318", "uncertain": "#9a6700"}
_REGION, _UNDECIDED, _UNJUDGED = "#111111", "#7a4fbf", "#bbbbbb"


def inspection_figure(found: Inspection, scene: Scene, title: str) -> Figure:
    """Three panels: nominal and measured relief on one scale, deviation with the regions outlined and numbered.

    Args:
        found: the inspection.
        scene: gives the plate's size.
        title: of the plate.
    """
    figure = new_figure(15.0, 4.9)
    panels = figure.subplots(1, 3)
    measured = found.nominal_m + found.deviation_m
    low = min(float(found.nominal_m.min()), float(measured.min())) * 1e6
    high = max(float(found.nominal_m.max()), float(measured.max())) * 1e6
    for axes, relief, name in ((panels[0], found.nominal_m, "nominal"), (panels[1], measured, "measured")):
        drawn = show_plate(axes, scene, relief * 1e6, name, cmap="viridis", vmin=low, vmax=high)
    figure.colorbar(drawn, ax=panels[1], label="height [um]", shrink=0.8)

    tolerance_um = found.tolerance_m * 1e6
    limit = SPAN * tolerance_um
    deviation = show_plate(
        panels[2], scene, found.deviation_m * 1e6, "measured - nominal", cmap="RdBu_r", vmin=-limit, vmax=limit
    )
    bar = figure.colorbar(deviation, ax=panels[2], label="deviation [um]", extend="both", shrink=0.8)
    bar.set_ticks([-limit, -tolerance_um, 0.0, tolerance_um, limit])
    for sign in (-1, 1):
        bar.ax.axhline(sign * tolerance_um, color="black", linewidth=1.5)
    _mark(panels[2], scene, found)
    reason = found.reasons[0] if len(found.reasons) == 1 else f"{found.reasons[0]}; and {len(found.reasons) - 1} more"
    figure.suptitle(
        f"{title}: {found.verdict.upper()} at {tolerance_um:g} um\n{reason}",
        color=VERDICT_COLOURS[found.verdict],
        fontsize=11,
    )
    return figure


def _mark(axes: Axes, scene: Scene, found: Inspection) -> None:
    handles = []
    for cells, colour, name in (
        (found.out_of_tolerance, _REGION, "out of tolerance"),
        (found.undecided, _UNDECIDED, "too uncertain to tell"),
        (~found.mask, _UNJUDGED, "not judged"),
    ):
        if cells is None or not cells.any():
            continue
        extent = plate_extent_mm(scene)
        axes.contour(cells.astype(float), [0.5], colors=colour, linewidths=1.2, extent=extent, origin="upper")
        handles.append(Line2D([], [], color=colour, label=name))
    for region in found.regions[:MAX_NUMBERED]:
        axes.annotate(
            str(region.number),
            (region.centre_m[0] * 1e3, region.centre_m[1] * 1e3),
            # Too much and too little glass lie side by side where a fibre is displaced.
            xytext=(9, 9) if region.peak_m > 0 else (-9, -9),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    if handles:
        axes.legend(handles=handles, loc="lower left", fontsize=8)
