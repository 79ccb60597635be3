"""Sheets of pictures, one column per field, after Figs. 2 to 7 of the supplement."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from cli.figures import new_figure, rgb_composite, white_level
from cli.lit_glass import exaggeration, lit_glass
from nets.evaluation.fields import Field
from warp_caustics.far_screen import FAR_SCREEN_M, FarScreen
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

MAX_COLUMNS = 10
"""Fields on a sheet."""

LINEAR = 100
"""Differences below this part of the largest one shown are on a linear scale, larger ones on a logarithmic one."""

DPI = 90
_PANEL_IN = 1.42
_BAR_IN = 0.12
_SHOWN_QUANTILE = 0.98


class Sheets:
    """Draws all sheets of a comparison with the same scales.

    Args:
        fields: the plates; the first ten are drawn.
        scene: the set-up.
        device: where the caustics in the pictures are simulated.
    """

    def __init__(self, fields: Sequence[Field], scene: Scene, device: str):
        self.fields, self.scene = list(fields)[:MAX_COLUMNS], scene
        self.far = FarScreen(scene, device)
        self.factors = {field.name: exaggeration(field.heights_m, scene) for field in self.fields}
        self.far_white: dict[str, float] = {}
        heights = np.concatenate([np.abs(field.heights_m).ravel() for field in self.fields])
        self.limit_um = _round_up(float(np.quantile(heights, _SHOWN_QUANTILE)) * 1e6)

    def truth(self) -> bytes:
        """PNG of what is to be found: lit glass, caustic seen from afar, the image given to methods, heights."""
        titles = ("as lit glass", f"caustic, screen\nat {FAR_SCREEN_M * 1e3:g} mm", "image given\nto methods", "height")
        figure, panels, beside = self._figure(titles)
        drawn: Any = None
        for column, field in enumerate(self.fields):
            title = f"{field.name}\n{field.folds:.1%} folded"
            self._glass(panels[0, column], field, field.heights_m, title)
            self._caustic(panels[1, column], field, field.heights_m)
            white = white_level(field.image.irradiance)
            self._show(panels[2, column], rgb_composite(field.image.irradiance, self.scene.wavelengths_m, white))
            drawn = self._show(panels[3, column], field.heights_m * 1e6, cmap="viridis", vmin=0, vmax=self.limit_um)
        _bar(figure, drawn, beside)
        return png(figure)

    def found(self, heights: Mapping[str, FloatArray | None], rmse_um: Mapping[str, float | None]) -> bytes:
        """PNG of what a method found: lit glass, caustic, found minus true; blank where it failed.

        Args:
            heights: recovered reliefs by field [m], shape [n, n].
            rmse_um: relief RMSE by field [um].
        """
        figure, panels, beside = self._figure(
            ("as lit glass", f"caustic, screen\nat {FAR_SCREEN_M * 1e3:g} mm", "found - true")
        )
        drawn: Any = None
        for column, field in enumerate(self.fields):
            relief, rmse = heights.get(field.name), rmse_um.get(field.name)
            if relief is None or rmse is None:
                for axes in panels[:, column]:
                    axes.axis("off")
                panels[0, column].set_title(f"{field.name}\nfailed", fontsize=8)
                continue
            self._glass(panels[0, column], field, relief, f"{field.name}\nRMSE {_short(rmse)} um")
            self._caustic(panels[1, column], field, relief)
            error = (relief - field.heights_m) * 1e6
            drawn = self._show(panels[2, column], error, cmap="RdBu_r", norm=self._error_scale())
        if drawn is None:
            beside.remove()
        else:
            ticks = [sign * self.limit_um / step for sign, step in ((-1, 1), (-1, 10), (-1, LINEAR), (1, LINEAR))]
            bar = _bar(figure, drawn, beside)
            bar.set_ticks([*ticks, 0, self.limit_um / 10, self.limit_um], minor=False)
            bar.ax.yaxis.set_major_formatter("{x:g}")
            bar.minorticks_off()
        return png(figure)

    def _error_scale(self) -> SymLogNorm:
        """Of all differences: linear near 0, so that good and bad methods can both be read from it."""
        return SymLogNorm(self.limit_um / LINEAR, vmin=-self.limit_um, vmax=self.limit_um)

    def _figure(self, titles: Sequence[str]) -> tuple[Figure, Any, Axes]:
        rows, columns = len(titles), len(self.fields)
        size = (_PANEL_IN * columns + 1.5, _PANEL_IN * rows + 0.5)
        layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)
        figure = new_figure(*size, dpi=DPI, layout=layout)
        # A column of its own for the colour bar, so that all rows are aligned.
        grid = figure.subplots(rows, columns + 1, squeeze=False, width_ratios=[*[1.0] * columns, _BAR_IN / _PANEL_IN])
        panels = grid[:, :columns]
        for axes in grid[:-1, -1]:
            axes.remove()
        for row, title in enumerate(titles):
            panels[row, 0].set_ylabel(title, fontsize=8)
        return figure, panels, grid[-1, -1]

    def _show(self, axes: Axes, values: FloatArray, **options: Any) -> Any:
        axes.set_xticks([])
        axes.set_yticks([])
        # Row 0 on top, as a photo viewer shows it.
        return axes.imshow(values, origin="upper", extent=(0, 1, 0, 1), **options)

    def _glass(self, axes: Axes, field: Field, heights_m: FloatArray, title: str) -> None:
        self._show(axes, lit_glass(heights_m, self.scene, self.factors[field.name]))
        axes.set_title(title, fontsize=8)

    def _caustic(self, axes: Axes, field: Field, heights_m: FloatArray) -> None:
        """With the white of the true plate's caustic."""
        if field.name not in self.far_white:
            self.far_white[field.name] = white_level(self.far(field.heights_m))
        self._show(axes, rgb_composite(self.far(heights_m), self.scene.wavelengths_m, self.far_white[field.name]))


def _bar(figure: Figure, drawn: Any, beside: Axes) -> Any:
    """Colour bar of the last row, in micrometres."""
    bar = figure.colorbar(drawn, cax=beside, extend="both")
    bar.set_label("um", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    return bar


def png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file of 256 colours: a third of the size, and no difference to be seen."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])  # type: ignore[no-untyped-call]
    buffer = io.BytesIO()
    picture.quantize(256, dither=Image.Dither.FLOYDSTEINBERG).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _round_up(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    if value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9))


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
