"""The picture of a result: measured and re-simulated caustic, recovered heights, what is left."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from warp_caustics.io.atomic import PathLike, atomic_path
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

BRIGHTEST_PERCENT = 99.5
"""Irradiance at this percentile of the measured image is white: caustic lines would otherwise leave the rest black."""
DISPLAY_GAMMA = 2.2


def rgb_composite(image: FloatArray, wavelengths_m: tuple[float, ...], white: float) -> FloatArray:
    """Longest, middle and shortest wavelength as red, green and blue; one wavelength is grey.

    Args:
        image: irradiance [W/m^2], shape [n_w, m, m].
        wavelengths_m: wavelength of each channel [m], shape [n_w].
        white: irradiance shown at full brightness [W/m^2].

    Returns:
        Display values between 0 and 1, shape [m, m, 3].
    """
    falling = np.argsort(wavelengths_m)[::-1]
    channels = falling[[0, len(falling) // 2, -1]]
    shown: FloatArray = np.clip(np.moveaxis(image[channels], 0, -1) / white, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)
    return shown


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
    figure = Figure(figsize=(11.0, 10.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2)
    white = float(np.percentile(measured, BRIGHTEST_PERCENT)) or 1.0
    for axes, image, title in ((panels[0, 0], measured, "input image"), (panels[0, 1], simulated, "re-simulated")):
        _show(axes, scene, rgb_composite(image, scene.wavelengths_m, white), f"{title}, white = {white:.3g} W/m$^2$")

    heights = _show(panels[1, 0], scene, heights_m * 1e6, "height", cmap="viridis")
    figure.colorbar(heights, ax=panels[1, 0], label="height [um]", shrink=0.82)

    residual = (simulated.astype(np.float64) - measured).mean(axis=0)
    limit = float(np.percentile(np.abs(residual), BRIGHTEST_PERCENT)) or 1.0
    title = "re-simulated - input, mean of wavelengths"
    difference = _show(panels[1, 1], scene, residual, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    figure.colorbar(difference, ax=panels[1, 1], label="W/m$^2$", extend="both", shrink=0.82)
    figure.suptitle(caption)
    return figure


def uncertainty_figure(scene: Scene, uncertainty_m: FloatArray) -> Figure:
    """One panel: standard uncertainty of the heights [m], shape [n, n], on a logarithmic scale."""
    figure = Figure(figsize=(6.4, 5.4), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    shown = uncertainty_m * 1e6
    high = max(float(shown.max()), 1e-2)
    norm = LogNorm(vmin=high * 1e-3, vmax=high, clip=True)
    picture = _show(axes, scene, shown, "standard uncertainty of the heights", cmap="magma", norm=norm)
    figure.colorbar(picture, ax=axes, label="um", extend="min")
    return figure


def write_overview(path: PathLike, figure: Figure) -> None:
    """Write a figure as an image (.png, .pdf, .svg), complete or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary)


def _show(axes: Axes, scene: Scene, values: FloatArray, title: str, **options: Any) -> Any:
    width, length = (size * 1e3 for size in scene.plate_size_m)
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    extent = (-width / 2, width / 2, -length / 2, length / 2)
    # Row grows with +y.
    return axes.imshow(values, origin="lower", extent=extent, **options)
