"""The same plate on the ideal bench and on one of each level: docs/benches.png.

python -m benchmarks.plot_random_benches docs/benches.png
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import yaml
from matplotlib.patches import Rectangle

from data_gen.bench_ranges import BenchRanges
from data_gen.benches.bench_set import Benches
from data_gen.benches.words import bench_lines
from data_gen.dataset_config import DatasetConfig
from warp_caustics.io.heights import read_heights
from warp_caustics.scene import Scene

ROOT = Path(__file__).parents[1]
LEVELS = ("careful", "ordinary", "poor")
BENCH = 13
"""Number of the bench: all levels draw the same numbers from 0 to 1, and make them as large as their ranges say."""
DETAIL = (slice(222, 302), slice(204, 284))
"""Rows and columns that are shown enlarged."""
WHITE = 4.0
"""Brightness, of flat light, that is shown white."""


def ranges_of(level: str) -> BenchRanges:
    """Shipped ranges."""
    tree = yaml.safe_load((ROOT / "configs" / "benches" / f"{level}.yaml").read_text(encoding="utf-8"))
    return BenchRanges.model_validate(tree["data"]["bench"])


def shown(image: np.ndarray) -> np.ndarray:
    """Colours for the eye: gamma of sRGB."""
    return np.moveaxis(np.clip(image / WHITE, 0, 1) ** (1 / 2.2), 0, -1)


def main(target: Path) -> None:
    """Photos side by side, a part enlarged, and what the bench was."""
    plate = torch.tensor(read_heights(ROOT / "examples" / "data" / "true_heights.npy"), dtype=torch.float32)[None]
    figure, rows = plt.subplots(2, 4, figsize=(12, 7), layout="constrained")
    for number, name in enumerate(("ideal", *LEVELS)):
        ranges = BenchRanges() if name == "ideal" else ranges_of(name)
        config = DatasetConfig(kind="capture", n_samples=1, scene=Scene(), bench=ranges)
        benches = Benches(config, "the same numbers for all levels")
        drawn = benches.draw([BENCH])
        picture = shown((benches.light if name == "ideal" else benches.images)(plate, drawn)[0].numpy())
        whole, part = rows[0, number], rows[1, number]
        whole.imshow(picture, interpolation="antialiased")
        whole.set_title(name)
        part.imshow(picture[DETAIL], interpolation="nearest")
        top, left = DETAIL[0].start, DETAIL[1].start
        size = DETAIL[0].stop - top
        whole.add_patch(Rectangle((left, top), size, size, fill=False, color="white", lw=0.8))
        words = "perfect in everything" if name == "ideal" else "\n".join(bench_lines(drawn.record(0)))
        part.set_xlabel(words, fontsize=8, loc="left")
        for axes in (whole, part):
            axes.set(xticks=[], yticks=[])
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
