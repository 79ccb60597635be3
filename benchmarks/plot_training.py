"""Validation error of a direct network over the time of its trainings, one after the other.

python -m benchmarks.plot_training docs/camera_training.png RUN/metrics.csv [RUN/metrics.csv ...]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from warp_caustics.io.csv_table import CsvTable

COLOURS = {"val_rmse_um": "#D55E00", "val_perfect_rmse_um": "#0072B2"}
NAMES = {"val_rmse_um": "through cameras", "val_perfect_rmse_um": "perfect images"}


def main(target: Path, sources: list[Path]) -> None:
    """Each training begins where the best epoch of the one before was."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    begin = 0.0
    for number, source in enumerate(sources):
        rows = [row for row in CsvTable(source, ()).read() if row["val_rmse_um"]]
        best = min(range(len(rows)), key=lambda k: float(rows[k]["val_rmse_um"]))
        rows = rows[: best + 1]
        for column, colour in COLOURS.items():
            minutes = [begin + float(row["elapsed_s"]) / 60 for row in rows]
            errors = [float(row[column]) for row in rows]
            axes.plot(minutes, errors, "o-", color=colour, markersize=3, label=None if number else NAMES[column])
        begin += float(rows[-1]["elapsed_s"]) / 60
        axes.axvline(begin, color="0.8", linewidth=1)
    axes.set_xlabel("time of training [min]")
    axes.set_ylabel("mean RMSE of 64 varied prints [um]")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
