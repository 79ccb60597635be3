"""How far ``direct`` is off when bench, camera or print are not what it expects, and whether it says so.

The development fields (`data_gen.testset`), or fields of an own seed that nothing was trained on, each seen under every
condition of `data_gen.suites.conditions`; all that is random is fixed per field, so that conditions and weights can be
compared. Errors are the relief RMSE in um, nothing removed. Fields that the file already holds for the same weights,
device and options are not computed again.

    python -m benchmarks.robustness [--device cuda] [--fields N] [--own SEED] [--conditions ideal,apart-0.1,...]
                                    [--variants once,symmetries,direct] [--weights FILE] [--json FILE]
                                    [--set key=value ...] [--photons 16000000] [--calibrate]

Columns: mean / median RMSE of each variant; then, of the last variant that tells an uncertainty, the share of points
within one and two standard uncertainties (mean over fields); then of the last variant the number of fields with any
warning, with a refinement that was kept, and the mean residual. Rows "aligned": after the result was moved sideways to
fit best, for images that are displaced as a whole. Rows "no mean": without the mean error.

`--calibrate` runs `direct` alone and fits the standard uncertainty to the spread over all conditions (`spread_fit`);
what it needs is kept beside the JSON file, in an .npz file, by every run.
"""

import argparse
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import yaml

from benchmarks.learned import VARIANTS, Cells
from benchmarks.spread_fit import Kept, print_fits
from data_gen.dataset_config import DatasetConfig, sample_generator, sample_seed
from data_gen.patterns import draw_strokes
from data_gen.suites.conditions import CONDITIONS, Condition, seen
from data_gen.suites.odd_prints import printed
from data_gen.testset import DEVELOPMENT_FIELDS, TEST_PHOTONS, fields_config
from nets.evaluation.alignment import aligned_rmse_um
from nets.reconstruct.methods import create
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from nets.shipped import find_network
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.base import CausticImage, Reconstructor
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

ImageArray = npt.NDArray[np.float32]

PHOTON_NOISE = 0.018
"""Of the test photons behind a flat plate, relative; fewer photons leave more than is told."""
THREADS = 8
"""That prepare images; numpy and scipy leave the interpreter's lock."""
NAMED_ONLY = ("opposite-0.1", "opposite-0.3")
"""The worst directions of ``apart``, for comparison with figures of others; left out of a run of all conditions."""


class Fields:
    """Strokes of fields, and their prints and images under any condition.

    Args:
        count: how many.
        own: seed of own fields; None takes the development fields.
        photons: per wavelength.
        device: where to simulate.
    """

    def __init__(self, count: int, own: int | None, photons: int, device: str):
        self.scene, self.count, self.device = Scene(), count, device
        config = fields_config(self.scene)
        if own is None and count > config.n_samples:
            raise SystemExit(f"there are {config.n_samples} development fields; --own SEED gives any number")
        if own is not None:
            tree = config.model_dump() | {"role": "data", "seed": own, "n_samples": count}
            config = DatasetConfig.model_validate(tree)
        self.pattern, self.fingerprint = config.reliefs, config.sample_fingerprint()
        self.strokes = [draw_strokes(self.pattern, self._rng("relief", field)) for field in range(count)]
        # Towards which a field's channels move, then towards which its light grows.
        n_w = self.scene.n_wavelengths
        self.angles = [self._rng("robustness", field).uniform(0, 2 * np.pi, n_w + 1) for field in range(count)]
        self.photons = TEST_PHOTONS.model_copy(update={"n_photons": photons}).record()
        self.simulator = CausticSimulator(self.scene, device=device, **self.photons)
        self._heights: dict[str, FloatArray] = {}
        self._clean: dict[tuple[str, int], ImageArray] = {}
        self._moved: dict[tuple[str, int, int, float, float], ImageArray] = {}
        self._white: dict[int, ImageArray] = {}

    def _rng(self, purpose: str, field: int) -> np.random.Generator:
        return sample_generator(self.fingerprint, purpose, field)

    def heights(self, relief: str) -> FloatArray:
        """True reliefs [m], shape [count, n, n]."""
        if relief not in self._heights:
            self._heights[relief] = printed(relief, self.strokes, self.scene, self.pattern, self.device)
        return self._heights[relief]

    def images(self, condition: Condition, which: list[int]) -> list[CausticImage]:
        """What is measured of some fields, with its noise told, as a capture tells it."""
        simulated = [self._simulated(condition, field) for field in which]
        told = np.full(self.scene.n_wavelengths, np.hypot(condition.noise, PHOTON_NOISE))

        def measured(image: ImageArray, field: int) -> CausticImage:
            return CausticImage(seen(image, condition, self.angles[field][-1], self._noise(field)), told)

        with ThreadPoolExecutor(min(THREADS, os.cpu_count() or 1)) as pool:
            return list(pool.map(measured, simulated, which))

    def _noise(self, field: int) -> ImageArray:
        """Standard normal numbers of a field, those of the test set, shape [n_w, m, m]."""
        if field not in self._white:
            shape = self.scene.n_wavelengths, self.scene.image_pixels, self.scene.image_pixels
            self._white[field] = self._rng("noise", field).standard_normal(shape).astype(np.float32)
        return self._white[field]

    def _simulated(self, condition: Condition, field: int) -> ImageArray:
        """Relative irradiance with the channels where they are, shape [n_w, m, m]; kept."""
        key = condition.relief, field
        if key not in self._clean:
            self._clean[key] = self._shot(self.simulator, condition.relief, field)
        if not condition.apart_px:
            return self._clean[key]
        image = self._clean[key].copy()
        angles = self.angles[field]
        for channel in condition.moved:
            is_turned = condition.is_opposite and channel == condition.moved[-1]
            angle = float(angles[condition.moved[0]] + np.pi if is_turned else angles[channel])
            at = (*key, channel, condition.apart_px, angle)
            if at not in self._moved:
                self._moved[at] = self.moved(*at)
            image[channel] = self._moved[at]
        return image

    def moved(self, relief: str, field: int, channel: int, apart_px: float, angle: float) -> ImageArray:
        """One channel on a screen that is moved sideways [px, rad], so that nothing is resampled; shape [m, m]."""
        x, y, z = self.scene.screen_position_m
        size_x, size_y = self.scene.pixel_size_m
        screen = (x + apart_px * np.cos(angle) * size_x, y + apart_px * np.sin(angle) * size_y, z)
        alone = {"wavelengths_m": (self.scene.wavelengths_m[channel],), "radiosity_W_m2": (1.0,)}
        scene = self.scene.model_copy(update={**alone, "screen_position_m": tuple(map(float, screen))})
        channels = self._shot(CausticSimulator(scene, device=self.device, **self.photons), relief, field)
        return np.asarray(channels[0])

    def _shot(self, simulator: CausticSimulator, relief: str, field: int) -> ImageArray:
        """Image of a field, always from the same photons."""
        simulator.reseed(sample_seed(self.fingerprint, "photons/test", field))
        heights = torch.tensor(self.heights(relief)[field], dtype=torch.float32, device=simulator.device)
        return np.asarray(simulator(heights).cpu())


def judged(
    method: Reconstructor, image: CausticImage, true: FloatArray, condition: Condition, scene: Scene
) -> tuple[dict[str, Any], FloatArray, FloatArray | None]:
    """Figures of one reconstruction; its error [m]; its spread [m], None where a method tells no uncertainty."""
    result = method.reconstruct(image)
    heights = result.heights_m.astype(np.float64)
    errors, error = height_errors(heights, true, scene.plate_size_m), heights - true
    found: dict[str, Any] = {
        "rmse_um": round(errors["rmse_um"], 4),
        "rmse_mean_removed_um": round(errors["rmse_mean_removed_um"], 4),
        "residual": round(result.residual, 5),
        "refinement": result.counters["refinement"],
        "warnings": list(result.warnings),
    }
    if condition.is_displaced:
        found["rmse_aligned_um"] = round(aligned_rmse_um(heights, true), 4)
    if result.uncertainty_m is None:
        return found, error, None
    uncertainty = result.uncertainty_m.astype(np.float64)
    for name, factor in (("within_one", 1), ("within_two", 2)):
        found[name] = round(float(np.mean(np.abs(error) <= factor * uncertainty)), 4)
    return found, error, uncertainty / DIRECT_CALIBRATION.scale


class Run:
    """Variants of ``direct`` over fields under conditions, with what is known already.

    Args:
        fields: to be reconstructed.
        variants: names in ``learned.VARIANTS``.
        options: of ``direct``; a variant's own win.
        cells: figures known.
        kept: spreads known.
        where: what the figures depend on besides, for their keys.
    """

    def __init__(
        self, fields: Fields, variants: list[str], options: dict[str, Any], cells: Cells, kept: Kept, where: str
    ):
        self.fields, self.variants, self.cells, self.kept, self.where = fields, variants, cells, kept, where
        self._options = {name: options | VARIANTS[name][1] for name in variants}
        self._methods: dict[str, Reconstructor] = {}

    def key(self, variant: str, condition: str) -> str:
        """Of figures and spreads."""
        return f"robustness/{self.where}/{variant}/{condition}"

    def __call__(self, name: str) -> dict[str, list[dict[str, Any]]]:
        """Figures of each variant and field under a condition."""
        condition = CONDITIONS[name]
        missing = {variant: self._missing(variant, name) for variant in self.variants}
        which = sorted(set().union(*missing.values()))
        images = dict(zip(which, self.fields.images(condition, which), strict=True)) if which else {}
        for variant, fields in missing.items():
            if not fields:
                continue
            key = self.key(variant, name)
            for field in fields:
                true = self.fields.heights(condition.relief)[field]
                found, error, spread = judged(self._method(variant), images[field], true, condition, self.fields.scene)
                if spread is not None:
                    self.kept.add(f"{key}/{field}", error, spread, field)
                self.cells.held.setdefault(key, {})[str(field)] = found
        if which:
            self.kept.save()
            self.cells.save()
        return {
            variant: [self.cells.held[self.key(variant, name)][str(field)] for field in range(self.fields.count)]
            for variant in self.variants
        }

    def _missing(self, variant: str, condition: str) -> list[int]:
        key = self.key(variant, condition)
        held = self.cells.held.get(key, {})

        def is_held(field: int) -> bool:
            found = held.get(str(field))
            return found is not None and ("within_one" not in found or self.kept.has(f"{key}/{field}"))

        return [field for field in range(self.fields.count) if not is_held(field)]

    def _method(self, variant: str) -> Reconstructor:
        if variant not in self._methods:
            options = self._options[variant]
            spread_alone = {"bench_uncertainty": False, "causes": False}
            self._methods[variant] = create(
                "direct", self.fields.scene, device=self.fields.device, **(spread_alone | options)
            )
        return self._methods[variant]


def header(variants: list[str]) -> str:
    return (
        f"{'mean / median [um]':<22}"
        + "".join(f"{name:>18}" for name in variants)
        + (f"{'within 1 / 2 u':>16}{'warned':>8}{'kept':>6}{'residual':>10}")
    )


def lines(name: str, figures: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Rows of the table for one condition."""

    def errors(which: str) -> str:
        columns = ([found[which] for found in fields] for fields in figures.values())
        return "".join(f"{np.mean(values):10.1f} /{np.median(values):6.1f}" for values in columns)

    last = list(figures.values())[-1]
    telling = [fields for fields in figures.values() if all("within_one" in found for found in fields)]
    shares = "-"
    if telling:
        one, two = (np.mean([found[which] for found in telling[-1]]) for which in ("within_one", "within_two"))
        shares = f"{one:.2f} / {two:.2f}"
    warned = sum(bool(found["warnings"]) for found in last)
    kept = sum(found["refinement"] == "kept" for found in last)
    residual = np.mean([found["residual"] for found in last])
    rows = [f"{name:<22}{errors('rmse_um')}{shares:>16}{warned:>8}{kept:>6}{residual:>10.4f}"]
    if CONDITIONS[name].is_displaced:
        rows.append(f"{name + ' aligned':<22}{errors('rmse_aligned_um')}")
    if CONDITIONS[name].is_bowed:
        rows.append(f"{name + ' no mean':<22}{errors('rmse_mean_removed_um')}")
    return rows


def chosen(names: str | None) -> Sequence[str]:
    """Names of conditions, from a list with commas; all but ``NAMED_ONLY`` if None."""
    wished = [name for name in CONDITIONS if name not in NAMED_ONLY] if names is None else names.split(",")
    unknown = [name for name in wished if name not in CONDITIONS]
    if unknown:
        raise SystemExit(f"no such condition: {', '.join(unknown)}; there are {', '.join(CONDITIONS)}")
    return wished


def options_of(settings: list[str]) -> dict[str, Any]:
    """Options from ``key=value`` texts."""
    pairs = [text.partition("=") for text in settings]
    if bad := [key for key, sign, _ in pairs if not sign]:
        raise SystemExit(f"--set takes key=value, got {', '.join(bad)}")
    return {key: yaml.safe_load(value) for key, _, value in pairs}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fields", type=int, default=DEVELOPMENT_FIELDS)
    parser.add_argument(
        "--own", type=int, metavar="SEED", help="own fields of this seed in place of the development fields"
    )
    parser.add_argument("--conditions", help=f"of {', '.join(CONDITIONS)}; {', '.join(NAMED_ONLY)} only if named")
    known = [name for name, (method, _) in VARIANTS.items() if method == "direct"]
    parser.add_argument("--variants", help=f"of {', '.join(known)}; all if left out")
    parser.add_argument("--weights", type=Path, help="of the network, in place of the shipped ones")
    parser.add_argument("--json", type=Path, help="file of figures, read and continued")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="option of direct")
    parser.add_argument("--photons", type=int, default=TEST_PHOTONS.n_photons, help="per wavelength; fewer to try")
    parser.add_argument("--calibrate", action="store_true", help="fit the standard uncertainty to the spread")
    arguments = parser.parse_args()
    conditions, options = chosen(arguments.conditions), options_of(arguments.set)
    variants = ["direct"] if arguments.calibrate else (arguments.variants or ",".join(known)).split(",")
    if unknown := set(variants) - set(known):
        raise SystemExit(f"no such variant: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    if arguments.weights is not None:
        options["weights"] = str(arguments.weights)
    torch.manual_seed(0)
    started = time.perf_counter()
    fields = Fields(arguments.fields, arguments.own, arguments.photons, arguments.device)
    network = find_network("direct", fields.scene, path=options.get("weights"))
    told = ",".join(f"{key}={value}" for key, value in sorted(options.items()) if key != "weights")
    weights = network.info.content_hash.rpartition(":")[2][:8]
    where = "/".join((weights, arguments.device, str(arguments.own), str(arguments.photons), told or "default"))
    kept = Kept(None if arguments.json is None else arguments.json.with_suffix(".npz"))
    run = Run(fields, variants, options, Cells(arguments.json), kept, where)
    print(header(variants))
    for name in conditions:
        print("\n".join(lines(name, run(name))), flush=True)
    if arguments.calibrate:
        keys = {name: [f"{run.key('direct', name)}/{k}" for k in range(fields.count)] for name in conditions}
        print_fits(kept, keys, DIRECT_CALIBRATION.scale)
    print(f"\n{fields.count} fields, weights {weights}, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
