"""The record of what lines, or a network's relief where these tell it no better, make of an image."""

import dataclasses
import math
from collections.abc import Collection
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from nets.reconstruct.fibres.bench.bench_and_light import Bench, as_measured, bench_warnings
from nets.reconstruct.fibres.bench.less_believed import CLEAN
from nets.reconstruct.fibres.bench.line_posterior import (
    JointCovariance,
    height_deviation,
    noise_covariance,
    with_line_samples,
)
from nets.reconstruct.fibres.image.discrepancy import is_explained
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.refined_lines import ImageRun, refined
from nets.reconstruct.fibres.shapes.curves_of_image import CurvesOnImage
from nets.reconstruct.fibres.shapes.curves_paths import paths_of
from nets.reconstruct.fibres.shapes.waves import WavyLines
from nets.reconstruct.fibres.trust.beliefs import (
    as_stated,
    left_open_by_hint,
    left_open_by_simulation,
    left_open_by_unclear_bench,
    times_less_known,
)
from nets.reconstruct.fibres.trust.stated_bench import stated_record
from nets.reconstruct.fibres.trust.uncertainty import BARE_M, calibration_of, of_lines
from nets.reconstruct.losses_of_light import effects_of
from nets.reconstruct.network_io import network_result
from warp_caustics.fold_fraction import crossing_samples
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.types import FloatArray


class Run(ImageRun, Protocol):
    """Lines of one image, found."""

    view: LinesView
    model: LineModel
    lines: torch.Tensor
    moves_section: bool
    covariance: JointCovariance | None
    asked: Collection[str]
    waves: WavyLines | None
    curves: CurvesOnImage | None
    bench: Bench
    numbers: BenchNumbers
    exposure: NDArray[np.float64]
    takes_lines: bool
    is_noise_left: bool
    hinted: float
    timings: dict[str, float]
    counters: dict[str, Any]

    def relief(self) -> FloatArray:
        """Of the lines, shape [n, n] [m]."""


def _is_by_noise(run: Run) -> bool:
    """Whether lines are as uncertain as steps by noise left them, each pixel by itself."""
    return run.covariance is not None and run.covariance.is_by_noise


def _covariance(run: Run) -> JointCovariance | None:
    """Of lines that are taken: with their bench where that was found with them, else what the image's noise leaves."""
    if not run.takes_lines:
        return None
    if run.covariance is not None:
        return as_stated(run.covariance, run.lines, run.view, run.numbers, run.asked, run.bench)
    if run.is_noise_left and run.curves is None and run.waves is None:
        return noise_covariance(run.view, run.lines, with_section=run.moves_section)
    return None


def _left_open_by_bench(run: Run, heights_m: FloatArray, left: float | None) -> FloatArray:
    """What a bench that was found, or not, leaves open of the heights besides its covariance [m], shape [n, n]."""
    numbers, scene = run.numbers, run.view.scene
    # Who says that the bench is exactly as told is not told otherwise by a hint.
    hinted = run.hinted if run.method.options.bench_uncertainty else 0.0
    unsure = left_open_by_hint(heights_m, scene, hinted)
    if _is_by_noise(run):
        unsure = np.hypot(unsure, left_open_by_simulation(heights_m, scene))
    if run.view is not run.told and left is not None and left > CLEAN:
        there = numbers.scene_of(run.bench.values)
        unsure = np.hypot(unsure, left_open_by_unclear_bench(heights_m, numbers.scene, there, left))
    return unsure


def result_of(run: Run) -> Reconstruction:
    """Lines if they explain the image better than the network's relief, else that relief, refined."""
    method, answer, timings, is_noise_left = run.method, run.answer, run.timings, run.is_noise_left
    heights, fibres, view, counters = answer.heights_m, None, run.told, dict(run.counters)
    found_at, covariance = None, _covariance(run)
    if run.takes_lines:
        view, fibres = run.view, None if run.curves is not None else run.lines.numpy()
        heights, counters["explained_by"] = run.relief(), "fibres"
    if method.options.refine and run.reason == "converged" and not is_noise_left:
        settled = refined(run, view, heights)
        heights, counters["refinement"], found_at = settled.heights, settled.outcome, settled.found_at
        timings["refinement"] = run.log.elapsed_s - sum(timings.values())
    counters["camera"] = view.resimulation.camera.record
    counters["discrepancy"] = left = view.discrepancy(heights)
    warnings = list(answer.warnings)
    if view is not run.told:
        counters["losses"] = effects_of(view.scene)
        angle = run.numbers.scene.lamp_half_angle_rad  # the view's is a lamp's radius where that is nearby
        if angle != run.told.scene.lamp_half_angle_rad:
            counters["losses"] |= {"lamp_half_angle_rad": angle}
            warnings.append(
                f"the image looks as lit by a lamp of half angle {math.degrees(angle):.2g} degrees; it is counted"
            )
    if view is not run.told and not run.bench.is_told(run.numbers):
        record = stated_record(run.numbers, run.bench)
        counters["bench"] = record.record | {
            "light": run.bench.field.tolist(),
            "uneven": run.bench.uneven(view.scene.image_pixels),
            "less_known": times_less_known(run.numbers, run.bench),
        }
        warnings += bench_warnings(run.numbers, run.bench, record)
    if run.takes_lines and run.hinted and method.options.bench_uncertainty:
        counters["hinted"] = run.hinted
        warnings.append(
            f"lines hint at a bench with {100 * run.hinted:+.1f} % on base, gap and index together, and do not tell it "
            "clearly: heights are those without it, and as uncertain; measure base and gap"
        )
    uncertainty = None
    if answer.uncertainty_m is not None:
        is_asked = method.options.causes and not is_noise_left
        rest = view.resimulation.rest(heights, found_at) if is_asked else None
        posterior = None if covariance is None else height_deviation(run.model, run.lines, covariance)
        flat, places, crossing = method.options.flatness_beside, None, None
        if is_noise_left:
            flat = flat if method.options.flatness_m is not None else min(flat, BARE_M)
            places = view.discrepancy.places(heights)
            crossing = crossing_samples(heights, view.scene) if run.covariance is None else None
        kind = {"has_waves": run.waves is not None, "has_curves": run.curves is not None}
        of = calibration_of(run.model.shape, is_blurred=bool(np.any(view.camera.blur)), **kind)
        stated = of_lines(answer.uncertainty_m, heights, rest, is_noise_left, flat, posterior, places, of, crossing)
        uncertainty = np.hypot(stated, _left_open_by_bench(run, heights, left)) if run.takes_lines else stated
    # Lines that leave nothing but noise were found without the lattice's own error, and are shown without it.
    shown = view.resimulation.finer() if run.takes_lines and is_noise_left else view.resimulation
    result = network_result(
        method.name,
        shown,
        heights,
        reason=run.reason,
        history=run.log.history,
        timings=timings,
        counters=counters,
        settings=method.options.model_dump() | {"network": method.network.network.record},
        warnings=warnings,
        uncertainty=uncertainty,
        no_uncertainty=answer.no_uncertainty,
        found_at=found_at,
    )
    if left is not None and not is_explained(left) and result.trust is not None and not result.trust.is_explained:
        told = (
            f"{left:.1f} times the noise is left of the image where light was moved: lines are missing or wrong in "
            "places, which the difference of the images shows"
        )
        result = dataclasses.replace(result, warnings=(*result.warnings, told))
    if view is not run.told:
        result = as_measured(result, run.numbers, run.bench, run.exposure)
    paths = None if run.curves is None else paths_of(run.curves.lines, run.model.shape)
    result = dataclasses.replace(result, fibres_m=fibres, paths=paths)
    if fibres is None or not (method.options.samples and run.reason == "converged"):
        return result
    # Samples are compared with the result by the same photons.
    same = LinesView(shown, run.model)
    return with_line_samples(result, method.options.samples, same, run.lines, covariance)
