"""Are results right that say so, and wrong ones found out? Coverage and warnings of a method on benches of a seed.

    python -m benchmarks.trusted [--method direct] [--seed 990301] [--device cpu] [--json FILE] [--rows ROW:COUNT ...]
        [--jobs 1]
    python -m benchmarks.trusted --read FILE

Plates and benches that nothing was fitted to: random benches of ``configs/benches`` (``careful``, ``ordinary``,
``poor``), through their cameras, and rows of the suite ``one-thing`` with plates of the seed. The scene told is always
the default one. Of each plate the error, the share of points within one and two standard uncertainties (all of them,
and those with relief), the same of the spread over symmetries alone, and what the result says of itself. A result is
wrong where its RMSE is above three times the root mean square of its uncertainty, and flagged where it says that its
heights may be wrong by more than that uncertainty (``counters["doubt"]``).
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from data_gen.bench_ranges import BenchRanges
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.samples import CaptureSampler
from data_gen.suites.case import Plate, bench_plates
from data_gen.suites.light import Light
from data_gen.suites.one_thing import DIFFERENCES, one_case
from data_gen.suites.shot import measured
from nets.evaluation.bench.detector import is_wrong
from nets.evaluation.processes import check_jobs, gpus_for, in_processes
from nets.reconstruct.methods import create
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION, FAMILY_CALIBRATION
from nets.reconstruct.with_bench import FLATNESS
from warp_caustics.found_bench.bench_uncertainty import bench_uncertainty
from warp_caustics.reconstruct.base import CausticImage, Reconstruction, Reconstructor
from warp_caustics.reconstruct.rest import local_relief
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

ROOT = Path(__file__).parents[1]
RANDOM = ("careful", "ordinary", "poor")
ROWS = (
    "nothing:4", "careful:8", "ordinary:8", "poor:8", "lamp-0.3m:3", "scale-1:3", "ambient-3:3", "uneven-5:3",
    "lamp-1m:3", "scale-0.5:3", "shift-1:3", "gap-100um:3", "apart-0.3:3", "blur-2:2", "ellipse:2", "no-dispersion:2",
)  # fmt: skip
PHOTONS = 6_000_000
"""Of an image of one-thing; random benches have 4 million on a lattice."""
LEAST_RELIEF_M = 3e-6


def plates(row: str, count: int, seed: int, device: str) -> Iterator[tuple[CausticImage, FloatArray]]:
    """Images of a row with their true heights [m], shape [n, n]."""
    return (plate(row, number, seed, device) for number in range(count))


def plate(row: str, number: int, seed: int, device: str) -> tuple[CausticImage, FloatArray]:
    """One of them."""
    if row in RANDOM:
        ranges = yaml.safe_load((ROOT / "configs" / "benches" / f"{row}.yaml").read_text(encoding="utf-8"))
        config = DatasetConfig(
            kind="capture",
            n_samples=10**6,
            seed=seed,
            clean=PhotonConfig(n_photons=4_194_304),
            bench=BenchRanges.model_validate(ranges["data"]["bench"]),
        )
        arrays = CaptureSampler(config, device).draw([number]).arrays
        return CausticImage(arrays["image"][0].astype(np.float32)), arrays["heights"][0].astype(np.float64)
    difference = DIFFERENCES[row]
    printed = Plate(bench_plates(seed, 10_000, difference.reliefs), number + 50 * sorted(DIFFERENCES).index(row))
    shot = measured(one_case(row, difference, printed), Light(device, PHOTONS))
    return shot.image, shot.heights_m


def spread_alone(result: Reconstruction, scene: Scene) -> FloatArray | None:
    """The uncertainty without the bench's part and what all symmetries share [m]: factor times spread, and floor.

    None where lines explain the image, whose uncertainty is no factor of a spread.
    """
    assert result.uncertainty_m is not None
    if result.fibres_m is not None:
        return None
    is_told = result.settings["network"]["file"].startswith("direct-family")
    calibration = FAMILY_CALIBRATION if is_told else DIRECT_CALIBRATION
    widths = {name: part["sigma"] for name, part in result.counters["uncertainty"]["numbers"].items()}
    flat = widths.pop(FLATNESS, 0.0)
    bench = bench_uncertainty(scene, result.heights_m, widths).beside(FLATNESS, flat).total_m
    left = calibration.shared * result.counters["rest"]["of_contrast"] * local_relief(result.heights_m)
    return np.asarray(np.sqrt(np.maximum(result.uncertainty_m**2 - bench**2 - left**2, 0.0)))


def measured_row(row: str, number: int, result: Reconstruction, truth: FloatArray, scene: Scene) -> dict[str, Any]:
    """Figures of one plate."""
    error, sigma = np.abs(result.heights_m - truth), result.uncertainty_m
    assert sigma is not None
    relief = (np.abs(result.heights_m) > LEAST_RELIEF_M) | (np.abs(truth) > LEAST_RELIEF_M)
    alone = spread_alone(result, scene)

    def covered(by: FloatArray | None, where: Any) -> list[float | None]:
        if by is None or not where.any():
            return [None, None]
        return [float((error <= k * by)[where].mean()) for k in (1, 2)]

    everywhere = np.ones_like(relief)
    return {
        "row": row,
        "plate": number,
        "rmse_um": 1e6 * float(np.sqrt(np.mean(error**2))),
        "uncertainty_um": 1e6 * float(np.sqrt(np.mean(sigma**2))),
        "alone_um": None if alone is None else 1e6 * float(np.sqrt(np.mean(alone**2))),
        "within": covered(sigma, everywhere),
        "within_relief": covered(sigma, relief),
        "alone_within": covered(alone, everywhere),
        "alone_within_relief": covered(alone, relief),
        "ratio": result.counters["rest"]["ratio"],
        "causes": [[each["name"], each["value"], each["sigma"]] for each in result.counters["rest"]["causes"]],
        "is_flagged": result.counters["doubt"]["is_doubtful"],
        "times": result.counters["doubt"]["times"],
        "care": result.counters["uncertainty"]["care"]["times"],
        "is_kept": result.counters.get("bench", {}).get("is_kept"),
        "explained": None if result.trust is None else result.trust.is_explained,
        "warnings": len(result.warnings),
        "by": result.counters.get("explained_by", "network"),
        "network": result.settings["network"]["file"],
    }


def is_result_wrong(row: dict[str, Any], by: str = "uncertainty_um") -> bool:
    """Whether a result is worse than three times what it says."""
    return is_wrong(row["rmse_um"], row[by])


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Coverage per row of the suite, and what the warnings are worth."""
    lines = [
        "row            plates  RMSE    u [um]  on relief, of the spread alone -> of all      flagged  causes named"
    ]
    for name in dict.fromkeys(row["row"] for row in rows):
        own = [row for row in rows if row["row"] == name]
        causes: dict[str, int] = {}
        for each in own:
            for cause in dict.fromkeys(cause[0] for cause in each["causes"]):
                causes[cause] = causes.get(cause, 0) + 1
        lines.append(
            f"{name:<15}{len(own):>5}{_mean(own, 'rmse_um'):>8.1f}{_mean(own, 'uncertainty_um'):>8.1f}  "
            f"{_covered(own, 'alone_within_relief')} -> {_covered(own, 'within_relief')}"
            f"{sum(row['is_flagged'] for row in own):>5}   "
            + ", ".join(f"{cause} {count}" for cause, count in causes.items())
        )
    for key in ("within_relief", "within"):
        lines.append(f"all, {key}: {_covered(rows, f'alone_{key}')} -> {_covered(rows, key)}; min, median, max:")
        lines.append(f"    {_spread(rows, f'alone_{key}')} -> {_spread(rows, key)}")
    for name, by in (("the spread alone", "alone_um"), ("all", "uncertainty_um")):
        known = [row for row in rows if row[by] is not None]
        wrong = [row for row in known if is_result_wrong(row, by)]
        good = [row for row in known if not is_result_wrong(row, by)]
        found, false = (sum(row["is_flagged"] for row in each) for each in (wrong, good))
        lines.append(f"wrong by {name}: {found} of {len(wrong)} flagged; good: {false} of {len(good)} flagged")
    return lines


def _mean(rows: Sequence[dict[str, Any]], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _covered(rows: Sequence[dict[str, Any]], key: str) -> str:
    values = [row[key] for row in rows if row[key][0] is not None]
    return "{:.2f}/{:.2f}".format(*np.mean(values, axis=0)) if values else "   -   "


def _spread(rows: Sequence[dict[str, Any]], key: str) -> str:
    values = np.array([row[key] for row in rows if row[key][0] is not None])
    if not len(values):
        return "-"
    return ", ".join("{:.2f}/{:.2f}".format(*of(values, axis=0)) for of in (np.min, np.median, np.max))


def constants() -> dict[str, dict[str, float]]:
    """Of the uncertainty, by network: figures are of these, and have to be made anew where they change."""
    of = {"direct.safetensors": DIRECT_CALIBRATION, "direct-family.safetensors": FAMILY_CALIBRATION}
    return {file: {"scale": c.scale, "floor_um": 1e6 * c.floor_m, "shared": c.shared} for file, c in of.items()}


_begun: tuple[Reconstructor, int, str] | None = None
"""Of a process: the method, the seed, and the device."""


def begin(method: str, seed: int, device: str) -> None:
    """Make the method, once in each process."""
    global _begun
    _begun = create(method, Scene(), device=device), seed, device


def work(item: tuple[str, int]) -> dict[str, Any]:
    """Figures of one plate, by row and number."""
    assert _begun is not None
    method, seed, device = _begun
    image, truth = plate(*item, seed, device)
    started = time.perf_counter()
    result = method.reconstruct(image)
    return measured_row(*item, result, truth, Scene()) | {"seconds": time.perf_counter() - started}


def _place(row: dict[str, Any], wanted: Sequence[tuple[str, int]]) -> int:
    return wanted.index((row["row"], row["plate"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", default="direct", choices=("direct", "fibres", "auto"))
    parser.add_argument("--seed", type=int, default=990_301)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--rows", nargs="+", default=ROWS, metavar="ROW:COUNT")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="processes, which take all GPUs in turn")
    parser.add_argument("--read", type=Path, help="figures of an earlier run, to be summed up again")
    arguments = parser.parse_args()
    if arguments.read:
        print("\n".join(summary(json.loads(arguments.read.read_text())["rows"])))
        return
    check_jobs(arguments.jobs)
    rows = []
    wanted = [(name, k) for name, _, count in (row.partition(":") for row in arguments.rows) for k in range(int(count))]
    start = partial(begin, arguments.method, arguments.seed, arguments.device)
    if arguments.jobs > 1:
        found = in_processes(wanted, work, start, arguments.jobs, gpus_for(arguments.device))
    else:
        start()
        found = ((item, work(item)) for item in wanted)
    for _, row in found:
        rows.append(row)
        print(json.dumps(row), flush=True)
        if arguments.json:
            told = {"method": arguments.method, "seed": arguments.seed, "device": arguments.device}
            everything = told | {"constants": constants(), "rows": sorted(rows, key=lambda row: _place(row, wanted))}
            arguments.json.write_text(json.dumps(everything, indent=1) + "\n")
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
