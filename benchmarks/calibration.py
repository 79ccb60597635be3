"""Calibration on simulated lab benches: what is found against what is true, and how often sigma covers it.

    python -m benchmarks.calibration --benches 8 --output benchmarks/calibration.json

Each bench is drawn around its nominal set-up, and photographed three times with other photons than the calibration's
(stratified,
their own seeds and number), through the camera's sensor: a print that misses its design, a lens, and a flat plate
without flat
frame. Nothing is turned, for turned pictures take several times as long. Files are written and read as nsfc does it.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warp_caustics.calibration.calibrate import calibrate, usual_free
from warp_caustics.calibration.found import Calibration
from warp_caustics.calibration.plates import DESIGN, TOLERANCES, KnownPlate, flat_plate, lens
from warp_caustics.calibration.view import View
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.files import photograph_files, write_photographs
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.parameters import camera_parameters
from warp_caustics.camera.photographs import photographs
from warp_caustics.capture.read import read_capture
from warp_caustics.capture.settings import CaptureSettings
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_values, with_optical_values
from warp_caustics.simulator import CausticSimulator

PIXELS, LIGHT_PIXELS, SAMPLES = 128, 192, 64
KINDS: dict[str, dict[str, Any]] = {
    "careful": {
        "gap_m": 1e-5, "base_thickness_m": 5e-6, "index_offset": 2e-4, "tilt": 5e-4, "lamp": (1e-3, 3e-3),
        "psf": (0.3, 0.5), "ambient": (0.0, 0.006), "shift": 0.1, "turn": 3e-4, "colours": 0.02,
        "sensor": {"full_well_electrons": 25000, "photo_frames": 16, "exposure": 0.05},
    },
    "ordinary": {
        "gap_m": 5e-5, "base_thickness_m": 2e-5, "index_offset": 7e-4, "tilt": 3e-3, "lamp": (4e-3, 1e-2),
        "psf": (0.5, 0.9), "ambient": (0.0, 0.02), "shift": 0.5, "turn": 1e-3, "colours": 0.06,
        "sensor": {"full_well_electrons": 25000, "photo_frames": 4, "exposure": 0.05, "speckle_contrast": 0.02,
                   "dust_grains": 8, "hot_pixels": 40},
    },
    "poor": {
        "gap_m": 1.5e-4, "base_thickness_m": 5e-5, "index_offset": 1.5e-3, "tilt": 7e-3, "lamp": (8e-3, 1.8e-2),
        "psf": (1.0, 1.4), "ambient": (0.01, 0.04), "shift": 3.0, "turn": 3e-3, "colours": 0.3,
        "sensor": {"full_well_electrons": 25000, "photo_frames": 1, "exposure": 0.05, "speckle_contrast": 0.05,
                   "dust_grains": 30, "hot_pixels": 300},
    },
    "near": {
        "gap_m": 5e-5, "base_thickness_m": 2e-5, "index_offset": 5e-4, "tilt": 3e-3, "lamp": (2e-3, 5e-3),
        "psf": (0.4, 0.7), "ambient": (0.0, 0.02), "shift": 0.5, "turn": 1e-3, "colours": 0.06,
        "sensor": {"full_well_electrons": 25000, "photo_frames": 4, "exposure": 0.05},
    },
}  # fmt: skip
"""Standard deviations of what nobody measured, ranges of what is blurred; a gap of 1 mm, a lamp far away or at 0.5
m."""


def nominal_scene(kind: str) -> Scene:
    """What is told."""
    own: dict[str, Any] = {"emission_half_angle_rad": 0.2, "light_position_m": (0, 0, 0.503), "lamp_radius_m": 1e-3}
    far = {"lamp_half_angle_rad": sum(KINDS[kind]["lamp"]) / 2}
    return Scene(
        height_samples=SAMPLES, image_pixels=PIXELS, screen_position_m=(0, 0, -1e-3), fresnel=True,
        **(own if kind == "near" else far),
    )  # fmt: skip


def priors(kind: str) -> dict[str, float]:
    """What is told about how well that is known."""
    k = KINDS[kind]
    found = {name: k[name] for name in ("gap_m", "base_thickness_m", "index_offset")}
    found |= {"shift_x_px": 2 * k["shift"], "shift_y_px": 2 * k["shift"]}
    if kind == "near":
        return found | {"lamp_x_m": 5e-3, "lamp_y_m": 5e-3, "lamp_distance_m": 0.05}
    return found | {"tilt_x_rad": k["tilt"], "tilt_y_rad": k["tilt"], "vergence_per_m": 0.2}


def true_bench(kind: str, seed: int) -> tuple[Scene, CameraConfig]:
    """A bench and its camera."""
    k, g, scene = KINDS[kind], np.random.default_rng(seed), nominal_scene(kind)
    values = optical_values(scene, scene)
    for name in ("gap_m", "base_thickness_m", "index_offset"):
        values[name] += g.normal(0, k[name])
    values["dispersion_scale"] += g.normal(0, 0.01)
    if kind == "near":
        values["lamp_x_m"], values["lamp_y_m"] = g.normal(0, 5e-3, 2)
        values["lamp_distance_m"] += g.normal(0, 0.05)
        values["lamp_radius_m"] = g.uniform(5e-4, 2e-3)
    else:
        values["tilt_x_rad"], values["tilt_y_rad"] = g.normal(0, k["tilt"], 2)
        values["vergence_per_m"] = abs(g.normal(0, 0.2))
        values["lamp_half_angle_rad"] = g.uniform(*k["lamp"])
    apart = g.normal(0, k["colours"], (3, 2))
    apart[1] = 0
    light = g.normal(0, 0.02, (3, 5))
    camera = CameraConfig(
        psf_px=tuple(g.uniform(*k["psf"]) * g.uniform(0.95, 1.05, 3)),
        ambient=tuple(g.uniform(*k["ambient"]) * np.ones(3)),
        shift_px=tuple(g.normal(0, k["shift"], 2)),
        turn_rad=0.0 * g.normal(),
        magnification=1 + g.normal(0, 1e-3),
        colour_shift_px=tuple(map(tuple, apart)),
        light=tuple(map(tuple, light)),
        sensor=k["sensor"],
    )
    return with_optical_values(scene, values), camera


def printed(seed: int) -> KnownPlate:
    """A design of twelve lines, 0.2 to 0.4 mm high."""
    g = np.random.default_rng(10_000 + seed)
    lines = [
        Line(tuple(ends[:2]), tuple(ends[2:]), g.uniform(3e-3, 5e-3), g.uniform(2e-4, 4e-4))
        for ends in g.uniform(-0.02, 0.02, (12, 4))
    ]

    def relief(factor: float, n: int, size: tuple[float, float]) -> np.ndarray:
        return line_relief([replace(line, width_m=line.width_m * factor) for line in lines], n, size)

    return KnownPlate(DESIGN, "print", lambda n, size: relief(1.0, n, size), TOLERANCES[DESIGN], relief)


def photographed(
    name: str, plate: KnownPlate, bench: tuple[Scene, CameraConfig], told: Scene, seed: int, folder: Path
) -> View:
    """A view from files, as nsfc capture reads them."""
    scene, config = bench
    # Light in other pixels than the camera's and the calibration's.
    fine = Scene.model_validate(scene.model_dump() | {"image_pixels": LIGHT_PIXELS})
    config = CameraConfig.model_validate(
        config.model_dump()
        | {"frame_px": (PIXELS, PIXELS), "magnification": config.magnification * PIXELS / LIGHT_PIXELS}
    )
    g = np.random.default_rng(20_000 + seed)
    heights, modes = plate.surface(scene)
    for p, mode in zip(plate.parameters, modes, strict=True):
        heights = heights + g.normal(0, p.prior) * mode
    light = CausticSimulator(fine, n_photons=(11 * PIXELS) ** 2, placement="stratified", seed=seed)
    even = CausticSimulator(fine, n_photons=(6 * PIXELS) ** 2)
    camera = Camera(config, fine)
    flat = even(torch.zeros(SAMPLES, SAMPLES))
    frames = photographs(camera, light(heights.float()), flat, seed)
    files = photograph_files(folder / f"{name}.tif", camera)
    write_photographs(files, frames, camera)
    is_divided = plate.kind != "flat"
    settings = CaptureSettings(dark=str(files["dark"]), flat=str(files["flat"]) if is_divided else None)
    capture = read_capture(files["photo"], told, settings)
    return View(name, plate, capture.irradiance, capture.noise_std, capture.mask, is_divided)


def run(kind: str, seed: int, finest: int) -> dict[str, Any]:
    """One bench: found, true, and how sure."""
    bench, told = true_bench(kind, seed), nominal_scene(kind)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        plates = (("print", printed(seed)), ("lens", lens(0.0916, 0.04)), ("flat", flat_plate()))
        views = [
            photographed(name, plate, bench, told, 3 * seed + number, Path(folder))
            for number, (name, plate) in enumerate(plates)
        ]
    found: Calibration = calibrate(
        told,
        CameraConfig(psf_px=sum(KINDS[kind]["psf"]) / 2),
        views,
        free=[name for name in usual_free(told, CameraConfig(), views) if name != "turn_rad"],
        priors=priors(kind),
        finest=finest,
        photons=4 * finest,
    )
    scene, config = bench
    truth = found.setup.theta(scene, camera_parameters(config, 3, PIXELS, dtype=torch.float64)).tolist()
    return {
        "kind": kind,
        "seed": seed,
        "time_s": time.perf_counter() - start,
        "is_converged": found.is_converged,
        "misfit": [fit.misfit.tolist() for fit in found.fits],
        "explained": [fit.explained for fit in found.fits],
        "warnings": list(found.warnings),
        "parameters": [
            {
                "name": f.parameter.name, "before": f.before, "prior": f.parameter.prior, "true": true,
                "value": f.value, "sigma": f.sigma, "noise_sigma": f.noise_sigma, "verdict": f.verdict,
            }
            for f, true in zip(found.bench, truth, strict=True)
        ],
    }  # fmt: skip


def main() -> None:
    """Run all benches, one line each, and keep what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=8, help="of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--finest", type=int, default=64)
    parser.add_argument("--output", type=Path, default=Path("benchmarks/calibration.json"))
    options = parser.parse_args()
    records = []
    for seed in range(options.benches):
        for kind in options.kinds.split(","):
            records.append(run(kind, seed, options.finest))
            options.output.write_text(json.dumps(records, indent=1) + "\n")
            last = records[-1]
            within = np.mean([abs(p["value"] - p["true"]) < p["sigma"] for p in last["parameters"]])
            print(f"{kind} {seed}: {within:.2f} within sigma, {last['time_s']:.0f} s, {last['warnings']}", flush=True)


if __name__ == "__main__":
    main()
