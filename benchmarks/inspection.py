"""Does an inspection find what is wrong with a plate, and does it leave good plates alone?

Plates are drawn from Tab. 3 and printed with 10 um of noise in height and 20 um in place; some with one defect: a fibre
missing, 0.3 mm too high, or displaced by 1 mm. Each is photographed by a model camera (shot and read noise, vignetting,
dark offset, 16 bit; dark and flat frames) from a caustic of four million photons per wavelength, four times as many as
the reconstruction simulates, which looks straight at the window.

A good plate is one whose true relief passes by the rules of the verdict: of those printed without a defect one in
twenty or so is out of tolerance by the noise of its print, and fails rightly. A false alarm is a good plate that fails.

    python -m benchmarks.inspection [--good 10] [--defects 2] [--map [--find-lines]] [--first 0] [--json FILE]
                                    [--picture FOLDER]
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.planted_defects import distance
from data_gen.config import ReliefConfig
from data_gen.patterns import draw_strokes
from nets.inspection.from_nominal import FromNominal
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.capture.shot import Capture
from warp_caustics.inspection.findings import Inspection
from warp_caustics.inspection.judge import judge_plate
from warp_caustics.inspection.nominal import Nominal, with_lines
from warp_caustics.io.image_file import ImageFile
from warp_caustics.prints.line import Line, line_relief, moved_across
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SEED = 50_771
TOLERANCE_M = 50e-6
HEIGHT_NOISE_M, PLACE_NOISE_M = 10e-6, 20e-6
DEFECTS = ("missing", "too high", "displaced")
EXCESS_M, SHIFT_M = 3e-4, 1e-3
PHOTONS = 4_000_000
NEAR_M = 1e-3
"""A defect counts as located where a finding is so near."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A printed plate and its photo."""

    designed: list[Line]
    printed: list[Line]
    defect: str | None
    number: int
    """Of the defective fibre, from 1; 0 if there is none."""
    truth_m: np.ndarray
    capture: Capture


def printed_plate(k: int, defect: str | None, scene: Scene, simulator: CausticSimulator) -> Plate:
    rng = np.random.default_rng((SEED, k))
    designed = [Line((s[1], s[2]), (s[3], s[4]), s[5], s[6]) for s in draw_strokes(ReliefConfig(), rng).tolist()]
    printed = [
        Line(
            tuple(np.add(line.start_m, rng.normal(0, PLACE_NOISE_M, 2)).tolist()),
            tuple(np.add(line.end_m, rng.normal(0, PLACE_NOISE_M, 2)).tolist()),
            line.width_m,
            max(0.0, line.height_m + float(rng.normal(0, HEIGHT_NOISE_M))),
        )
        for line in designed
    ]
    number = 0
    if defect is not None:
        # A fibre of some size: 8 mm long, 0.6 mm wide, 0.2 mm high.
        clear = [
            i
            for i, line in enumerate(designed)
            if np.hypot(*np.subtract(line.start_m, line.end_m)) > 8e-3 and line.height_m > 2e-4 and line.width_m > 6e-4
        ]
        i = clear[int(rng.integers(len(clear)))]
        number, line = i + 1, printed[i]
        if defect == "missing":
            printed[i] = replace(line, height_m=0.0)
        elif defect == "too high":
            printed[i] = replace(line, height_m=line.height_m + EXCESS_M)
        else:
            printed[i] = moved_across(line, SHIFT_M, SHIFT_M)
    truth = line_relief(printed, scene.height_samples, scene.plate_size_m)
    light = simulator(torch.tensor(truth, dtype=torch.float32)).cpu().numpy().astype(np.float64)
    return Plate(designed, printed, defect, number, truth, photographed(light, scene, k))


def photographed(light: np.ndarray, scene: Scene, seed: int) -> Capture:
    """Caustic [W/m^2], shape [n_w, m, m], through camera and calibration."""
    m = light.shape[-1]
    row, column = (np.mgrid[:m, :m] + 0.5) / m - 0.5
    response = 1 / (1 + 0.35 * ((row - 0.05) ** 2 + column**2)) ** 2
    gain, electrons_per_count = np.array([4000.0, 6000.0, 3000.0])[: len(light), None, None], 2.5

    def frame(seen: np.ndarray, exposure: int) -> ImageFile:
        rng = np.random.default_rng((SEED, seed, exposure))
        counts = rng.poisson(gain * np.maximum(seen, 0) * response * electrons_per_count) / electrons_per_count
        counts = np.clip(np.rint(counts + 200 + rng.normal(0, 4, counts.shape)), 0, 65535)
        return ImageFile(values=counts.astype(np.float32), full_scale=65535.0, bit_depth=16, format="tiff")

    dark, flat = frame(np.zeros_like(light), 1), frame(np.ones_like(light), 2)
    return capture_to_irradiance(frame(light, 0), scene=scene, dark=dark, flat=flat)


def inspected(plate: Plate, method: FromNominal, scene: Scene, nominal: Nominal) -> tuple[Inspection, dict[str, Any]]:
    image = CausticImage(plate.capture.irradiance, plate.capture.noise_std, plate.capture.mask)
    started = time.perf_counter()
    found = method.reconstruct(image, nominal)
    seconds = time.perf_counter() - started
    result = found.reconstruction
    judged = judge_plate(
        result.heights_m, nominal, scene, TOLERANCE_M, sigma_m=result.uncertainty_m, fitted=found.lines
    )
    error = np.abs(result.heights_m - plate.truth_m)
    assert result.uncertainty_m is not None
    return judged, {
        "seconds": round(seconds, 1),
        "rmse_um": float(np.sqrt(np.mean(error**2)) * 1e6),
        "max_error_um": float(error.max() * 1e6),
        "within_one": float((error <= result.uncertainty_m).mean()),
        "within_two": float((error <= 2 * result.uncertainty_m).mean()),
        # Most of a plate is bare and easy; this is where it is not.
        "unsure_within_two": share(error <= 2 * result.uncertainty_m, result.uncertainty_m > 5e-6),
        "residual": result.residual,
        "timings_s": {name: round(value, 1) for name, value in result.timings_s.items()},
    }


def true_verdict(plate: Plate, nominal: Nominal, scene: Scene) -> str:
    """That of the relief as it was printed, measured without any error."""
    return judge_plate(plate.truth_m, nominal, scene, TOLERANCE_M).verdict


def share(holds: np.ndarray, among: np.ndarray) -> float:
    """Of the cells ``among``, those where something holds; 1 where there are none."""
    return float(holds[among].mean()) if among.any() else 1.0


def scored(plate: Plate, found: Inspection) -> dict[str, Any]:
    """Whether the verdict is right, and whether the defect was found, where it is, and named."""
    faults = {fibre.name: fibre.status for fibre in found.fibres if fibre.status not in ("as designed", "hidden")}
    row: dict[str, Any] = {
        "defect": plate.defect or "none",
        "lines": len(plate.designed),
        "verdict": found.verdict,
        "regions": len(found.regions),
        "faults": faults,
        "undecided_mm2": 0.0 if found.undecided is None else float(found.undecided.mean() * 2500),
    }
    if plate.defect is not None:
        axis = plate.designed[plate.number - 1], plate.printed[plate.number - 1]
        row["located"] = bool(found.regions) and distance(found.regions[0].centre_m, axis) < NEAR_M
        row["named"] = faults.get(str(plate.number)) == plate.defect
        row["others_named"] = sum(name != str(plate.number) for name in faults)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--good", type=int, default=10)
    parser.add_argument("--defects", type=int, default=2, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first plate, for other plates")
    parser.add_argument("--map", action="store_true", help="the design is a height map, not a list of lines")
    parser.add_argument("--find-lines", action="store_true", help="in the height map")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path, help="folder for a picture of each plate")
    arguments = parser.parse_args()
    scene = Scene()
    simulator = CausticSimulator(scene, "lattice", n_photons=PHOTONS, device=arguments.device)
    method = FromNominal(scene, device=arguments.device)
    kinds = [kind for _ in range(arguments.defects) for kind in DEFECTS]
    bad = [(100 + k, kind) for k, kind in enumerate(kinds)]
    jobs = [*bad[: len(DEFECTS)], *((k, None) for k in range(arguments.good)), *bad[len(DEFECTS) :]]
    rows = []
    for k, defect in jobs:
        plate = printed_plate(arguments.first + k, defect, scene, simulator)
        nominal = Nominal.of_lines(plate.designed, scene)
        if arguments.map:
            nominal = Nominal(nominal.relief_m)
            nominal = with_lines(nominal, "", scene) if arguments.find_lines else nominal
        found, figures = inspected(plate, method, scene, nominal)
        truth = {"true_verdict": true_verdict(plate, nominal, scene)}
        rows.append({"plate": arguments.first + k, **scored(plate, found), **truth, **figures})
        print(json.dumps(rows[-1]), flush=True)
        if arguments.json:
            arguments.json.write_text(json.dumps({"map": arguments.map, "plates": rows}, indent=1) + "\n")
        if arguments.picture:
            arguments.picture.mkdir(exist_ok=True)
            name = f"plate {arguments.first + k} ({defect or 'good'}): {found.verdict}"
            draw(found, name, arguments.picture / f"{arguments.first + k}.png")
            assert found.limit_m is not None and found.undecided is not None
            np.savez_compressed(
                arguments.picture / f"{arguments.first + k}.npz",
                deviation_m=found.deviation_m,
                nominal_m=found.nominal_m,
                truth_m=plate.truth_m,
                limit_m=found.limit_m,
                undecided=found.undecided,
            )
    report(rows)


def draw(found: Inspection, title: str, path: Path) -> None:
    """Picture of nominal and measured relief and their difference, out of tolerance outlined."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(15, 4.9), layout="constrained")
    limit_um = 3e6 * found.tolerance_m
    for axis, name, values_m, options in (
        (axes[0], "nominal [um]", found.nominal_m, {}),
        (axes[1], "measured [um]", found.nominal_m + found.deviation_m, {}),
        (
            axes[2],
            "measured - nominal [um]",
            found.deviation_m,
            {"cmap": "RdBu_r", "vmin": -limit_um, "vmax": limit_um},
        ),
    ):
        shown = axis.imshow(1e6 * values_m, origin="upper", **options)
        axis.set_title(name)
        figure.colorbar(shown, ax=axis, shrink=0.8)
    if found.out_of_tolerance.any():
        axes[2].contour(found.out_of_tolerance, levels=[0.5], colors="black")
    figure.suptitle(title)
    figure.savefig(path)
    plt.close(figure)


def false_alarms(rows: Sequence[dict[str, Any]]) -> str:
    """How many plates failed whose true relief is good, and how many passed whose true relief is not."""
    good = [row for row in rows if row["true_verdict"] == "pass"]
    bad = [row for row in rows if row["true_verdict"] != "pass"]
    return (
        f"truly good: {len(good)}, false alarms {sum(row['verdict'] == 'fail' for row in good)}; "
        f"truly out of tolerance: {len(bad)}, passed {sum(row['verdict'] == 'pass' for row in bad)}"
    )


def report(rows: Sequence[dict[str, Any]]) -> None:
    good = [row for row in rows if row["defect"] == "none"]
    bad = [row for row in rows if row["defect"] != "none"]
    counts = {verdict: sum(row["verdict"] == verdict for row in good) for verdict in ("pass", "uncertain", "fail")}
    print(
        f"without a defect: {len(good)}, {counts['pass']} pass, {counts['uncertain']} uncertain, {counts['fail']} fail"
    )
    if all("true_verdict" in row for row in rows):
        print(false_alarms(good))
    for kind in DEFECTS:
        some = [row for row in bad if row["defect"] == kind]
        told = ", ".join(f"{key} {sum(bool(row.get(key)) for row in some)}" for key in ("located", "named"))
        print(f"{kind}: {len(some)}, failed {sum(row['verdict'] == 'fail' for row in some)}, {told}")
    for key in ("rmse_um", "max_error_um", "within_one", "within_two", "unsure_within_two", "seconds"):
        values = [row[key] for row in rows]
        print(f"{key}: median {np.median(values):.3g}, {min(values):.3g} to {max(values):.3g}")


if __name__ == "__main__":
    main()
