"""All scores of a release, once: every method on the test fields, each cell in a JSON file.

The thirty test fields are what nothing was tuned on. So they are not looked at while methods are written: this runs
once for a release, its file is committed with it, and what is changed afterwards because of a score makes it the last
time that these fields are test fields. An hour on a GPU; cut at any time it goes on where it was.

    python -m benchmarks.release [--device cuda] [--json benchmarks/release.json] [--images FOLDER]
                                 [--which test] [--fields N] [--methods direct,fibres,...]

`--which development` and `--fields 1` try it out. Every cell tells image (set, fingerprint of the set, number,
hash of its pixels), method, device, code version, warnings, and all errors in um. Cells of other code, images or
devices are never taken for these: a file holds cells of several releases side by side.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.testset import COUNTS, NOISE_STD, TEST_PHOTONS, fields_config
from nets.evaluation.code_version import code_version
from nets.evaluation.fields import Field, prepare, testset_sources
from nets.evaluation.method_spec import MethodSpec, parse_methods
from nets.evaluation.run import check_methods, reconstruct, warm_up
from warp_caustics.device import device_name
from warp_caustics.io.json_file import write_json
from warp_caustics.metrics import height_errors
from warp_caustics.scene import Scene

METHODS = (
    "flat,transport,refine,sfc,hcccd,nsfc,nsfc:denoise=false,nsfc:use_gradient=false,direct:refine=false,direct,fibres"
)

Cell = dict[str, Any]


def image_of(field: Field, which: Any) -> Cell:
    """What tells an image from any other."""
    fingerprint = fields_config(which=which).sample_fingerprint()
    return {"set": which, "fingerprint": fingerprint, "field": field.name, "pixels": field.content()["image"]}


def cell_of(spec: MethodSpec, field: Field, which: Any, scene: Scene, device: str) -> Cell:
    """One method on one image: errors, what it says of itself, and all that decides them."""
    started = time.perf_counter()
    result = reconstruct(spec, field, scene, device)
    errors = height_errors(result.heights_m, field.heights_m, scene.plate_size_m)
    cell: Cell = {
        **identity(spec, field, which, device),
        "device_name": device_name(device),
        "folds": field.folds,
        "rmse_um": errors["rmse_um"],
        "rmse_mean_removed_um": errors["rmse_mean_removed_um"],
        "quantile95_um": errors["quantile95_um"],
        "residual": result.residual,
        "stop_reason": result.stop_reason,
        "warnings": list(result.warnings),
        "time_s": time.perf_counter() - started,
    }
    if result.uncertainty_m is not None:
        ratio = np.abs(result.heights_m - field.heights_m) / np.maximum(result.uncertainty_m, 1e-12)
        cell["within"] = [float(np.mean(ratio <= sigmas)) for sigmas in (1, 2, 3)]
    return cell


def identity(spec: MethodSpec, field: Field, which: Any, device: str) -> Cell:
    """What two cells have in common that are the same."""
    return {"image": image_of(field, which), "method": spec.label, "device": device, "code": code_version()}


def missing(held: list[Cell], wanted: Cell) -> bool:
    """Whether no cell of a file is this one."""
    return not any(all(cell.get(key) == value for key, value in wanted.items()) for cell in held)


def summary(cells: list[Cell]) -> list[str]:
    """Mean, median and worst of each method, over the cells of this code."""
    lines = [f"{'RMSE [um]':<32}{'fields':>8}{'mean':>9}{'median':>9}{'worst':>9}"]
    code = code_version()
    for method in dict.fromkeys(cell["method"] for cell in cells):
        found = [cell["rmse_um"] for cell in cells if cell["method"] == method and cell["code"] == code]
        if found:
            figures = np.mean(found), np.median(found), np.max(found)
            lines.append(f"{method:<32}{len(found):>8}" + "".join(f"{value:>9.2f}" for value in figures))
    return lines


def run(path: Path, which: Any, count: int | None, methods: str, scene: Scene, device: str, images: Path) -> list[Cell]:
    """Fill a file with what it lacks; returns all its cells.

    Args:
        path: JSON file, read and continued.
        which: set of fields.
        count: how many, the first ones; all if None.
        methods: as ``nsfc compare`` takes them.
        scene: the set-up.
        device: where to compute.
        images: folder in which simulated images are kept.
    """
    cells: list[Cell] = json.loads(path.read_text(encoding="utf-8"))["cells"] if path.exists() else []
    specs = parse_methods(methods.split(","))
    for warning in check_methods(specs, scene, device):
        print(f"warning: {warning}")
    fields = prepare(testset_sources(scene, device, count, which), scene, TEST_PHOTONS, NOISE_STD, images, device)
    warm_up(scene, device)
    for field in fields:
        for spec in specs:
            if missing(cells, identity(spec, field, which, device)):
                cells.append(cell_of(spec, field, which, scene, device))
                write_json(path, {"scene": scene.model_dump(mode="json"), "cells": cells})
                print(f"{field.name:<10} {spec.label:<32} {cells[-1]['rmse_um']:9.2f} um", flush=True)
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--json", type=Path, default=Path(__file__).with_name("release.json"))
    parser.add_argument("--images", type=Path, help="where images are kept; a temporary folder if left out")
    parser.add_argument("--which", choices=[*COUNTS], default="test")
    parser.add_argument("--fields", type=int)
    parser.add_argument("--methods", default=METHODS)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        images = arguments.images or Path(temporary)
        images.mkdir(exist_ok=True)
        scene = Scene()
        cells = run(
            arguments.json, arguments.which, arguments.fields, arguments.methods, scene, arguments.device, images
        )
    print("\n".join(summary(cells)))


if __name__ == "__main__":
    main()
