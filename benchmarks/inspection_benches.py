"""Does an inspection find what is wrong with a plate on a real bench, and leave good plates alone there?

    python -m benchmarks.inspection_benches [--device cuda] [--json FILE] [--good 10] [--each 2] [--benches careful ...]
    python -m benchmarks.inspection_benches --read FILE

The four benches of the suite ``lab``, none of which is quite what methods are told, through their cameras; plates as in
``benchmarks/planted_defects.py``, of seeds of their own on each bench. The list of lines is the design, the tolerance
50 um. A good plate is one whose true relief passes by the rules of the verdict; a false alarm is a good plate that
fails. Each plate is written to the file as soon as it is done; those that are in it are not done again.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planted_defects import DEFECTS, PrintedPlate, printed_plate, scored
from data_gen.config import ReliefConfig
from data_gen.suites.case import Case, Plate, bench_plates
from data_gen.suites.lab import BENCHES, on_bench
from data_gen.suites.light import Light
from data_gen.suites.shot import measured_relief
from nets.inspection.from_nominal import FromNominal, FromNominalOptions
from warp_caustics.height_field import cell_centres
from warp_caustics.inspection.judge import doubted, judge_plate
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.line import line_relief
from warp_caustics.types import FloatArray

SEED = 61_204_019
TOLERANCE_M = 50e-6
PLATES = 100_000
FIRST_OF = {None: 0} | {kind: 1000 * (k + 1) for k, kind in enumerate(DEFECTS)}
"""Number of the first plate of each kind."""


def plates(benches: Sequence[str], good: int, each: int) -> Iterator[tuple[str, str | None, int]]:
    """Bench, defect and number of each plate, so that all benches and kinds are begun with."""
    for k in range(max(good, each)):
        for bench in benches:
            if k < each:
                yield from ((bench, kind, FIRST_OF[kind] + k) for kind in DEFECTS)
            if k < good:
                yield bench, None, k


def case_of(bench: str, number: int) -> Case:
    """A bench with the directions and the noise of one plate."""
    seed = SEED + 100 * list(BENCHES).index(bench)
    plate = Plate(bench_plates(seed, PLATES, ReliefConfig(), BENCHES[bench].told), number, BENCHES[bench].bow_m)
    return on_bench(bench, plate)


def true_relief(case: Case, plate: PrintedPlate) -> FloatArray:
    """What was printed, with the base's bow [m], shape [n, n]."""
    scene = case.told
    x, y = (cell_centres(scene.height_samples, length) for length in scene.plate_size_m)
    bow = 4 * case.plate.bow_m / max(scene.plate_size_m) ** 2 * (x[None, :] ** 2 + y[:, None] ** 2)
    return line_relief(plate.printed, scene.height_samples, scene.plate_size_m) + bow


def inspected(bench: str, defect: str | None, number: int, method: FromNominal, light: Light) -> dict[str, Any]:
    """Figures of one plate."""
    case = case_of(bench, number)
    plate = printed_plate(case.plate.rng("defects"), defect)
    truth, scene = true_relief(case, plate), case.told
    nominal = Nominal.of_lines(plate.designed, scene)
    image = measured_relief(case, truth, light).image
    started, busy = time.perf_counter(), time.process_time()
    found = method.reconstruct(image, nominal)
    seconds, processor = time.perf_counter() - started, time.process_time() - busy
    result, sigma = found.reconstruction, found.reconstruction.uncertainty_m
    assert sigma is not None
    judged = judge_plate(result.heights_m, nominal, scene, TOLERANCE_M, sigma_m=sigma, fitted=found.lines)
    judged = doubted(judged, result.trust)
    error = np.abs(result.heights_m - truth)
    return {
        "bench": bench,
        "plate": number,
        **scored(plate, judged),
        "true_verdict": judge_plate(truth, nominal, scene, TOLERANCE_M).verdict,
        "reasons": list(judged.reasons)[:4],
        "rmse_um": float(np.sqrt(np.mean(error**2)) * 1e6),
        "max_error_um": float(error.max() * 1e6),
        "sigma_um": float(np.sqrt(np.mean(sigma**2)) * 1e6),
        "within": [float((error <= k * sigma).mean()) for k in (1, 2)],
        "residual": result.residual,
        "discrepancy": result.counters.get("discrepancy"),
        "rest": {key: result.counters.get("rest", {}).get(key) for key in ("of_contrast", "ratio", "line")},
        "place": None if judged.place is None else [*judged.place.numbers.tolist(), *judged.place.sigma],
        "set_up": None if "bench" not in result.counters else _numbers(result.counters["bench"]),
        "bench_um": result.counters.get("uncertainty", {}).get("bench_um"),
        "explained_by_lines": result.counters.get("explained_by_lines"),
        "seconds": round(seconds, 1),
        "processor_s": round(processor, 1),
        "timings_s": {name: round(value, 1) for name, value in result.timings_s.items()},
    }


def _numbers(bench: dict[str, Any]) -> dict[str, list[float]]:
    """Value and deviation of each number of the bench that was found."""
    return {each["name"]: [each["found"], each["sigma"]] for each in bench["numbers"] if each["sigma"] is not None}


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Per bench: verdicts on good plates, and how many defects were found and named."""
    lines = ["bench      good: pass, uncertain, fail (false)   defects: fail, located, named, uncertain, passed  RMSE"]
    for bench in dict.fromkeys(row["bench"] for row in rows):
        own = [row for row in rows if row["bench"] == bench]
        good = [row for row in own if row["defect"] == "none" and row["true_verdict"] == "pass"]
        bad = [row for row in own if row["defect"] != "none"]
        lines.append(
            f"{bench:<11}{len(good):>4}: {_verdicts(good)}{'':14}{len(bad):>4}: {_count(bad, 'verdict', 'fail')}, "
            f"{_count(bad, 'located', True)}, {_count(bad, 'named', True)}, {_count(bad, 'verdict', 'uncertain')}, "
            f"{_count(bad, 'verdict', 'pass')}   {np.median([row['rmse_um'] for row in own]):.3g} um"
        )
        for kind in DEFECTS:
            some = [row for row in bad if row["defect"] == kind]
            if some:
                lines.append(f"    {kind:<10}{len(some):>4}: {_verdicts(some)}; named {_count(some, 'named', True)}")
    worse = [row for row in rows if row["defect"] == "none" and row["true_verdict"] != "pass"]
    lines.append(f"printed without a defect and truly out of tolerance: {len(worse)}: {_verdicts(worse)}")
    others = sum(row.get("others_named", 0) > 0 for row in rows)
    lines.append(f"plates of which a fibre was accused that is as designed: {others}")
    return lines


def _count(rows: Sequence[dict[str, Any]], key: str, value: Any) -> int:
    return sum(row.get(key) == value for row in rows)


def _verdicts(rows: Sequence[dict[str, Any]]) -> str:
    return ", ".join(f"{_count(rows, 'verdict', verdict)} {verdict}" for verdict in ("pass", "uncertain", "fail"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path, default=Path("inspection_benches.json"))
    parser.add_argument("--good", type=int, default=10, help="plates without a defect on each bench")
    parser.add_argument("--each", type=int, default=2, help="plates with each defect on each bench")
    parser.add_argument("--benches", nargs="+", default=list(BENCHES), choices=list(BENCHES))
    parser.add_argument("--options", type=json.loads, default={}, help="of the reconstruction, as JSON")
    parser.add_argument("--read", type=Path, help="only sum up a file")
    arguments = parser.parse_args()
    if arguments.read:
        print("\n".join(summary(json.loads(arguments.read.read_text())["plates"])))
        return
    path = arguments.json
    rows = json.loads(path.read_text())["plates"] if path.exists() else []
    done = {(row["bench"], row["plate"]) for row in rows}
    light = Light(arguments.device)
    methods: dict[str, FromNominal] = {}
    for bench, defect, number in plates(arguments.benches, arguments.good, arguments.each):
        if (bench, number) in done:
            continue
        if bench not in methods:
            options = FromNominalOptions(**arguments.options)
            methods[bench] = FromNominal(BENCHES[bench].told, options, arguments.device)
        rows.append(inspected(bench, defect, number, methods[bench], light))
        print(json.dumps(rows[-1]), flush=True)
        path.write_text(json.dumps({"device": arguments.device, "plates": rows}, indent=1) + "\n")
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
