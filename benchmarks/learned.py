"""How exact the learned methods are, and how robust: prints tables, keeps every figure in a file.

Ten test fields of Tab. 3 (`data_gen.testset`), or as many fields of an own seed that nothing was trained on. Every cell
is the relief RMSE of one field in um, nothing removed. Cells that the file already holds for the same weights, code
version and field are not computed again.

    python -m benchmarks.learned noise     [--device cuda] [--json FILE] [--fields 10] [--own SEED]
    python -m benchmarks.learned exposure
    python -m benchmarks.learned iterations [--iterations 10] [--nsfc UPDATER DENOISER] [--no-denoiser UPDATER]
                                            [--no-gradient UPDATER DENOISER]
    python -m benchmarks.learned time

`iterations` takes the shipped networks where no files are given.
"""

import argparse
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Images, Reliefs
from data_gen.testset import TEST_PHOTONS, field_heights, field_images, fields_config
from nets.reconstruct.methods import create
from nets.shipped import find_network
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.base import CausticImage, Reconstructor
from warp_caustics.scene import Scene

NOISE = (0.0, 0.005, 0.01, 0.02, 0.03)
"""Standard deviation of white noise, relative to the light of a flat plate; the photons' own 1.8 % come on top."""
EXPOSURE = (0.95, 0.98, 1.0, 1.02, 1.05)
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "once": ("direct", {"symmetries": False, "refine": False}),
    "symmetries": ("direct", {"refine": False}),
    "direct": ("direct", {}),
    "fibres": ("fibres", {}),
}
"""Method and options by name."""
UPDATERS: dict[str, dict[str, Any]] = {
    "full": {},
    "no denoiser": {"denoise": False},
    "no gradient": {"use_gradient": False},
}
"""Options of ``nsfc`` by name: the paper's method and its ablations."""


class Fields:
    """True reliefs and their images at any noise.

    Args:
        count: how many.
        own: seed of own fields; None takes the test fields.
        device: where to simulate.
    """

    def __init__(self, count: int, own: int | None, device: str):
        self.scene, self.count, self.own, self.device = Scene(), count, own, device
        self._images: dict[float, np.ndarray] = {}
        if own is None:
            self.heights = field_heights(self.scene, device)[:count].astype(np.float64)
            return
        tree = fields_config(self.scene).model_dump() | {"role": "data", "seed": own, "n_samples": count}
        reliefs = Reliefs(DatasetConfig.model_validate(tree), device)
        heights = reliefs.true(range(count))
        images = Images(self.scene, TEST_PHOTONS, reliefs.fingerprint, "clean", device)
        self.heights = heights.double().cpu().numpy()
        self._clean = images(heights, range(count)).cpu().numpy()

    def image(self, field: int, noise: float) -> CausticImage:
        """Image of a field [W/m^2] with its noise told, as a capture tells it."""
        if noise not in self._images:
            if self.own is None:
                images = field_images(self.scene, self.device, noise_std=noise, fields=self.count)
            else:
                rng = np.random.default_rng(5)
                images = self._clean + noise * rng.standard_normal(self._clean.shape, np.float32)
            self._images[noise] = images
        return CausticImage(self._images[noise][field], np.full(3, np.hypot(noise, 0.018)))


def rmse_um(heights: np.ndarray, true: np.ndarray, scene: Scene) -> float:
    """Root mean square difference [um]."""
    return float(height_errors(heights, true, scene.plate_size_m)["rmse_um"])


class Cells:
    """Figures kept in a JSON file, so that a long run can be cut and continued."""

    def __init__(self, path: Path | None):
        self.path = path
        self.held: dict[str, Any] = json.loads(path.read_text()) if path is not None and path.exists() else {}

    def get(self, key: str, compute: Any) -> Any:
        """The cell's value, computed if it is not held."""
        if key not in self.held:
            self.held[key] = compute()
            self.save()
        return self.held[key]

    def save(self) -> None:
        """Write the file, if there is one."""
        if self.path is not None:
            self.path.write_text(json.dumps(self.held, indent=1, sort_keys=True) + "\n")


def made(variant: str, fields: Fields) -> Reconstructor:
    """The method of a variant."""
    method, options = VARIANTS[variant]
    return create(method, fields.scene, device=fields.device, **options)


def rows(fields: Fields, cells: Cells, conditions: Mapping[str, tuple[float, float]], variants: list[str]) -> None:
    """Table of conditions (noise, exposure) against variants of learned methods: mean / median RMSE [um]."""
    methods = {name: made(name, fields) for name in variants}
    weights = find_network("direct", fields.scene).info.content_hash.rpartition(":")[2][:8]
    print(f"{'mean / median [um]':<22}" + "".join(f"{name:>18}" for name in variants))
    for condition, (noise, exposure) in conditions.items():
        texts = []
        for name, method in methods.items():

            def run(field: int, method: Any = method, noise: float = noise, exposure: float = exposure) -> float:
                image = fields.image(field, noise)
                seen = CausticImage((image.irradiance * exposure).astype(np.float32), image.noise_std)
                return rmse_um(method.reconstruct(seen).heights_m, fields.heights[field], fields.scene)

            where = f"{weights}/{fields.device}/{fields.own}/{name}/noise {noise}/exposure {exposure}"
            found = [cells.get(f"{where}/{field}", lambda field=field: run(field)) for field in range(fields.count)]
            texts.append(f"{np.mean(found):9.1f} /{np.median(found):6.1f}")
        print(f"{condition:<22}" + "".join(f"{text:>18}" for text in texts), flush=True)


def iterations(fields: Fields, updaters: Mapping[str, dict[str, Any]], count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Error [um] of every method at every iteration, shape [field, count + 1]."""
    for name, options in updaters.items():
        method = create("nsfc", fields.scene, device=fields.device, keep_iterates=True, max_iterations=count, **options)
        errors = []
        for field in range(fields.count):
            result = method.reconstruct(fields.image(field, 0.01))
            assert result.iterates_m is not None  # they were asked for
            errors.append([rmse_um(step, fields.heights[field], fields.scene) for step in result.iterates_m])
        yield name, np.array(errors)


def times(fields: Fields, variants: list[str]) -> None:
    """Wall time per image, everything loaded, the first image left out."""
    for name in variants:
        started = time.perf_counter()
        method = made(name, fields)
        method.reconstruct(fields.image(0, 0.01))
        first, seconds = time.perf_counter() - started, []
        for field in range(fields.count):
            started = time.perf_counter()
            method.reconstruct(fields.image(field, 0.01))
            seconds.append(time.perf_counter() - started)
        print(
            f"{name:<12} {1e3 * np.median(seconds):8.1f} ms per image, first one with loading {first:.1f} s", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("noise", "exposure", "iterations", "time"))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fields", type=int, default=10)
    parser.add_argument("--own", type=int, metavar="SEED", help="own fields of this seed in place of the test fields")
    parser.add_argument("--json", type=Path, help="file of cells, read and continued")
    parser.add_argument("--levels", help="noise or exposure factors in place of the usual ones, e.g. 0.01,0.03")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    parser.add_argument("--nsfc", nargs=2, metavar=("UPDATER", "DENOISER"))
    parser.add_argument("--no-denoiser", metavar="UPDATER")
    parser.add_argument("--no-gradient", nargs=2, metavar=("UPDATER", "DENOISER"))
    parser.add_argument("--iterations", type=int, default=10)
    arguments = parser.parse_args()
    torch.manual_seed(0)
    fields = Fields(arguments.fields, arguments.own, arguments.device)
    cells = Cells(arguments.json)
    variants = arguments.variants.split(",")
    levels = None if arguments.levels is None else tuple(float(level) for level in arguments.levels.split(","))
    if arguments.what == "noise":
        rows(fields, cells, {f"noise {noise:.1%}": (noise, 1.0) for noise in levels or NOISE}, variants)
    elif arguments.what == "exposure":
        rows(fields, cells, {f"exposure {factor - 1:+.0%}": (0.01, factor) for factor in levels or EXPOSURE}, variants)
    elif arguments.what == "time":
        times(fields, variants)
    else:
        updaters = {name: dict(options) for name, options in UPDATERS.items()}
        if arguments.nsfc:
            updaters["full"] |= {"weights": arguments.nsfc[0], "denoiser_weights": arguments.nsfc[1]}
        if arguments.no_denoiser:
            updaters["no denoiser"] |= {"weights": arguments.no_denoiser}
        if arguments.no_gradient:
            weights, denoiser = arguments.no_gradient
            updaters["no gradient"] |= {"weights": weights, "denoiser_weights": denoiser}
        print(f"{'mean error [um] after':<22}" + "".join(f"{k:>7}" for k in range(arguments.iterations + 1)))
        for name, errors in iterations(fields, updaters, arguments.iterations):
            cells.get(f"iterations/{name}", lambda errors=errors: errors.tolist())
            print(f"{name:<22}" + "".join(f"{error:7.1f}" for error in errors.mean(0)), flush=True)


if __name__ == "__main__":
    main()
