"""Plates on benches other than told, on a CPU: ``direct``, and lines on the bench that it finds, as ``auto`` does.

    python -m benchmarks.lines_elsewhere [--seed 771002] [--rows ROW:COUNT ...] [--json FILE]

Plates of a seed of their own on rows of the suite ``one-thing`` and on random benches (:mod:`benchmarks.trusted`); the
scene told is always the default one. Times [s] are of the whole reconstruction.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trusted import plates
from nets.reconstruct.methods import create
from warp_caustics.scene import Scene

ROWS = ("lamp-1m:2", "lamp-0.3m:1", "shift-1:1")
METHODS = ("direct", "auto")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=771_002)
    parser.add_argument("--rows", nargs="+", default=ROWS, metavar="ROW:COUNT")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    methods = {name: create(name, Scene(), device="cpu") for name in METHODS}
    found: list[dict[str, Any]] = []
    for name, _, count in (row.partition(":") for row in arguments.rows):
        for number, (image, truth) in enumerate(plates(name, int(count), arguments.seed, "cpu")):
            plate: dict[str, Any] = {"row": name, "plate": number, "flat_um": 1e6 * float(np.sqrt(np.mean(truth**2)))}
            for method, made in methods.items():
                started = time.perf_counter()
                result = made.reconstruct(image)
                plate |= {
                    f"{method}_um": round(1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2))), 3),
                    f"{method}_s": round(time.perf_counter() - started, 1),
                }
            plate["explained_by"] = result.counters["explained_by"]
            found.append(plate)
            print(json.dumps(plate), flush=True)
            if arguments.json:
                record = {"seed": arguments.seed, "about": __doc__.splitlines()[0], "plates": found}
                arguments.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
