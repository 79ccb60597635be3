"""A quick look at a result, for notebooks: heights, their caustic and, where there is one, the uncertainty."""

from typing import TYPE_CHECKING

import numpy as np

from warp_caustics.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WHITE_PERCENT = 99.5
"""Light at this percentile is white: caustic lines would otherwise leave the rest black."""

GAMMA = 2.2


def result_figure(
    heights_m: FloatArray,
    image: FloatArray,
    uncertainty_m: FloatArray | None = None,
    plate_size_m: tuple[float, float] | None = None,
    title: str = "",
) -> "Figure":
    """Panels side by side; row 0 is at the top, as a photo viewer shows it.

    Args:
        heights_m: relief [m], shape [n, n].
        image: its caustic [W/m^2], shape [n_w, m, m]; shown is the mean over wavelengths.
        uncertainty_m: [m], shape [n, n]; None leaves its panel out.
        plate_size_m: extent along x and y [m], for axes in millimetres; None for axes in samples.
        title: above all.
    """
    from matplotlib.figure import Figure

    panels = 2 if uncertainty_m is None else 3
    figure = Figure(figsize=(4.2 * panels, 4.0), layout="constrained")
    axes = figure.subplots(1, panels)
    extent = None
    if plate_size_m is not None:
        x, y = (500 * size for size in plate_size_m)
        extent = (-x, x, y, -y)
    grey = np.asarray(image, dtype=np.float64).mean(axis=0)
    white = max(float(np.percentile(grey, WHITE_PERCENT)), 1e-30)
    shown = np.clip(grey / white, 0.0, 1.0) ** (1 / GAMMA)
    drawn = [("height [mm]", heights_m * 1e3, "viridis"), ("caustic", shown, "gray")]
    if uncertainty_m is not None:
        drawn.append(("uncertainty [um]", uncertainty_m * 1e6, "magma"))
    for panel, (name, values, colours) in zip(axes, drawn, strict=True):
        picture = panel.imshow(values, cmap=colours, origin="upper", extent=extent, interpolation="nearest")
        panel.set_title(name)
        panel.set_xlabel("x [mm]" if extent else "column")
        panel.set_ylabel("y [mm]" if extent else "row")
        if name != "caustic":
            figure.colorbar(picture, ax=panel, shrink=0.8)
    figure.suptitle(title)
    return figure
