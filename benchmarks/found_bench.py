"""Plate and bench together: errors with the bench told, told wrongly, and found; found numbers and their coverage.

    python -m benchmarks.found_bench [--plates 3] [--rows nothing,lamp-1m,...] [--device cpu] [--seed 650321]
                                     [--photons 16000000] [--exactly] [--json FILE] [--table]

Plates of an own seed on benches of the suite ``one-thing``. Of each the error of ``direct`` as it is told, with
``set_up=estimate``, and with ``--exactly`` as it is where the true bench is told; then what was found, in units of its
deviation from the truth. What the file holds is not computed again; ``--table`` prints it and computes nothing.
"""

import argparse
import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.dataset_config import DatasetConfig
from data_gen.suites.case import Case, Plate
from data_gen.suites.light import Light
from data_gen.suites.one_thing import DIFFERENCES, Difference, enlarged, one_case
from data_gen.suites.shot import Measured, measured
from nets.evaluation.alignment import aligned_rmse_um
from nets.reconstruct.methods import create
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_values
from warp_caustics.way_of_light import way_of_light_m

ROWS = (
    "nothing", "lamp-1m", "lamp-0.3m", "shift-0.5", "shift-1", "scale-0.5", "ambient-3", "no-dispersion", "gap-100um",
    "base-100um",
)  # fmt: skip
OF_PICTURES = {
    "small-0.4": Difference("picture 0.4 % too small", enlarged(-4e-3)),
    "small-1": Difference("picture 1 % too small", enlarged(-1e-2)),
}
"""Besides the rows of the suite, whose pictures are too large."""
KNOWN = {**DIFFERENCES, **OF_PICTURES}
SIZES = {"small-0.4": -4e-3, "small-1": -1e-2, "scale-0.2": 2e-3, "scale-0.5": 5e-3, "scale-1": 1e-2}
"""Of the picture, less 1: what a vergence looks like that is this over the way of light."""
TRUE_AMBIENT = {"ambient-3": 0.03}
PLATES = 24
"""Of the seed; ``--plates`` takes the first of them."""


def main() -> None:
    """Compute what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plates", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--seed", type=int, default=650_321)
    parser.add_argument("--photons", type=int, default=16_000_000)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--exactly", action="store_true")
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--json", type=Path, default=Path("build/found_bench.json"))
    arguments = parser.parse_args()
    held: dict[str, Any] = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    rows = arguments.rows.split(",")
    if not arguments.table:
        light = Light(arguments.device, arguments.photons)
        plates = DatasetConfig(kind="updater", n_samples=PLATES, seed=arguments.seed)
        method = create("direct", Scene(), device=arguments.device, set_up="estimate")
        for number in range(arguments.first, arguments.plates):
            for row in rows:
                key = f"{row}/{number}"
                case = one_case(row, KNOWN[row], Plate(plates, number))
                shot = None
                if key not in held:
                    shot = measured(case, light)
                    held[key] = found(method, case, shot)
                if arguments.exactly and "exactly" not in held[key] and case.scene != case.told:
                    shot = measured(case, light) if shot is None else shot
                    held[key]["exactly"] = told_exactly(case, shot, arguments.device)
                arguments.json.parent.mkdir(parents=True, exist_ok=True)
                arguments.json.write_text(json.dumps(held, indent=1))
                print(key, told(held[key]), flush=True)
    for line in table(held, rows):
        print(line)


def found(method: Any, case: Case, shot: Measured) -> dict[str, Any]:
    """Figures of one case: as told and with the bench looked for, from one run."""
    first: list[Reconstruction] = []
    own = method.watch
    method.watch = first.append
    started = time.perf_counter()
    result = method.reconstruct(shot.image)
    seconds = time.perf_counter() - started
    method.watch = own
    bench = result.counters["bench"]
    truth = optical_values(case.scene, case.told) | {AMBIENT: TRUE_AMBIENT.get(case.row, 0.0)}
    truth[VERGENCE] = truth.get(VERGENCE, 0.0) + SIZES.get(case.row, 0.0) / way_of_light_m(case.told)
    if not isinstance(case.scene.glass, str):
        truth["dispersion_scale"] = 0.0
    return {
        "told": errors(first[0], shot, case.told),
        "estimate": errors(result, shot, case.told),
        "is_kept": bench["is_kept"],
        "is_picture": bench["is_picture"],
        "why": bench["why"],
        "seconds": [round(sum(first[0].timings_s.values()), 1), round(seconds, 1)],
        "numbers": {
            each["name"]: [truth[each["name"]], each["seen"], each["sigma"], each["verdict"]]
            for each in bench["numbers"]
            if each["seen"] is not None
        },
    }


def told_exactly(case: Case, shot: Measured, device: str) -> dict[str, float]:
    """Errors where the true bench is told."""
    return errors(create("direct", case.scene, device=device).reconstruct(shot.image), shot, case.told)


def errors(result: Reconstruction, shot: Measured, scene: Scene) -> dict[str, float]:
    """RMSE as it is, and after the best move sideways [um]."""
    rmse = height_errors(result.heights_m, shot.heights_m, scene.plate_size_m)["rmse_um"]
    return {"rmse_um": round(rmse, 3), "aligned_um": round(aligned_rmse_um(result.heights_m, shot.heights_m), 3)}


def told(entry: Mapping[str, Any]) -> str:
    """One case in a line."""
    numbers = ", ".join(f"{name} {v[1]:.3g} +- {v[2]:.2g} ({v[0]:.3g})" for name, v in entry["numbers"].items())
    exactly = f", exactly {entry['exactly']['rmse_um']:.1f}" if "exactly" in entry else ""
    was, now = entry["told"]["rmse_um"], entry["estimate"]["rmse_um"]
    kept = "kept" if entry["is_kept"] else "not kept"
    return f"told {was:.1f} -> {now:.1f}{exactly} ({kept}), {entry['seconds']} s: {numbers}"


def table(held: Mapping[str, Any], rows: list[str]) -> list[str]:
    """Means over plates, and the share of numbers within one and two deviations of the truth."""
    lines = ["| what differs | told exactly | told wrongly | found | kept | the number, found - true [sigma] |"]
    lines.append("|---|---|---|---|---|---|")
    scores: list[float] = []
    for row in rows:
        entries = [entry for key, entry in held.items() if key.partition("/")[0] == row]
        if not entries:
            continue
        exact = [entry["exactly"]["rmse_um"] for entry in entries if "exactly" in entry]
        means = [np.mean([entry[name]["rmse_um"] for entry in entries]) for name in ("told", "estimate")]
        kept = sum(entry["is_kept"] for entry in entries)
        off = []
        for entry in entries:
            for name, (true, seen, sigma, _) in entry["numbers"].items():
                if sigma > 0:
                    scores.append((seen - true) / sigma)
                if true != entry["numbers"][name][0] or is_moved(row, name):
                    off.append(f"{name} {seen:.3g} ({true:.3g}, {(seen - true) / sigma:+.1f})")
        shown = f"{np.mean(exact):.1f}" if exact else "-"
        lines.append(
            f"| {KNOWN[row].title} | {shown} | {means[0]:.1f} | {means[1]:.1f} | {kept} of {len(entries)} | "
            f"{'; '.join(off)} |"
        )
    if scores:
        one, two = (sum(abs(score) <= k for score in scores) / len(scores) for k in (1, 2))
        lines.append(
            f"{len(scores)} numbers: {one:.0%} within one deviation, {two:.0%} within two; "
            f"largest {max(map(abs, scores)):.1f}, rms {math.sqrt(float(np.mean(np.square(scores)))):.2f}"
        )
    return lines


def is_moved(row: str, name: str) -> bool:
    """Whether a row is about a number."""
    about = {
        "lamp": VERGENCE, "scale": VERGENCE, "small": VERGENCE, "shift": "screen_x_m", "ambient": AMBIENT,
        "no": "dispersion_scale",
    }  # fmt: skip
    return about.get(row.partition("-")[0]) == name


if __name__ == "__main__":
    main()
