"""What a run writes down: metrics.csv and sample pictures always, TensorBoard where it is installed."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from nets.training.task import Sample
from warp_caustics.io.atomic import atomic_path
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.scene import Scene

COLUMNS = (
    "step", "epoch", "elapsed_s", "learning_rate", "loss", "samples_per_s", "simulator_share",
    "val_loss", "val_rmse_um", "val_median_rmse_um", "val_perfect_rmse_um", "val_start_rmse_um", "val_first_rmse_um",
    "val_iterated_rmse_um", "val_unknown_rmse_um", "val_default_rmse_um", "val_one_wavelength_rmse_um",
    "val_coarse_rmse_um", "val_second_rmse_um", "val_default_second_rmse_um",
    "val_psnr_db", "val_noisy_psnr_db", "is_best",
)  # fmt: skip
"""Of metrics.csv: training figures now and then, validation figures at the end of an epoch; others stay empty."""


class RunRecord:
    """Metrics of one run, by step.

    Args:
        folder: of the run.
        step: rows after this step are of a life that was lost and are dropped.
    """

    def __init__(self, folder: Path, step: int = 0):
        self._table = _metrics(folder)
        rows = read_metrics(folder) if self._table.path.exists() else []
        self._table.write(row for row in rows if int(row["step"]) <= step)
        self.warning: str | None = None
        self._board = self._tensorboard(folder, step)

    def write(self, step: int, values: dict[str, Any]) -> None:
        """Add a row; unknown names are refused."""
        row = {name: value if not isinstance(value, float) else f"{value:.9g}" for name, value in values.items()}
        self._table.append({"step": step, **row})
        if self._board is not None:
            for name, value in values.items():
                if isinstance(value, int | float) and math.isfinite(value):
                    self._board.add_scalar(name, value, step)

    def picture(self, step: int, pixels: Any) -> None:
        """Show a picture in TensorBoard; pixels uint8, shape [H, W, 3]."""
        if self._board is not None:
            self._board.add_image("sample", pixels, step, dataformats="HWC")

    def close(self) -> None:
        """Flush what is not on disk yet."""
        if self._board is not None:
            self._board.close()

    def _tensorboard(self, folder: Path, step: int) -> Any:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self.warning = "tensorboard is not installed, so metrics go to metrics.csv only; pip install tensorboard"
            return None
        writer: Any = SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)
        return writer


def read_metrics(folder: Path) -> list[dict[str, str]]:
    """Rows of a run's metrics.csv; a last line that was cut off is left out."""
    return [row for row in _metrics(folder).read() if row.get("step", "").isdigit()]


def _metrics(folder: Path) -> CsvTable:
    return CsvTable(folder / "metrics.csv", COLUMNS)


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
        # Row 0 on top, as a photo viewer shows it.
        drawn = axes.imshow(array, origin="upper", extent=(-width / 2, width / 2, length / 2, -length / 2), **options)
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
