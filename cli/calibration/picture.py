"""The picture of a calibration: what each capture shows beyond the model, before and after."""

import numpy as np
from matplotlib.figure import Figure

from cli.figures import add_bar, new_figure, rgb_composite, show_plate, white_level
from warp_caustics.calibration.found import Calibration

PANEL_IN = 3.4
LEAST_SPAN = 1e-3
"""Of the colours [W/m^2]."""


def residual_figure(found: Calibration) -> Figure:
    """A row for each capture: the image, the residual with what was believed, the residual with what was found.

    Both residuals are of the middle wavelength, on one scale, that of three times what noise and misfit leave after.
    """
    scene = found.setup.nominal_scene
    middle = scene.n_wavelengths // 2
    figure = new_figure(3 * PANEL_IN + 1.6, len(found.fits) * PANEL_IN)
    panels = figure.subplots(len(found.fits), 3, squeeze=False)
    for row, fit in zip(panels, found.fits, strict=True):
        image = np.nan_to_num(np.asarray(fit.view.image, dtype=np.float64))
        colours = rgb_composite(image, scene.wavelengths_m, white_level(image))
        show_plate(row[0], scene, colours, f"{fit.view.name} ({fit.view.plate.kind})")
        span = max(5 * float(np.std(fit.after[middle])), LEAST_SPAN)
        for axes, values, title in ((row[1], fit.before, "image - believed"), (row[2], fit.after, "image - found")):
            drawn = show_plate(axes, scene, values[middle], title, cmap="RdBu_r", vmin=-span, vmax=span)
        add_bar(figure, drawn, row[2], "W/m^2", extend="both")
    return figure
