"""Error against time from the JSON files of speed.py: docs/speed.png.

python -m benchmarks.plot_speed benchmarks/cpu.json benchmarks/gpu.json docs/speed.png
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, NullFormatter, ScalarFormatter


def main(sources: list[Path], target: Path) -> None:
    """One curve per device and direction; the default number of photons is ringed."""
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for source, colour in zip(sources, ("tab:orange", "tab:blue"), strict=False):
        data = json.loads(source.read_text())
        rows = [case for case in data["cases"] if case["preset"] == "lattice" and case["batch"] == 1]
        # Descents record whole steps on a GPU; on a CPU there is nothing to record.
        gradient = "recorded" if "NVIDIA" in data["device"] else "both"
        for key, style, name in (("forward", "o-", "image"), (gradient, "s--", "image and gradient")):
            times = [row[key]["median_ms"] for row in rows]
            errors = [100 * row["M"] for row in rows]
            axes.loglog(times, errors, style, color=colour, label=f"{data['device']}: {name}")
            default = next(k for k, row in enumerate(rows) if row["n_photons"] == 1024**2)
            axes.plot(times[default], errors[default], "o", ms=13, mfc="none", mec="black")
    axes.set_xlabel("time per image [ms]")
    axes.set_ylabel("M: relative RMSE after a blur of 1 px [%]")
    axes.set_title("Five printed lines, 3 x 512 x 512 pixels. Ringed: the default, 4 photons per pixel", fontsize=10)
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks([0.1, 0.2, 0.5, 1, 2])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.grid(True, which="both", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:-1]], Path(sys.argv[-1]))
