"""A picture of the steps from photo to irradiance."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.figures import new_figure, rgb_composite, white_level
from warp_caustics.capture.stage import CaptureStage

PANEL_INCHES = 3.6
TEXT_WIDTH = 58
MAX_CIRCLES = 400


def stages_figure(stages: Sequence[CaptureStage], wavelengths_m: tuple[float, ...]) -> Figure:
    """One row for each step with pictures: before, after, and what was done with its numbers.

    Args:
        stages: steps in their order; those without pictures are left out.
        wavelengths_m: of the final channels [m]; earlier ones are shown in this order too.
    """
    shown = [stage for stage in stages if stage.before is not None or stage.after is not None]
    rows = max(len(shown), 1)
    figure = new_figure(3.1 * PANEL_INCHES, rows * PANEL_INCHES, dpi=90)
    panels = figure.subplots(rows, 3, squeeze=False)
    for number, (stage, row) in enumerate(zip(shown, panels, strict=False), 1):
        _show(row[0], stage.before, wavelengths_m, "before")
        _show(row[1], stage.after, wavelengths_m, "after")
        if stage.marks_px is not None and len(stage.marks_px) and stage.before is not None:
            _mark(row[0], stage.marks_px, closed=stage.name in ("location", "window"))
        _describe(row[2], number, stage)
    for row in panels[len(shown) :]:
        for axes in row:
            axes.axis("off")
    return figure


def _show(
    axes: Axes, image: npt.NDArray[np.floating[Any]] | None, wavelengths_m: tuple[float, ...], title: str
) -> None:
    if image is None:
        axes.axis("off")
        return
    white = white_level(image)
    # Row 0 on top, as a photo viewer shows it and every other picture of the window.
    axes.imshow(rgb_composite(image, wavelengths_m, white), origin="upper", interpolation="antialiased")
    _, height, width = image.shape
    axes.set_title(f"{title}, {width} x {height} px, white = {white:.4g}", fontsize=8)
    axes.tick_params(labelsize=7)


def _mark(axes: Axes, marks_px: npt.NDArray[np.float64], closed: bool) -> None:
    if closed:
        ring = np.concatenate([marks_px, marks_px[:1]])
        axes.plot(*ring.T, color="#ffb000", linewidth=1.0)
        axes.plot(*marks_px[0], "o", color="#ffb000", markersize=5)
        axes.annotate("-x-y", marks_px[0], color="#ffb000", fontsize=8, xytext=(4, 4), textcoords="offset points")
        return
    every = max(1, len(marks_px) // MAX_CIRCLES)
    axes.plot(*marks_px[::every].T, "o", markerfacecolor="none", markeredgecolor="#ff4060", markersize=5, linewidth=0)


def _describe(axes: Axes, number: int, stage: CaptureStage) -> None:
    import textwrap

    axes.axis("off")
    lines = textwrap.wrap(stage.text, TEXT_WIDTH)
    figures = [f"{name} = {value:.5g}" for name, value in stage.figures.items()]
    axes.text(0.0, 0.97, f"{number}. {stage.name}", va="top", fontsize=11, weight="bold", transform=axes.transAxes)
    axes.text(0.0, 0.86, "\n".join([*lines, "", *figures]), va="top", fontsize=7.5, transform=axes.transAxes)
