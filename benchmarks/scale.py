"""Time and memory against photons, pixels and height samples: prints a table with slopes, writes JSON.

Relief: f_lines of tests/data, interpolated; 3 wavelengths, float32, a screen in contact. One of the three grows while
the others stay, but the photons, four to a pixel as by default, which grow with the pixels. Times are of whole calls,
least of the repeats: CPU time of all threads on a CPU, for other work may be on the machine, and wall time on a GPU.
Memory is what simulator and call take at most beyond what was taken before. A slope is the exponent of the size over
the largest tenfold range or what there is of it: 1 is linear, less is not yet or less than linear.

    python -m benchmarks.scale [--device cuda] [--quick] [--json FILE] [--budget-GB 8]
"""

import argparse
import gc
import itertools
import json
import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy import CONTACT, heights_of
from warp_caustics import CausticSimulator
from warp_caustics.errors import ResourceError

PHOTONS_PER_PIXEL = 4

ENOUGH_S = 3.0
"""Calls that have taken so long together are not repeated."""
GB = 2**30


@dataclass(frozen=True)
class Case:
    """One point of a curve; ``axis`` is what grows along it."""

    axis: str
    photons: int
    pixels: int = 512
    samples: int = 128
    batch: int = 1

    @property
    def size(self) -> int:
        """What time should be linear in: photons, pixels or samples of all reliefs, not those along a side."""
        if self.axis == "batch":
            return self.batch
        return {"photons": self.photons, "pixels": self.pixels**2, "samples": self.samples**2}[self.axis]

    @property
    def least_memory(self) -> float:
        """Image, its gradient and heights alone."""
        return 4 * self.batch * (2 * 3 * self.pixels**2 + 2 * self.samples**2) / GB


def cases_of(device: str) -> list[Case]:
    """Along every axis; reliefs at once on a GPU alone, as a CPU takes them one by one."""
    on_gpu = device.startswith("cuda")
    photons = [Case("photons", round(side)) for side in np.geomspace(1e5, 1e8, 7)]
    pixels = [Case("pixels", PHOTONS_PER_PIXEL * m**2, pixels=m) for m in (256, 512, 1024, 2048, 4096, 8192)]
    samples = [
        Case("samples", PHOTONS_PER_PIXEL * 2048**2, pixels=2048, samples=n) for n in (128, 256, 512, 1024, 2048, 4096)
    ]
    batches = [Case("batch", 4 * 1024**2, pixels=1024, samples=4096, batch=size) for size in (1, 4, 16, 64)]
    return [*photons, *pixels, *samples, *(batches if on_gpu else [])]


def relief(samples: int, batch: int, device: str) -> torch.Tensor:
    """f_lines at that many samples [m], shape [B, n, n]."""
    coarse = torch.from_numpy(heights_of("f_lines")).float()[None, None]
    fine = torch.nn.functional.interpolate(coarse, size=(samples, samples), mode="bilinear", align_corners=False)
    return fine[:, 0].to(device).repeat(batch, 1, 1)


WARM_UP = Case("photons", 10_000, 64, 16)
"""Loads kernels."""


class Memory:
    """Most memory [GB] that was taken since :meth:`start`, beyond what was taken then."""

    def __init__(self, device: str):
        self.on_gpu = device.startswith("cuda")
        self._before = 0.0

    def start(self) -> None:
        gc.collect()
        if self.on_gpu:
            torch.cuda.synchronize()
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats()
            self._before = torch.cuda.memory_allocated() / GB
        else:
            # Linux: sets the most resident memory back to that of now.
            Path("/proc/self/clear_refs").write_text("5")
            self._before = self._resident("VmRSS")

    def most(self) -> float:
        now = torch.cuda.max_memory_allocated() / GB if self.on_gpu else self._resident("VmHWM")
        return now - self._before

    @staticmethod
    def _resident(name: str) -> float:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 2**20


def least_seconds(call: Callable[[], object], device: str, repeats: int) -> float:
    """Least time of a call [s], of fewer repeats where they take long."""
    times = []
    on_gpu = device.startswith("cuda")
    clock = time.perf_counter if on_gpu else time.process_time
    for _ in range(repeats):
        if on_gpu:
            torch.cuda.synchronize()
        started = clock()
        call()
        if on_gpu:
            torch.cuda.synchronize()
        times.append(clock() - started)
        if sum(times) > ENOUGH_S:
            break
    return min(times)


def measure(case: Case, device: str, repeats: int) -> dict[str, Any]:
    """Time [s] and memory [GB] of an image, and of an image with its gradient."""
    scene = CONTACT.model_copy(update={"image_pixels": case.pixels, "height_samples": case.samples})
    memory = Memory(device)
    memory.start()
    heights = relief(case.samples, case.batch, device)
    started = time.process_time()
    simulator = CausticSimulator(scene, n_photons=case.photons, device=device)
    made = time.process_time() - started

    def image() -> None:
        with torch.no_grad():
            simulator(heights)

    image_s = least_seconds(image, device, repeats)
    image_memory = memory.most()

    def both() -> None:
        leaf = heights.clone().requires_grad_()
        found = simulator(leaf)  # stays, as where it is compared with another
        found.sum().backward()

    both_s = least_seconds(both, device, repeats)
    both_memory = memory.most()
    return {
        **asdict(case),
        "photons": simulator.n_photons,
        "size": case.size if case.axis != "photons" else simulator.n_photons,
        "made_s": made,
        "image_s": image_s,
        "both_s": both_s,
        "image_GB": image_memory,
        "both_GB": both_memory,
    }


def measure_alone(case: Case, device: str, repeats: int) -> dict[str, Any]:
    """The same in a process of its own on a CPU, whose memory would otherwise hold what earlier cases left."""
    if device.startswith("cuda"):
        return measure(case, device, repeats)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([measure.__module__])
    with ProcessPoolExecutor(1, mp_context=context) as alone:
        alone.submit(measure, WARM_UP, device, 1).result()
        return alone.submit(measure, case, device, repeats).result()


def slope(rows: list[dict[str, Any]], key: str) -> float:
    """Exponent of the size, over the largest tenfold range or, where points are wider apart, the last two."""
    largest = rows[-1]["size"]
    last = [row for row in rows if row["size"] >= 0.09 * largest] if len(rows) > 2 else rows
    last = last if len(last) > 1 else rows[-2:]
    return float(np.polyfit(np.log([row["size"] for row in last]), np.log([row[key] for row in last]), 1)[0])


def slopes_of(records: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Slopes of times and memory along every axis."""
    grouped = {axis: list(rows) for axis, rows in itertools.groupby(records, lambda row: row["axis"])}
    return {
        axis: {key: slope(rows, key) for key in ("image_s", "both_s", "image_GB", "both_GB")}
        for axis, rows in grouped.items()
        if len(rows) > 1
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--quick", action="store_true", help="up to a sixteenth of the largest sizes")
    parser.add_argument("--budget-GB", type=float, default=8.0, help="leave out cases whose arrays alone take more")
    parser.add_argument("--json", type=Path, help="where to write all figures")
    arguments = parser.parse_args()
    device, on_gpu = arguments.device, arguments.device.startswith("cuda")
    name = torch.cuda.get_device_name() if on_gpu else f"CPU, {torch.get_num_threads()} threads"
    print(f"{name}; {'wall' if on_gpu else 'CPU'} time")
    titles = ("axis", "photons", "pixels", "samples", "batch", "image s", "both s", "image GB", "both GB")
    print("{:<8} {:>10} {:>7} {:>8} {:>6} {:>10} {:>10} {:>9} {:>8}".format(*titles))
    cases = cases_of(device)
    largest = {case.axis: case.size for case in cases}
    records = []
    measure(WARM_UP, device, 1)
    for case in cases:
        if case.least_memory > arguments.budget_GB or (arguments.quick and 16 * case.size > largest[case.axis]):
            continue
        try:
            row = measure_alone(case, device, 3)
        except (ResourceError, torch.OutOfMemoryError) as error:
            print(f"{case.axis:<8} {case.photons:>10} {case.pixels:>7} {case.samples:>8} {case.batch:>6} {error}")
            continue
        records.append(row)
        print(
            f"{case.axis:<8} {row['photons']:>10} {case.pixels:>7} {case.samples:>8} {case.batch:>6} "
            f"{row['image_s']:>10.4f} {row['both_s']:>10.4f} {row['image_GB']:>9.2f} {row['both_GB']:>8.2f}",
            flush=True,
        )
    slopes = slopes_of(records)
    for axis, found in slopes.items():
        print(f"slopes by {axis}: " + ", ".join(f"{key} {value:.2f}" for key, value in found.items()))
    if arguments.json:
        told = {"device": name, "clock": "wall" if on_gpu else "CPU", "cases": records, "slopes": slopes}
        arguments.json.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
