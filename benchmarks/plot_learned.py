"""Errors of the learned methods against noise, exposure and iterations, from cells of learned.py: docs/learned.png.

python -m benchmarks.plot_learned benchmarks/learned_h200.json docs/learned.png
"""

import json
import re
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MultipleLocator

NAMES = {"once": "network alone", "symmetries": "eight symmetries", "direct": "direct"}
UPDATERS = {"full": "nsfc", "no denoiser": "without denoiser", "no gradient": "without gradient"}
COLOURS = ("#56B4E9", "#0072B2", "#D55E00")
OTHER_COLOURS = ("#000000", "#009E73", "#CC79A7")
CELL = re.compile(r".*/(?P<variant>\w+)/noise (?P<noise>[\d.]+)/exposure (?P<exposure>[\d.]+)/\d+")


def main(source: Path, target: Path) -> None:
    """Means over the fields as lines, medians dashed."""
    cells = json.loads(source.read_text())
    found = [(match, value) for key, value in cells.items() if (match := CELL.fullmatch(key))]
    figure, (noise, exposure, iterations) = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    for axes, varied, fixed, usual in ((noise, "noise", "exposure", 1.0), (exposure, "exposure", "noise", 0.01)):
        for (variant, name), colour in zip(NAMES.items(), COLOURS, strict=True):
            errors: dict[float, list[float]] = {}
            for match, value in found:
                if match["variant"] == variant and float(match[fixed]) == usual:
                    errors.setdefault(100 * (float(match[varied]) - (varied == "exposure")), []).append(value)
            at = sorted(errors)
            curves(axes, np.array(at), [errors[place] for place in at], name, colour)
    for (key, name), colour in zip(UPDATERS.items(), OTHER_COLOURS, strict=True):
        errors_at = np.array(cells[f"iterations/{key}"]).T
        curves(iterations, np.arange(len(errors_at)), list(errors_at), name, colour)
    noise.set(xlabel="white noise [% of flat light], one of 1.8 % besides", ylabel="relief RMSE of ten fields [um]")
    exposure.set(xlabel="exposure error [%], believed; 1 % of noise")
    iterations.set(xlabel="iterations of the paper's method, from flat")
    iterations.xaxis.set_major_locator(MultipleLocator(5))
    for axes in (noise, exposure, iterations):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else ""))
        axes.grid(True, which="both", alpha=0.25)
    for axes in (noise, exposure):
        axes.set_ylim(1, 70)
    for axes in (noise, iterations):
        axes.legend(fontsize=8, frameon=False, title="mean, and dashed the median", title_fontsize=8, loc="upper right")
    figure.savefig(target, dpi=100)


def curves(axes: Axes, at: np.ndarray, errors: list[list[float]], name: str, colour: str) -> None:
    """Mean and median."""
    axes.plot(at, [np.mean(values) for values in errors], "o-", color=colour, label=name, ms=4)
    axes.plot(at, [np.median(values) for values in errors], "--", color=colour)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
