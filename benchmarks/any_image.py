"""What other pixels, samples, plates and wavelengths than the network's own cost ``direct``, or another method.

Own plates of Tab. 3 (a seed of their own, role "data": nothing was trained on them), each as a print of 128 samples
under 9 photons per pixel on a lattice, and 1 % of white noise in every pixel of the user's. Truth on another grid is
the mean over its cells. "scaled" plates are Tab. 3 with all lengths multiplied; "in mm" has Tab. 3's widths and heights
on a plate and base of another size.

    python -m benchmarks.any_image [--device cuda] [--plates 6] [--cases default,1024px,...] [--weights FILE]
                                   [--force] [--json FILE] [--method direct]

Columns: mean / median relief RMSE in um of eight symmetries and of the method, that of a flat guess, share of points
within one standard uncertainty, seconds of the method. `--force` uses a network where it would refuse; methods other
than `direct` have no column of symmetries.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import nets.fitting_network
from data_gen.config import ReliefConfig
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.samples import Reliefs
from nets.reconstruct.methods import create
from nets.reconstruct.refinement import Refinement
from nets.seen_scene import scaled
from warp_caustics.errors import MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.resampling import regridded
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

SEED = 901_001
NOISE = 0.01
PHOTONS_PER_PIXEL = 9
PRINTED_SAMPLES = 128
ONE = {"wavelengths_m": (530e-9,), "radiosity_W_m2": (1.0,)}
TWO = {"wavelengths_m": (610e-9, 430e-9), "radiosity_W_m2": (1.0, 1.0)}
CASES: dict[str, tuple[float, bool, dict[str, Any]]] = {
    "default": (1.0, True, {}),
    "1024px": (1.0, True, {"image_pixels": 1024}),
    "700px": (1.0, True, {"image_pixels": 700}),
    "256px": (1.0, True, {"image_pixels": 256}),
    "64samples": (1.0, True, {"height_samples": 64}),
    "256samples": (1.0, True, {"height_samples": 256}),
    "30mm-scaled": (0.6, True, {}),
    "30mm-64-256": (0.6, True, {"height_samples": 64, "image_pixels": 256}),
    "30mm-in-mm": (0.6, False, {}),
    "20mm-in-mm": (0.4, False, {}),
    "80mm-in-mm": (1.6, False, {}),
    "100mm-in-mm": (2.0, False, {}),
    "1-wavelength": (1.0, True, ONE),
    "2-wavelengths": (1.0, True, TWO),
}
"""Size of the plate over 50 mm, whether prints are scaled with it, and what else differs. Bases are scaled always."""


def pattern(size: float, is_scaled: bool) -> ReliefConfig:
    """Tab. 3 on a plate of another size."""
    usual = ReliefConfig()
    keys = ("line_start_m", "line_end_m") + (("line_width_m", "line_height_m") if is_scaled else ())
    changes: dict[str, Any] = {key: tuple(size * bound for bound in getattr(usual, key)) for key in keys}
    changes["smallest_width_m"] = usual.smallest_width_m * (size if is_scaled else 1.0)
    return usual.model_copy(update=changes)


def plate(case: str, number: int, device: str) -> tuple[CausticImage, FloatArray]:
    """Image and true heights [m] of a case."""
    size, is_scaled, _ = CASES[case]
    scene = user_scene(case)
    printed = scene.model_copy(update={"height_samples": PRINTED_SAMPLES})
    own = DatasetConfig(kind="updater", n_samples=1000, seed=SEED)
    config = own.model_copy(update={"scene": printed, "reliefs": pattern(size, is_scaled)})
    relief = Reliefs(config, device, own.sample_fingerprint()).true([number])[0]
    photons = PHOTONS_PER_PIXEL * scene.image_pixels**2
    image = CausticSimulator(printed, "lattice", n_photons=photons, device=device)(relief).cpu().numpy()
    white = sample_generator(own.sample_fingerprint(), "noise", number).standard_normal(image.shape)
    measured = CausticImage(image + NOISE * white.astype(np.float32), np.full(len(image), NOISE))
    return measured, regridded(relief.double().cpu(), scene.height_samples).numpy()


def user_scene(case: str) -> Scene:
    """The scene of a case, told as it is."""
    size, _, changes = CASES[case]
    return scaled(Scene(), size).model_copy(update=changes)


class Watched:
    """A refinement that remembers where it started: at the mean of the symmetries."""

    def __init__(self, refinement: Refinement):
        self.refinement, self.pixels = refinement, refinement.pixels

    def __call__(self, resimulation: Any, heights: FloatArray, *others: Any) -> Any:
        self.start = heights
        return self.refinement(resimulation, heights, *others)


def measured(
    case: str, number: int, device: str, options: Mapping[str, Any], name: str = "direct"
) -> dict[str, float | None]:
    """Figures of a plate in a case.

    Args:
        case: of :data:`CASES`.
        number: of the plate.
        device: where to compute.
        options: of the method.
        name: of the method.

    Raises:
        MismatchError: the network does not serve it.
    """
    method = create(name, user_scene(case), device=device, **options)
    watched = None
    if name == "direct":
        watched = method.refinement = Watched(method.refinement)  # type: ignore[attr-defined]
    image, truth = plate(case, number, device)
    started = time.perf_counter()
    result = method.reconstruct(image)
    seconds = time.perf_counter() - started
    uncertainty = np.zeros_like(truth) if result.uncertainty_m is None else result.uncertainty_m
    return {
        "flat": _rmse_um(truth, 0.0),
        "symmetries": _of_start(watched, truth),
        name: _rmse_um(result.heights_m, truth),
        "within": float((np.abs(result.heights_m - truth) <= uncertainty).mean()),
        "seconds": seconds,
    }


def _of_start(watched: Watched | None, truth: FloatArray) -> float | None:
    """Of the mean of the symmetries; None where it was not watched."""
    return None if watched is None else _rmse_um(regridded(torch.as_tensor(watched.start), len(truth)).numpy(), truth)


def _rmse_um(heights: Any, truth: Any) -> float:
    return float(1e6 * np.sqrt(np.mean((heights - truth) ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--plates", type=int, default=6)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--weights", help="of the network, in place of the shipped ones")
    parser.add_argument("--force", action="store_true", help="use a network where it would refuse")
    parser.add_argument("--json", type=Path, help="file of figures, read and continued")
    parser.add_argument("--method", default="direct", help="direct, auto or fibres")
    arguments = parser.parse_args()
    if arguments.force:
        setattr(nets.fitting_network, "check_scene", lambda *_: ())  # noqa: B010
    options = {} if arguments.weights is None else {"weights": arguments.weights}
    known = json.loads(arguments.json.read_text()) if arguments.json and arguments.json.exists() else {}
    for case in arguments.cases.split(","):
        rows = known.setdefault(case, [])
        try:
            for number in range(len(rows), arguments.plates):
                rows.append(measured(case, number, arguments.device, options, arguments.method))
                if arguments.json:
                    arguments.json.write_text(json.dumps(known, indent=1) + "\n")
        except MismatchError as refusal:
            print(f"{case} | refused: {refusal}")
        else:
            print(line(case, rows[: arguments.plates], arguments.method), flush=True)


def line(case: str, rows: Sequence[Mapping[str, float | None]], name: str = "direct") -> str:
    """A row of the table."""
    found = {key: [row[key] for row in rows if row[key] is not None] for key in rows[0]}
    errors = [
        f"{np.mean(found[key]):.1f} / {np.median(found[key]):.1f}" if found[key] else "-"  # type: ignore[arg-type]
        for key in ("symmetries", name, "flat")
    ]
    shares = f"{np.mean(found['within']):.0%} | {np.mean(found['seconds']):.1f}"  # type: ignore[arg-type]
    return f"{case} | {' | '.join(errors)} | {shares}"


if __name__ == "__main__":
    main()
