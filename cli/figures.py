"""What all pictures share: how light is shown, a canvas without a screen, the plate in millimetres, files."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from warp_caustics.io.atomic import PathLike, atomic_path
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

BRIGHTEST_PERCENT = 99.5
"""Light at this percentile is white: caustic lines would otherwise leave the rest black."""
DISPLAY_GAMMA = 2.2

PNG_LEVEL = 4
"""Of compression: files of a result are 2 % larger than at 6, which is usual, and written in half the time."""

BAR_SHRINK = 0.82
"""Length of a colour bar, as part of the height that its panel may take."""


def white_level(image: FloatArray) -> float:
    """Value that is shown as white; 1 where an image has no light."""
    known = image[np.isfinite(image)]
    white = float(np.percentile(known, BRIGHTEST_PERCENT)) if known.size else 0.0
    return white if white > 0 else 1.0


def rgb_channels(wavelengths_m: tuple[float, ...], count: int) -> list[int]:
    """Channels for red, green and blue: longest, middle and shortest wavelength.

    Args:
        wavelengths_m: of the scene [m], shape [n_w].
        count: channels of the image; where they are not the scene's, first, middle and last.
    """
    order = np.argsort(wavelengths_m)[::-1] if count == len(wavelengths_m) else np.arange(count)
    return [int(order[index]) for index in (0, count // 2, -1)]


def rgb_composite(image: FloatArray, wavelengths_m: tuple[float, ...], white: float) -> FloatArray:
    """Longest, middle and shortest wavelength as red, green and blue; one wavelength is grey.

    Args:
        image: irradiance [W/m^2], shape [n_w, m, m].
        wavelengths_m: of the scene [m], shape [n_w]; see :func:`rgb_channels` where the image has other channels.
        white: irradiance shown at full brightness [W/m^2].

    Returns:
        Display values between 0 and 1, shape [m, m, 3].
    """
    chosen = np.moveaxis(image[rgb_channels(wavelengths_m, len(image))], 0, -1)
    shown: FloatArray = np.clip(chosen / white, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)
    return shown


def new_figure(width_in: float, height_in: float, *, dpi: int = 100, layout: Any = "constrained") -> Figure:
    """An empty figure of that size [inches], to be written or turned into pixels."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def show_plate(axes: Axes, scene: Scene, values: npt.ArrayLike, title: str, **options: Any) -> Any:
    """Draw a map of the plate or the window with axes in millimetres.

    Row 0 is on top, as a photo viewer shows the file, so y grows downwards: the view onto the screen from below.

    Args:
        axes: where.
        scene: gives the plate's size.
        values: map or colours, shape [rows, columns] or [rows, columns, 3]; the row grows with +y.
        title: of the panel.
        options: of ``imshow``.
    """
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    return axes.imshow(values, origin="upper", extent=plate_extent_mm(scene), **options)


def plate_extent_mm(scene: Scene) -> tuple[float, float, float, float]:
    """Edges of a map: left, right, bottom, top [mm], for ``origin="upper"``; the row grows with +y, row 0 is on top."""
    width, length = (size * 1e3 for size in scene.plate_size_m)
    return -width / 2, width / 2, length / 2, -length / 2


def add_bar(figure: Figure, drawn: Any, axes: Axes, label: str, **options: Any) -> Any:
    """Colour bar beside a panel."""
    return figure.colorbar(drawn, ax=axes, label=label, shrink=BAR_SHRINK, **options)


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure as an image (.png, .pdf, .svg), complete or not at all."""
    is_png = Path(path).suffix.lower() == ".png"
    options: dict[str, Any] = {"pil_kwargs": {"compress_level": PNG_LEVEL}} if is_png else {}
    with atomic_path(path) as temporary:
        figure.savefig(temporary, **options)
