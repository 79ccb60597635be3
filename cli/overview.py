"""The picture of a result: measured and re-simulated caustic, recovered heights, what is left."""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from cli.figures import add_bar, new_figure, rgb_composite, show_plate, white_level
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray


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
    figure = new_figure(11.0, 10.0)
    panels = figure.subplots(2, 2)
    white = white_level(measured)
    for axes, image, title in ((panels[0, 0], measured, "input image"), (panels[0, 1], simulated, "re-simulated")):
        shown = rgb_composite(image, scene.wavelengths_m, white)
        show_plate(axes, scene, shown, f"{title}, white = {white:.3g} W/m$^2$")

    heights = show_plate(panels[1, 0], scene, heights_m * 1e6, "height", cmap="viridis")
    add_bar(figure, heights, panels[1, 0], "height [um]")

    residual = (simulated.astype(np.float64) - measured).mean(axis=0)
    limit = white_level(np.abs(residual))
    title = "re-simulated - input, mean of wavelengths"
    difference = show_plate(panels[1, 1], scene, residual, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    add_bar(figure, difference, panels[1, 1], "W/m$^2$", extend="both")
    figure.suptitle(caption)
    return figure


def uncertainty_figure(scene: Scene, uncertainty_m: FloatArray) -> Figure:
    """One panel: standard uncertainty of the heights [m], shape [n, n], on a logarithmic scale."""
    figure = new_figure(6.4, 5.4)
    axes = figure.subplots()
    shown = uncertainty_m * 1e6
    high = max(float(shown.max()), 1e-2)
    norm = LogNorm(vmin=high * 1e-3, vmax=high, clip=True)
    picture = show_plate(axes, scene, shown, "standard uncertainty of the heights", cmap="magma", norm=norm)
    figure.colorbar(picture, ax=axes, label="um", extend="min")
    return figure
