"""Makes examples/data/design.npy, the relief that was meant to be printed.

The print in examples/data/true_heights.npy is the five lines of
printed_lines.csv; the design has the same lines with other numbers, as a process with some tolerance would: widths
differ by 5 %, heights by 15 %, ends by 30 um (one standard deviation).

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
    """Check that the lines are those of the print, and write the design."""
    data = Path(__file__).parent / "data"
    printed = read_lines(data / "printed_lines.csv")
    truth = line_relief(printed, SAMPLES, PLATE_SIZE_M, supersampling=1)
    assert np.abs(truth - np.load(data / "true_heights.npy")).max() < 1e-12
    rng = np.random.default_rng(SEED)
    design = line_relief([designed(line, rng) for line in printed], SAMPLES, PLATE_SIZE_M, supersampling=1)
    np.save(data / "design.npy", design)
    print(f"design.npy differs from the print by {1e6 * np.sqrt(np.mean((design - truth) ** 2)):.1f} um RMS")


if __name__ == "__main__":
    main()
