"""Makes examples/data/true_heights.npy, a print, and design.npy, the relief that was meant.

The print is the five lines of printed_lines.csv, heights being means over cells, as everywhere in this project: one of
the lines is as narrow as a sample. The design has the same lines with other numbers, as a process with some tolerance
would: widths differ by 5 %, heights by 15 %, ends by 30 um (one standard deviation). make_capture.py takes the photo.

    python examples/make_design.py
"""

from pathlib import Path

import numpy as np

from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.line_list import read_lines

SEED = 11
PLATE_SIZE_M = (0.05, 0.05)
SAMPLES = 128


def designed(line: Line, rng: np.random.Generator) -> Line:
    """The line as it was meant, drawn around the line as it was printed."""

    def moved(point: tuple[float, float]) -> tuple[float, float]:
        x, y = np.array(point) + rng.normal(0, 30e-6, 2)
        return float(x), float(y)

    start, end = moved(line.start_m), moved(line.end_m)
    width = line.width_m * (1 + 0.05 * float(rng.normal()))
    return Line(start, end, width, line.height_m * (1 + 0.15 * float(rng.normal())))


def main() -> None:
    """Write the print and the design."""
    data = Path(__file__).parent / "data"
    printed = read_lines(data / "printed_lines.csv")
    truth = line_relief(printed, SAMPLES, PLATE_SIZE_M)
    np.save(data / "true_heights.npy", truth)
    rng = np.random.default_rng(SEED)
    design = line_relief([designed(line, rng) for line in printed], SAMPLES, PLATE_SIZE_M)
    np.save(data / "design.npy", design)
    print(f"design.npy differs from the print by {1e6 * np.sqrt(np.mean((design - truth) ** 2)):.1f} um RMS")


if __name__ == "__main__":
    main()
