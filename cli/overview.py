"""The picture of a result: measured and re-simulated caustic, recovered heights, what is left."""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from cli.figures import new_figure, rgb_composite, show_plate, white_level
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

FOUR_PANELS = {"left": 0.058, "right": 0.885, "top": 0.927, "bottom": 0.067, "wspace": 0.486, "hspace": 0.306}
ONE_PANEL = {"left": 0.095, "right": 0.82, "top": 0.95, "bottom": 0.09}
"""Parts of the figure that panels take, and gaps between them in panels; bars stand to their right. What is given by
hand need not be sought: a constrained layout draws each figure twice, 0.4 s of CPU time for these two."""
BAR = (1.05, 0.01, 0.048, 0.98)
"""Left, bottom, width and height of a colour bar, in units of its panel."""


def overview_figure(
    *, scene: Scene, measured: FloatArray, simulated: FloatArray, heights_m: FloatArray, caption: str = ""
) -> Figure:
    """Four panels: input image, re-simulated image, heights, difference of the images.

    Args:
        scene: gives plate size and wavelengths.
        measured: calibrated input [W/m^2], shape [n_w, m, m].
        simulated: caustic of the heights [W/m^2], shape [n_w, m, m].
        heights_m: relief [m], shape [n, n].
        caption: line at the top.
    """
    figure = new_figure(11.0, 10.0, layout="none")
    panels = figure.subplots(2, 2, gridspec_kw=FOUR_PANELS)
    white = white_level(measured)
    for axes, image, title in ((panels[0, 0], measured, "input image"), (panels[0, 1], simulated, "re-simulated")):
        shown = rgb_composite(image, scene.wavelengths_m, white)
        show_plate(axes, scene, shown, f"{title}, white = {white:.3g} W/m$^2$")

    heights = show_plate(panels[1, 0], scene, heights_m * 1e6, "height", cmap="viridis")
    figure.colorbar(heights, cax=panels[1, 0].inset_axes(BAR), label="height [um]")

    residual = (simulated.astype(np.float64) - measured).mean(axis=0)
    limit = white_level(np.abs(residual))
    title = "re-simulated - input, mean of wavelengths"
    difference = show_plate(panels[1, 1], scene, residual, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    figure.colorbar(difference, cax=panels[1, 1].inset_axes(BAR), label="W/m$^2$", extend="both")
    figure.suptitle(caption, y=0.99)
    return figure


def uncertainty_figure(scene: Scene, uncertainty_m: FloatArray) -> Figure:
    """One panel: standard uncertainty of the heights [m], shape [n, n], on a logarithmic scale."""
    figure = new_figure(6.4, 5.4, layout="none")
    axes = figure.subplots(gridspec_kw=ONE_PANEL)
    shown = uncertainty_m * 1e6
    high = max(float(shown.max()), 1e-2)
    # From the least on, so that lines stand out of what the bench leaves uncertain everywhere; a decade at least.
    low = max(min(float(shown.min()), high / 10), high * 1e-3)
    norm = LogNorm(vmin=low, vmax=high, clip=True)
    picture = show_plate(axes, scene, shown, "standard uncertainty of the heights", cmap="magma", norm=norm)
    bar, extend = axes.inset_axes(BAR), "min" if shown.min() < low else "neither"
    scale = figure.colorbar(picture, cax=bar, label="um", extend=extend, ticks=LogLocator(subs=(1, 2, 5)), format="%g")
    scale.minorticks_off()
    return figure
