"""What all pictures of matplotlib share: a canvas without a screen, the plate in millimetres, files."""

from typing import Any

import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from warp_caustics.io.atomic import PathLike, atomic_path
from warp_caustics.scene import Scene

BAR_SHRINK = 0.82
"""Length of a colour bar, as part of the height that its panel may take."""


def new_figure(width_in: float, height_in: float, *, dpi: int = 100, layout: Any = "constrained") -> Figure:
    """An empty figure of that size [inches], to be written or turned into pixels."""
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def show_plate(axes: Axes, scene: Scene, values: npt.ArrayLike, title: str, *, lowest_y_on_top: bool = False,
               **options: Any) -> Any:  # fmt: skip
    """Draw a map of the plate or the window with axes in millimetres.

    Args:
        axes: where.
        scene: gives the plate's size.
        values: map or colours, shape [rows, columns] or [rows, columns, 3]; the row grows with +y.
        title: of the panel.
        lowest_y_on_top: the view from below, in which row 0 of a picture is on top.
        options: of ``imshow``.
    """
    width, length = (size * 1e3 for size in scene.plate_size_m)
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    y = (length / 2, -length / 2) if lowest_y_on_top else (-length / 2, length / 2)
    return axes.imshow(values, origin="upper" if lowest_y_on_top else "lower", extent=(-width / 2, width / 2, *y), **options)


def add_bar(figure: Figure, drawn: Any, axes: Axes, label: str, **options: Any) -> Any:
    """Colour bar beside a panel."""
    return figure.colorbar(drawn, ax=axes, label=label, shrink=BAR_SHRINK, **options)


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure as an image (.png, .pdf, .svg), complete or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
