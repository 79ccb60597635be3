"""What a run writes down: metrics.csv always, TensorBoard where it is installed."""

import csv
import math
from pathlib import Path
from typing import Any

from warp_caustics.io.atomic import atomic_path

COLUMNS = (
    "step", "epoch", "elapsed_s", "learning_rate", "loss", "samples_per_s", "simulator_share",
    "val_loss", "val_rmse_um", "val_median_rmse_um", "val_perfect_rmse_um", "val_start_rmse_um", "val_first_rmse_um",
    "val_iterated_rmse_um", "val_psnr_db", "val_noisy_psnr_db", "is_best",
)  # fmt: skip
"""Of metrics.csv: training figures now and then, validation figures at the end of an epoch; others stay empty."""


class RunRecord:
    """Metrics of one run, by step.

    Args:
        folder: of the run.
        step: rows after this step are of a life that was lost and are dropped.
    """

    def __init__(self, folder: Path, step: int = 0):
        self.path = folder / "metrics.csv"
        rows = read_metrics(folder) if self.path.exists() else []
        with atomic_path(self.path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(row for row in rows if int(row["step"]) <= step)
        self.warning: str | None = None
        self._board = self._tensorboard(folder, step)

    def write(self, step: int, values: dict[str, Any]) -> None:
        """Add a row; unknown names are refused by the csv module."""
        row = {name: value if not isinstance(value, float) else f"{value:.9g}" for name, value in values.items()}
        with open(self.path, "a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, COLUMNS).writerow({"step": step, **row})
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
    with open(folder / "metrics.csv", newline="", encoding="utf-8") as file:
        text = file.read()
    whole = text[: text.rfind("\n") + 1].splitlines()
    return [row for row in csv.DictReader(whole) if None not in row and (row["step"] or "").isdigit()]
