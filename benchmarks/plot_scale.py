"""Time and memory against photons, pixels and height samples from the JSON files of scale.py: docs/scale.png.

python -m benchmarks.plot_scale benchmarks/scale_cpu.json [benchmarks/scale_h200.json] docs/scale.png
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

AXES = {
    "photons": "photons per wavelength\n512 x 512 pixels, 128 x 128 samples",
    "pixels": "pixels, 4 photons each\n128 x 128 samples",
    "samples": "height samples\n2048 x 2048 pixels, 4 photons each",
}
"""What grows along the panels, and what stays."""

COLOURS = "tab:orange", "tab:blue"


def main(sources: list[Path], target: Path) -> None:
    """Times above, memory below; slopes in the legend."""
    figure, panels = plt.subplots(2, len(AXES), figsize=(11, 6.5), sharex="col", sharey="row", layout="constrained")
    for source, colour in zip(sources, COLOURS, strict=False):
        data = json.loads(source.read_text())
        for column, (axis, title) in enumerate(AXES.items()):
            rows = [row for row in data["cases"] if row["axis"] == axis]
            sizes = [row["size"] for row in rows]
            for panel, quantity in ((panels[0, column], "s"), (panels[1, column], "GB")):
                for key, style, name in ((f"image_{quantity}", "o-", "image"), (f"both_{quantity}", "s--", "both")):
                    # Below a megabyte there is nothing to see.
                    values = [max(row[key], 1e-3 if quantity == "GB" else 0.0) for row in rows]
                    label = f"{data['device'].split(',')[0]}, {name}: slope {data['slopes'][axis][key]:.2f}"
                    panel.loglog(sizes, values, style, color=colour, ms=4, label=label)
            panels[1, column].set_xlabel(title)
    for row, label in zip(panels, ("time [s]", "memory [GiB]"), strict=True):
        row[0].set_ylabel(label)
        for panel in row:
            panel.grid(True, which="major", alpha=0.3)
            panel.legend(fontsize=7, loc="best")
    clocks = {"CPU": "CPU time of all threads", "wall": "wall time"}
    told = {data["device"]: clocks[data["clock"]] for data in (json.loads(source.read_text()) for source in sources)}
    figure.suptitle(
        "3 wavelengths, float32; both: image and gradient. " + "; ".join(f"{k}: {v}" for k, v in told.items()),
        fontsize=9,
    )
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:-1]], Path(sys.argv[-1]))
