"""Sample pictures: what the network saw, the truth, its answer, and the difference."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from nets.training.tasks import Sample
from warp_caustics.io.atomic import atomic_path
from warp_caustics.scene import Scene

BRIGHTEST_PERCENT = 99.5
"""Irradiance at this percentile is white: focal lines would leave the rest black."""


def write_sample(path: Path, sample: Sample, scene: Scene, caption: str) -> npt.NDArray[np.uint8]:
    """Write a picture of four panels (PNG).

    Args:
        path: of the file.
        sample: what to show.
        scene: gives the size of the plate.
        caption: line at the top.

    Returns:
        Its pixels, shape [H, W, 3].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15.0, 4.2), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    image, truth, answer = (_array(values) for values in (sample.image, sample.truth, sample.answer))
    factor, unit = (1e6, "um") if sample.is_height else (1.0, "W/m$^2$")
    grey = image.mean(axis=0) if sample.is_height else image[0]
    low, white = (0.0, float(np.percentile(grey, BRIGHTEST_PERCENT)) or 1.0)
    shown = {"vmin": low, "vmax": white, "cmap": "gray"}
    if sample.is_height:
        values = {"vmin": float(truth.min()) * factor, "vmax": float(truth.max()) * factor, "cmap": "viridis"}
    else:
        values = shown
    difference = (answer - truth) * factor
    limit = float(np.percentile(np.abs(difference), BRIGHTEST_PERCENT)) or 1.0
    panels: tuple[tuple[str, npt.NDArray[Any], dict[str, Any], str], ...] = (
        ("image", grey, shown, "W/m$^2$"),
        ("truth", truth * factor, values, unit),
        ("network", answer * factor, values, unit),
        ("network - truth", difference, {"vmin": -limit, "vmax": limit, "cmap": "RdBu_r"}, unit),
    )
    width, length = (size * 1e3 for size in scene.plate_size_m)
    for axes, (title, array, options, label) in zip(figure.subplots(1, 4), panels, strict=True):
        # Row grows with +y.
        drawn = axes.imshow(array, origin="lower", extent=(-width / 2, width / 2, -length / 2, length / 2), **options)
        axes.set(title=title, xlabel="x [mm]")
        figure.colorbar(drawn, ax=axes, label=label, shrink=0.8)
    figure.suptitle(caption)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)
    pixels: Any = canvas.buffer_rgba()  # type: ignore[no-untyped-call]
    return np.asarray(pixels)[..., :3].copy()


def _array(values: torch.Tensor) -> npt.NDArray[np.float32]:
    array: npt.NDArray[np.float32] = values.detach().float().cpu().numpy()
    return array
