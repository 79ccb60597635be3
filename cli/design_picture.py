"""The picture of a design: wanted and simulated caustic, relief, difference; upright, as a picture is looked at."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from warp_caustics.design.designer import Design
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

WHITE_PERCENT = 99.5
"""Irradiance at this percentile of the target is white."""
DISPLAY_GAMMA = 2.2


def design_figure(design: Design) -> Figure:
    """Four panels: target, caustic by independent light paths, relief, difference.

    Row 0 is at the top, so y grows downwards: the view onto the screen from below.
    """
    scene, target = design.scene, design.target
    radiosity = np.asarray(scene.radiosity_W_m2)
    light = radiosity > 0
    caustic = (design.image[light] / radiosity[light][:, None, None]).mean(axis=0)
    figure = Figure(figsize=(10.4, 9.4), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2)
    white = float(np.percentile(target, WHITE_PERCENT))
    for axes, image, title in ((panels[0, 0], target, "target"), (panels[0, 1], caustic, "simulated caustic")):
        shown = np.clip(image / white, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)
        _show(axes, scene, shown, f"{title}, white = {white:.3g} of a flat plate", cmap="gray", vmin=0, vmax=1)
    heights = _show(panels[1, 0], scene, design.heights_m * 1e3, "relief", cmap="viridis")
    figure.colorbar(heights, ax=panels[1, 0], label="height [mm]", shrink=0.82)
    residual = caustic - target
    limit = float(np.percentile(np.abs(residual), WHITE_PERCENT)) or 1.0
    title = "caustic - target"
    difference = _show(panels[1, 1], scene, residual, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    figure.colorbar(difference, ax=panels[1, 1], label="of a flat plate", extend="both", shrink=0.82)
    figures = design.figures["picture"]
    ssim = "" if figures["ssim"] is None else f", SSIM {figures['ssim']:.3f}"
    figure.suptitle(
        f"screen at {-scene.screen_position_m[2]:.3g} m, relief {np.ptp(design.heights_m) * 1e3:.3g} mm, "
        f"{figures['psnr_dB']:.1f} dB{ssim}"
    )
    return figure


def _show(axes: Axes, scene: Scene, values: FloatArray, title: str, **options: Any) -> Any:
    width, length = (size * 1e3 for size in scene.plate_size_m)
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    # Row 0, the lowest y, on top.
    return axes.imshow(values, origin="upper", extent=(-width / 2, width / 2, length / 2, -length / 2), **options)
