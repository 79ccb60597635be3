"""A sheet of samples of a data set, to see at a glance what is in it."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.figures import new_figure, rgb_composite, white_level
from data_gen.benches.words import bench_lines
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike, atomic_path
from warp_caustics.scene import Scene

if TYPE_CHECKING:
    from data_gen.store.reader import CausticDataset

MAX_SAMPLES = 32
_TITLES = {
    "heights": "printed relief [um]",
    "image": "photo as irradiance",
    "bench": "bench",
    "start": "perturbed relief [um]",
    "gradient": "gradient of the data term",
    "target": "target image",
    "simulated": "simulated image",
    "noisy": "noisy image",
    "clean": "clean image",
}


def draw_sheet(dataset: "CausticDataset", output: PathLike, samples: int) -> int:
    """Draw the first samples, one per row, one field per column.

    Args:
        dataset: opened data set.
        output: picture to write (.png).
        samples: number of rows.

    Returns:
        Number of samples drawn.

    Raises:
        InputError: no number of samples, or nothing built yet.
    """
    if not 1 <= samples <= MAX_SAMPLES:
        raise InputError(f"{samples} samples; give 1 to {MAX_SAMPLES}")
    count = min(samples, len(dataset))
    if count == 0:
        raise InputError("data set holds no samples yet; build some first")
    rows = [{name: array.numpy() for name, array in dataset[k].items() if name in _TITLES} for k in range(count)]
    for row in rows:
        if "bench" in row:
            names = [column.name for column in dataset.columns("bench")]
            row["bench"] = np.array(bench_lines(dict(zip(names, row["bench"].tolist(), strict=True))))
    figure = sheet_figure(rows, Scene.model_validate(dataset.config.tree["scene"]))
    with atomic_path(output) as path:
        figure.savefig(path, format="png")
    return count


def sheet_figure(rows: Sequence[Mapping[str, npt.NDArray[Any]]], scene: Scene) -> Figure:
    """Samples as pictures; fields of images are shown in colour, with the white of the row's first image."""
    names = [name for name in _TITLES if name in rows[0]]
    figure = new_figure(2.9 * len(names), 2.75 * len(rows) + 0.4)
    panels = figure.subplots(len(rows), len(names), squeeze=False)
    for line, (row, axes_of_row) in enumerate(zip(rows, panels, strict=True)):
        white = next(white_level(row[n]) for n in names if row[n].ndim == 3)
        for name, axes in zip(names, axes_of_row, strict=True):
            if name == "bench":
                axes.set_axis_off()
                axes.text(0.0, 0.5, "\n".join(row[name].tolist()), va="center", fontsize=8, linespacing=1.6)
            else:
                _show(figure, axes, name, row[name].astype(np.float64), scene, white)
            if line == 0:
                axes.set_title(_TITLES[name], fontsize=9)
    return figure


def _show(figure: Figure, axes: Axes, name: str, array: npt.NDArray[Any], scene: Scene, white: float) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    if array.ndim == 3:
        axes.imshow(rgb_composite(array, scene.wavelengths_m, white), origin="upper")
        return
    if name == "gradient":
        limit = white_level(np.abs(array))
        drawn = axes.imshow(array, origin="upper", cmap="RdBu_r", vmin=-limit, vmax=limit)
    else:
        drawn = axes.imshow(array * 1e6, origin="upper", cmap="viridis")
    figure.colorbar(drawn, ax=axes, shrink=0.8)
