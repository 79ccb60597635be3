"""Colour maps that everyone can read, as matplotlib, Plotly and pictures need them.

Heights and uncertainties: lightness grows with the value. Deviations: blue below,
red above, both ends equally dark, so that sign is hue and size is lightness.
"""

import numpy as np
import numpy.typing as npt

HEIGHT = "viridis"
UNCERTAINTY = "cividis"
DEVIATION = "RdBu_r"

MISSING_RGB = (190, 190, 190)
"""Shown where there is no value."""

_STOPS = 33


def palette(name: str, count: int) -> npt.NDArray[np.uint8]:
    """Colours of a map at equal steps, shape [count, 3].

    Args:
        name: as matplotlib calls it.
        count: of colours.
    """
    from matplotlib import colormaps

    colours: npt.NDArray[np.uint8] = np.round(colormaps[name](np.linspace(0, 1, count))[:, :3] * 255).astype(np.uint8)
    return colours


def colour_scale(name: str) -> list[tuple[float, str]]:
    """The map as Plotly and CSS gradients take it: place between 0 and 1, and colour."""
    colours = palette(name, _STOPS)
    return [
        (index / (_STOPS - 1), f"#{red:02x}{green:02x}{blue:02x}") for index, (red, green, blue) in enumerate(colours)
    ]
