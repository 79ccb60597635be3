"""The picture of a design: wanted and simulated caustic, relief, difference; upright, as a picture is looked at."""

import numpy as np
from matplotlib.figure import Figure

from cli.figures import DISPLAY_GAMMA, add_bar, new_figure, show_plate, white_level
from warp_caustics.design.designer import Design


def design_figure(design: Design) -> Figure:
    """Four panels: target, caustic by independent light paths, relief, difference.

    As all pictures: row 0 at the top, so y grows downwards, the view onto the screen from below.
    """
    scene, target = design.scene, design.target
    radiosity = np.asarray(scene.radiosity_W_m2)
    light = radiosity > 0
    caustic = (design.image[light] / radiosity[light][:, None, None]).mean(axis=0)
    figure = new_figure(10.4, 9.4)
    panels = figure.subplots(2, 2)
    white = white_level(target)
    for axes, image, title in ((panels[0, 0], target, "target"), (panels[0, 1], caustic, "simulated caustic")):
        shown = np.clip(image / white, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)
        title = f"{title}, white = {white:.3g} of a flat plate"
        show_plate(axes, scene, shown, title, cmap="gray", vmin=0, vmax=1)
    heights = show_plate(panels[1, 0], scene, design.heights_m * 1e3, "relief", cmap="viridis")
    add_bar(figure, heights, panels[1, 0], "height [mm]")
    residual = caustic - target
    limit = white_level(np.abs(residual))
    scale = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    difference = show_plate(panels[1, 1], scene, residual, "caustic - target", **scale)
    add_bar(figure, difference, panels[1, 1], "of a flat plate", extend="both")
    figures = design.figures["picture"]
    ssim = "" if figures["ssim"] is None else f", SSIM {figures['ssim']:.3f}"
    figure.suptitle(
        f"screen at {-scene.screen_position_m[2]:.3g} m, relief {np.ptp(design.heights_m) * 1e3:.3g} mm, "
        f"{figures['psnr_dB']:.1f} dB{ssim}"
    )
    return figure
