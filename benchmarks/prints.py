"""What printing costs on this machine, per relief: plain lines, and prints as made. Each in turn, several times.

python -m benchmarks.prints [--device cuda]
"""

import argparse
import statistics
import time

import torch

from data_gen.config import CurvesConfig, MeandersConfig, PrintedPattern, ReliefConfig, TextConfig
from data_gen.dataset_config import DatasetConfig
from data_gen.making import Making
from data_gen.patterns import padded
from data_gen.samples import Reliefs

FIBRE = Making(fibre_diameter_m=(4e-4, 4e-4), passes=(1, 6))
ALL_OF_IT = Making(
    fibre_diameter_m=(4e-4, 4e-4),
    passes=(1, 6),
    overlaps=("sum", "max", "merge"),
    waviness=(0.0, 0.05),
    sideways_m=(0.0, 5e-5),
    end_thickness=(0.0, 0.3),
    bow_m=2e-5,
    base_wave_m=2e-6,
)
PATTERNS: dict[str, PrintedPattern] = {
    "lines": ReliefConfig(),
    "lines of a fibre, caps": ReliefConfig(making=FIBRE),
    "lines with all of it": ReliefConfig(making=ALL_OF_IT),
    "curves of a fibre": CurvesConfig(making=FIBRE),
    "meanders with all of it": MeandersConfig(making=ALL_OF_IT),
    "text of a fibre": TextConfig(making=FIBRE),
}
BATCH = 32
ROUNDS = 7


def main() -> None:
    """Median times of drawing on one core and of printing on the device, and the rows of a relief."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    device = parser.parse_args().device
    # Time of this process, where it does the work: machines are busy.
    clock = time.process_time if device == "cpu" else time.perf_counter
    torch.set_num_threads(1)
    sources = {
        name: Reliefs(DatasetConfig(kind="updater", n_samples=BATCH, reliefs=pattern), device)
        for name, pattern in PATTERNS.items()
    }
    drawing: dict[str, list[float]] = {name: [] for name in sources}
    printing: dict[str, list[float]] = {name: [] for name in sources}
    rows = {}
    for turn in range(ROUNDS + 1):
        for name, source in sources.items():
            start = time.process_time()
            strokes = source.drawn(range(BATCH))
            traits, batch = source.traits(range(BATCH)), torch.from_numpy(padded(strokes))
            drawing_s, start = time.process_time() - start, clock()
            source.printed(batch, traits).sum().item()
            # The first turn compiles.
            if turn:
                drawing[name].append(drawing_s / BATCH)
                printing[name].append((clock() - start) / BATCH)
            rows[name] = sum(map(len, strokes)) / BATCH
    print(f"{'per relief':26s} {'rows':>6s} {'draw, one core':>15s} {'print on ' + device:>15s}")
    for name in sources:
        times = (1e3 * statistics.median(each[name]) for each in (drawing, printing))
        print(f"{name:26s} {rows[name]:6.0f} " + " ".join(f"{value:12.3f} ms" for value in times))


if __name__ == "__main__":
    main()
