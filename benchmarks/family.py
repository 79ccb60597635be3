"""``direct`` on benches of the family that no training saw: how far off, and how often within its uncertainty.

    python -m benchmarks.family [--device cuda] [--count 20] [--told exact|nearly|nominal] [--json FILE]

Benches and prints are drawn from ``configs/family.yaml`` with a seed of their own, images from other light paths than
any training's, through cameras as in training. The scene is told as it is, or nearly: with normal errors of what a
calliper leaves (``training.told``), and without Fresnel's losses. One JSON line a bench; last the means, and the factor
by which uncertainties would have to grow for 68.3 % of all points to lie within one.
"""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from data_gen.bench_ranges import bench_scene, nominal_lamp_rad
from data_gen.dataset_config import DatasetConfig
from nets.reconstruct.methods import create
from nets.told import light_of
from nets.training.bench_stream import BenchStream
from nets.training.camera import draw_cameras, seen
from nets.training.config import RunConfig, default_run
from nets.training.keys import fresh_dataset
from nets.training.told_config import ToldConfig
from warp_caustics.errors import MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SEED = 880_023
PHOTONS = 3_000_000
FAMILY = Path(__file__).parents[1] / "configs" / "family.yaml"


def family_run() -> RunConfig:
    """The training's configuration, with a seed that no training has."""
    tree, family = default_run("direct"), yaml.safe_load(FAMILY.read_text(encoding="utf-8"))
    tree["network"]["backbone"] |= family["network"]["backbone"]
    tree["training"] |= family["training"]
    tree["training"]["validation"] = tree["training"]["validation"] | {"seed": SEED}
    return RunConfig.model_validate(tree)


def nearly(scene: Scene, nominal: Scene, generator: np.random.Generator) -> Scene:
    """A scene as somebody tells it who measured it with a calliper."""
    errors, normal = ToldConfig(), generator.standard_normal(8).tolist()
    (light_x, light_y), divergence = light_of(scene)
    is_point = divergence > 0
    return bench_scene(
        nominal,
        gap_m=max(0.0, -scene.screen_position_m[2] + errors.gap_m * normal[0]),
        base_thickness_m=scene.base_thickness_m + errors.base_m * normal[1],
        index_offset=scene.index_offset + errors.index * normal[2],
        dispersion_scale=scene.dispersion_scale * (1 + errors.dispersion * normal[3]),
        is_point_source=float(is_point),
        lamp_distance_m=(1 + errors.lamp_distance * normal[4]) / divergence if is_point else 0.0,
        lamp_half_angle_rad=nominal_lamp_rad(scene) * max(0.0, 1 + errors.lamp_angle * normal[5]),
        tilt_x_rad=math.atan(light_x) + errors.tilt_rad * normal[6],
        tilt_y_rad=math.atan(light_y) + errors.tilt_rad * normal[7],
        fresnel=0.0,
    )


def images(config: RunConfig, dataset: DatasetConfig, count: int, device: str) -> list[tuple[Scene, Any, Any]]:
    """Scene, image [n_w, m, m] and true heights [n, n] of each bench."""
    stream = BenchStream(dataset, torch.device(device))
    plates = stream(range(count))
    stream.close()
    camera_options, flat = (
        config.training.camera,
        torch.tensor(config.scene.radiosity_W_m2, device=device)[:, None, None],
    )
    found = []
    for number, (scene, heights) in enumerate(zip(plates.scenes, plates.heights, strict=True)):
        simulator = CausticSimulator(
            scene, n_photons=PHOTONS, placement="stratified", smoothing=5.0, seed=number, device=device
        )
        image = simulator(heights)[None]
        if camera_options is not None:
            generator = torch.Generator(device).manual_seed(SEED + number)
            cameras = draw_cameras(camera_options, 1, image.shape[1], generator)
            image = seen(image, flat, cameras, generator)
        found.append((scene, image[0].cpu().numpy(), heights.double().cpu().numpy()))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--told", choices=("exact", "nearly", "nominal"), default="exact")
    parser.add_argument("--weights", help="in place of the shipped ones")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    config = family_run()
    options = {} if arguments.weights is None else {"weights": arguments.weights}
    rows, ratios = [], []
    cases = images(config, fresh_dataset(config, is_validation=True), arguments.count, arguments.device)
    for number, (scene, image, truth) in enumerate(cases):
        told = config.scene
        if arguments.told != "nominal":
            told = scene if arguments.told == "exact" else nearly(scene, told, np.random.default_rng([SEED, number]))
        try:
            method = create("direct", told, device=arguments.device, **options)
        except MismatchError:  # told a little beyond the family
            method = create("direct", scene, device=arguments.device, **options)
        result = method.reconstruct(CausticImage(image))
        if result.uncertainty_m is None:
            raise SystemExit("these weights tell no uncertainty; give others as --weights")
        error = np.abs(result.heights_m - truth)
        ratio = error / np.maximum(result.uncertainty_m, 1e-9)
        ratios.append(ratio)
        row = {
            "bench": number,
            "rmse_um": 1e6 * float(np.sqrt((error**2).mean())),
            "flat_um": 1e6 * float(np.sqrt((truth**2).mean())),
            "within_one": float((ratio <= 1).mean()),
            "within_two": float((ratio <= 2).mean()),
            "network": result.settings["network"]["file"],
            "trust": result.trust.line if result.trust else None,
        }
        print(json.dumps(row), flush=True)
        rows.append(row)
    mean = {
        key: float(np.mean([row[key] for row in rows])) for key in ("rmse_um", "flat_um", "within_one", "within_two")
    }
    mean["median_um"] = float(np.median([row["rmse_um"] for row in rows]))
    mean["factor"] = float(np.quantile(np.concatenate([r.ravel() for r in ratios]), 0.683))
    print(json.dumps(mean))
    if arguments.json:
        arguments.json.write_text(json.dumps({"told": arguments.told, "rows": rows, "mean": mean}, indent=1) + "\n")


if __name__ == "__main__":
    main()
