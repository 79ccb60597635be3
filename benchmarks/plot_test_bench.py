"""The same plate on the four benches of the suite ``lab``: docs/bench.png.

python -m benchmarks.plot_test_bench docs/bench.png [--device cuda] [--photons 9000000]
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from data_gen.suites.light import Light
from data_gen.suites.shot import measured
from data_gen.suites.suites import suite_cases

PLATE = 4
"""Curves of fused fibres, of the careful bench."""
PART = (slice(170, 300), slice(170, 300))
WHITE = 6.0
"""Irradiance shown as white, relative to a flat plate's."""
GAMMA = 2.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--photons", type=int, help="per wavelength, in place of the suite's")
    arguments = parser.parse_args()
    cases = [case for case in suite_cases("lab") if case.plate.number == PLATE]
    light, plate = Light(arguments.device, arguments.photons), cases[0].plate
    figure = Figure(figsize=(3 * len(cases), 6.2), dpi=80, layout="constrained")
    for column, case in enumerate(cases):
        # The bow is the bench's.
        shown = replace(case, plate=replace(plate, bow_m=case.plate.bow_m))
        image = measured(shown, light).image.irradiance
        colours = np.clip(np.moveaxis(image, 0, -1) / WHITE, 0, 1) ** (1 / GAMMA)
        for row, part in enumerate((colours, colours[PART])):
            axes = figure.add_subplot(2, len(cases), 1 + column + row * len(cases))
            axes.imshow(part, origin="upper", interpolation="nearest")
            axes.set_xticks([])
            axes.set_yticks([])
            if row == 0:
                axes.set_title(case.row)
    figure.savefig(arguments.output)


if __name__ == "__main__":
    main()
