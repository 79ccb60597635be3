"""A sheet of samples of a data set, to see at a glance what is in it."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cli.figures import new_figure, rgb_composite, white_level
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


def bench_lines(record: Mapping[str, float]) -> list[str]:
    """A bench in a few lines, from its named numbers."""
    light = "collimated" if not record["is_point_source"] else f"lamp at {record['lamp_distance_m']:.2g} m"
    taken = "frames taken" if record["is_calibrated"] else "no frames"
    apart = max(
        np.hypot(record[f"colour_shift_x_px_{k}"], record[f"colour_shift_y_px_{k}"])
        for k in range(sum(name.startswith("psf_px_") for name in record))
    )
    return [
        f"gap {record['gap_m'] * 1e6:.0f} um, base {record['base_thickness_m'] * 1e3:.3f} mm",
        f"index {record['index_offset']:+.4f}, {light}",
        f"lamp {np.degrees(record['lamp_half_angle_rad']):.2f}, "
        f"aside {np.degrees(np.hypot(record['tilt_x_rad'], record['tilt_y_rad'])):.2f} degrees",
        f"PSF {record['psf_px_0']:.2f} px, colours {apart:.2f} px apart",
        f"ambient {record['ambient']:.1%}, mixing {record['mixing']:.1%}",
        f"noise {record['noise']:.1%}, speckle {record['speckle_contrast']:.1%}",
        f"{'mosaic, ' if record['has_mosaic'] else ''}{record['bits']:.0f} bits, {taken}",
    ]


def _show(figure: Figure, axes: Axes, name: str, array: npt.NDArray[Any], scene: Scene, white: float) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    if array.ndim == 3:
        axes.imshow(rgb_composite(array, scene.wavelengths_m, white), origin="lower")
        return
    if name == "gradient":
        limit = white_level(np.abs(array))
        drawn = axes.imshow(array, origin="lower", cmap="RdBu_r", vmin=-limit, vmax=limit)
    else:
        drawn = axes.imshow(array * 1e6, origin="lower", cmap="viridis")
    figure.colorbar(drawn, ax=axes, shrink=0.8)
