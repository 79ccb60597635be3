"""What colour filters of a sensor cost: photos with and without them, found and ignored.

    python -m benchmarks.colour_filters [--row ordinary] [--plates 8] [--seed 771001] [--methods direct] [--json FILE]

Plates and benches of ``configs/benches``; every photo as it is drawn but for its filters, of which it is taken with and
without. Filters are ignored where every pixel is told to have been measured (``CausticImage.own``).
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.trusted import RANDOM
from data_gen.bench_ranges import BenchRanges
from data_gen.benches.columns import bench_columns
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.samples import CaptureSampler
from nets.reconstruct.methods import create
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

ROOT = Path(__file__).parents[1]
CASES = ("none", "ignored", "found")


class Photos:
    """Photos of random benches with colour filters or without.

    Args:
        row: file of ``configs/benches``.
        seed: of plates, benches and noise.
    """

    def __init__(self, row: str, seed: int):
        ranges = yaml.safe_load((ROOT / "configs" / "benches" / f"{row}.yaml").read_text(encoding="utf-8"))
        bench = BenchRanges.model_validate(ranges["data"]["bench"])
        photons = PhotonConfig(n_photons=4_194_304)
        self.sampler = CaptureSampler(
            DatasetConfig(kind="capture", n_samples=10**6, seed=seed, clean=photons, bench=bench), "cpu"
        )
        names = [column.name for column in bench_columns(3)]
        self._column = names.index("has_mosaic")

    def draw(self, number: int) -> tuple[dict[str, CausticImage], FloatArray]:
        """One plate by case, and its true heights [m], shape [n, n]."""
        heights, benches = self.sampler.reliefs.true([number]), self.sampler.benches.draw([number])
        seen = {}
        for has_mosaic in (False, True):
            benches.values[0, self._column] = has_mosaic
            seen[has_mosaic] = self.sampler.benches.images(heights, benches)[0].cpu().numpy().astype(np.float32)
        images = {
            "none": CausticImage(seen[False]),
            "ignored": CausticImage(seen[True], own=np.ones(seen[True].shape, bool)),
            "found": CausticImage(seen[True]),
        }
        return images, heights[0].double().cpu().numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--row", default="ordinary", choices=RANDOM)
    parser.add_argument("--plates", type=int, default=8)
    parser.add_argument("--seed", type=int, default=771_001)
    parser.add_argument("--methods", default="direct")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    photos, rows = Photos(arguments.row, arguments.seed), list[dict[str, Any]]()
    methods = {name: create(name, Scene(), device="cpu") for name in arguments.methods.split(",")}
    for number in range(arguments.plates):
        images, truth = photos.draw(number)
        for name, method in methods.items():
            for case in CASES:
                started = time.perf_counter()
                result = method.reconstruct(images[case])
                rows.append(
                    {
                        "plate": number, "method": name, "filters": case,
                        "rmse_um": 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2))),
                        "residual": result.residual, "seconds": time.perf_counter() - started,
                        "by": result.counters.get("explained_by", "network"), "mosaic": result.counters.get("mosaic"),
                    }
                )  # fmt: skip
                print(json.dumps(rows[-1]), flush=True)
        if arguments.json:
            told = {"row": arguments.row, "seed": arguments.seed}
            arguments.json.write_text(json.dumps(told | {"rows": rows}, indent=1) + "\n")
    for name in methods:
        for case in CASES:
            own = [row["rmse_um"] for row in rows if row["method"] == name and row["filters"] == case]
            print(f"{name:<8} filters {case:<8} {np.mean(own):6.1f} um mean, {np.median(own):6.1f} median")


if __name__ == "__main__":
    main()
