"""How fast the simulator is, always with the error it has at that speed: prints a table, writes JSON.

Scene: f_lines of tests/data, 128 x 128 heights, 512 x 512 pixels, 3 wavelengths, float32. M is the relative
RMSE of the image against another renderer, both blurred by a Gaussian of 1 px, 12 border pixels left out. Times are
wall times of whole calls per image, Python and launches included: median of the repeats, and the spread between
the 10 % and 90 % quantiles. Image and gradient by torch's backward, and recorded as one with a weighted sum of the
pixels as objective. G px/s: pixels covered by footprints, forward.

    python -m benchmarks.speed [--device cuda] [--quick] [--json FILE]
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy import CONTACT, DATA, blurred_error, heights_of
from benchmarks.ceiling import atomic_ceilings
from warp_caustics import CausticSimulator
from warp_caustics.kernels.footprint import BOX_VARIANCE
from warp_caustics.kernels.profiles import REACH
from warp_caustics.photons import Chunk
from warp_caustics.recorded_gradient import RecordedGradient


@dataclass(frozen=True)
class Case:
    """One row: a preset with a number of photons and a batch of height fields."""

    preset: str
    n_photons: int
    batch: int = 1


LATTICE = tuple(Case("lattice", side**2) for side in (448, 512, 680, 868, 1024, 2048))
PAPER = (Case("paper", 1_000_000), Case("paper", 16_000_000))
BATCHES = tuple(Case("lattice", side**2, batch) for side in (448, 680) for batch in (16, 64))
LARGEST = Case("paper", 16_000_000, 64)


def seconds(call: Callable[[], object], device: str, repeats: int) -> list[float]:
    """Wall times of a call [s], after three that do not count."""
    times = []
    for k in range(repeats + 3):
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        started = time.perf_counter()
        call()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        if k >= 3:
            times.append(time.perf_counter() - started)
    return times


def spread(times: list[float], batch: int) -> dict[str, float]:
    """Median and quantiles per image [ms]."""
    per_image = [1e3 * t / batch for t in times]
    low, high = np.quantile(per_image, [0.1, 0.9])
    return {"median_ms": statistics.median(per_image), "low_ms": float(low), "high_ms": float(high)}


def measure(case: Case, device: str, repeats: int) -> dict[str, Any]:
    """Forward, forward with adjoint, error and memory of a case."""
    simulator = CausticSimulator(CONTACT, case.preset, n_photons=case.n_photons, device=device)  # type: ignore[arg-type]
    heights = torch.from_numpy(heights_of("f_lines")).float().to(device).repeat(case.batch, 1, 1)
    image = simulator(heights)
    error = blurred_error(image[0].cpu().numpy(), np.load(DATA / "f_lines_image.npz")["image"])
    weights = torch.randn_like(image)
    del image

    def both() -> None:
        leaf = heights.clone().requires_grad_()
        simulator(leaf).backward(weights)

    recorded = RecordedGradient(simulator, lambda seen, _: (weights[0] * seen).sum())
    if device.startswith("cuda"):
        torch.cuda.reset_peak_memory_stats()
    record: dict[str, Any] = {
        "preset": case.preset,
        "n_photons": simulator.n_photons,
        "batch": case.batch,
        "M": error,
        "forward": spread(seconds(lambda: simulator(heights), device, repeats), case.batch),
        "both": spread(seconds(both, device, repeats), case.batch),
    }
    if case.batch == 1:
        record["recorded"] = spread(seconds(lambda: recorded(heights[0]), device, repeats), 1)
    if device.startswith("cuda"):
        record["peak_GB"] = torch.cuda.max_memory_allocated() / 2**30
    updates = pixel_updates(simulator)
    record["pixel_updates"] = updates
    record["pixel_updates_per_s"] = 1e3 * updates / record["forward"]["median_ms"]
    record["photons_per_s"] = 1e3 * simulator.n_photons * CONTACT.n_wavelengths / record["forward"]["median_ms"]
    return record


def pixel_updates(simulator: CausticSimulator) -> int:
    """Pixels that all footprints of one image cover together."""
    engine, m = simulator.engine, CONTACT.image_pixels
    reach = REACH[simulator.profile]
    coefficients = engine.coefficients(torch.from_numpy(heights_of("f_lines")[None]).to(engine.device, engine.dtype))
    total = 0
    for chunk in engine.plan.chunks(2**20):
        positions = engine.positions(chunk)
        column, row, var_x, cov, var_y, _ = engine.records(
            engine.maps(coefficients, chunk, positions), positions
        ).unbind(2)
        beta = cov / (var_y + BOX_VARIANCE)
        counts = []
        for centre, variance in ((row, var_y), (column, var_x - beta * cov)):
            half = reach * variance.sqrt()
            first, last = (centre - half).floor().clamp(min=0), (centre + half).floor().clamp(max=m - 1)
            counts.append((last - first + 1).clamp(min=0).double())
        total += int((counts[0] * counts[1]).sum())
    return total


def stages(case: Case, device: str, repeats: int) -> dict[str, float]:
    """Median time of each stage on one thread or stream [ms]; of rows of a lattice, on all cores."""
    simulator = CausticSimulator(CONTACT, case.preset, n_photons=case.n_photons, device=device)  # type: ignore[arg-type]
    engine = simulator.engine
    fused = engine.fused
    heights = torch.from_numpy(heights_of("f_lines")[None]).float().to(device)
    coefficients = engine.coefficients(heights)
    weights = torch.randn(1, 3, 512, 512, device=device)
    if engine.rows is not None:
        rows = engine.rows
        with torch.no_grad():
            by_row: dict[str, Callable[[], object]] = {
                "spline coefficients": lambda: engine.coefficients(heights),
                "photons to pixels": lambda: rows.image(coefficients, engine.fused_photons, engine.optics),
                "adjoint: pixels to coefficients": lambda: rows.image_adjoint(
                    coefficients, engine.fused_photons, engine.optics, weights
                ),
            }
            return {name: 1e3 * statistics.median(seconds(call, device, repeats)) for name, call in by_row.items()}
    chunk = Chunk(0, simulator.n_photons, 0, engine.plan.rows)
    photons = engine.fused_photons(chunk, coefficients)
    image = torch.zeros(fused.image_shape(1), device=device)
    grad_maps = fused.splat_adjoint(coefficients, photons, weights)

    def splat() -> None:
        fused.splat(coefficients, photons, image)
        fused.unpacked(image)

    calls: dict[str, Callable[[], object]] = {
        "spline coefficients": lambda: engine.coefficients(heights),
        "photons to pixels": splat,
        "adjoint: pixels to surface maps": lambda: fused.splat_adjoint(coefficients, photons, weights),
        "adjoint: maps to coefficients": lambda: engine.maps_adjoint(coefficients, chunk, grad_maps),
    }
    return {name: 1e3 * statistics.median(seconds(call, device, repeats)) for name, call in calls.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--quick", action="store_true", help="fewer cases and repeats")
    parser.add_argument("--json", type=Path, help="where to write all figures")
    arguments = parser.parse_args()
    device, on_gpu = arguments.device, arguments.device.startswith("cuda")
    cases = [*LATTICE, *PAPER[: 2 if on_gpu else 1], *((*BATCHES, LARGEST) if on_gpu else ())]
    if arguments.quick:
        cases = list(LATTICE[:2])
    repeats = 30 if on_gpu else 7
    name = torch.cuda.get_device_name() if on_gpu else f"CPU, {torch.get_num_threads()} threads"
    print(name)
    titles = ("preset", "photons", "batch", "M %", "forward ms", "forward + adjoint ms", "recorded ms", "GB", "G px/s")
    print("{:<8} {:>9} {:>5} {:>7} {:>22} {:>24} {:>11} {:>6} {:>7}".format(*titles))
    records = []
    for case in cases:
        record = measure(case, device, repeats if case.batch == 1 else 2 if case == LARGEST else 5)
        records.append(record)
        forward, both = (
            f"{record[key]['median_ms']:8.3f} ({record[key]['low_ms']:.3f}-{record[key]['high_ms']:.3f})"
            for key in ("forward", "both")
        )
        print(
            f"{case.preset:<8} {record['n_photons']:>9} {case.batch:>5} {100 * record['M']:>7.3f} "
            f"{forward:>22} {both:>24} {record.get('recorded', {}).get('median_ms', 0):>11.3f} "
            f"{record.get('peak_GB', 0):>6.2f} "
            f"{record['pixel_updates_per_s'] / 1e9:>7.2f}",
            flush=True,
        )
    stage_times = {}
    for case in (LATTICE[1], LATTICE[4], *PAPER[: int(on_gpu)]):
        stage_times[f"{case.preset} {case.n_photons}"] = stages(case, device, repeats)
    for title, times in stage_times.items():
        print(title + ": " + ", ".join(f"{stage} {ms:.3f} ms" for stage, ms in times.items()), flush=True)
    ceilings = atomic_ceilings(device, seconds) if on_gpu else {}
    for kind, rate in ceilings.items():
        print(f"ceiling of float32 atomic additions, {kind}: {rate / 1e9:.0f} G/s")
    if arguments.json:
        arguments.json.write_text(
            json.dumps(
                {"device": name, "cases": records, "stages_ms": stage_times, "atomics_per_s": ceilings}, indent=1
            )
        )


if __name__ == "__main__":
    main()
