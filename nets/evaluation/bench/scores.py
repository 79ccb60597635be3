"""How good a relief is on a bench that is not as told."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nets.evaluation.alignment import aligned_rmse_um
from nets.evaluation.fields import Field
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

BENCH_SCORES = {
    "rmse_um": "relief RMSE [um]",
    "rmse_aligned_um": "RMSE after the best move sideways [um]",
    "rmse_mean_removed_um": "RMSE without the mean [um]",
    "rmse_form_removed_um": "RMSE without the best bow, tilt and mean, which a bent plate has and no image tells [um]",
    "slope_error": "RMS slope error [1]",
    "within_one": "share within one standard uncertainty",
    "within_two": "share within two",
    "within_one_on_relief": "of the points where something is printed, share within one",
    "within_two_on_relief": "of these, share within two",
    "flat_um": "RMSE of a flat guess [um]",
}
"""Numbers of a case, and what they are."""
PRINTED_M = 1e-6
"""Heights above which a point is counted as printed [m]."""
COVERED = (("within_one", 1), ("within_two", 2))
"""Shares, and how many standard uncertainties they are within."""


def relief_scores(
    found_m: FloatArray, true_m: FloatArray, plate_size_m: tuple[float, float], uncertainty_m: FloatArray | None = None
) -> dict[str, float | None]:
    """All :data:`BENCH_SCORES`.

    Args:
        found_m: recovered relief [m], shape [n, n].
        true_m: true relief [m], same shape.
        plate_size_m: extent along x and y [m].
        uncertainty_m: standard uncertainty [m], same shape; without one nothing is said to be covered.
    """
    found, true = found_m.astype(np.float64), true_m.astype(np.float64)
    errors = height_errors(found, true, plate_size_m)
    scores: dict[str, float | None] = {
        "rmse_um": errors["rmse_um"],
        "rmse_aligned_um": min(aligned_rmse_um(found, true), errors["rmse_um"]),
        "rmse_mean_removed_um": errors["rmse_mean_removed_um"],
        "rmse_form_removed_um": 1e6 * float(np.sqrt(np.mean(without_form(found - true) ** 2))),
        "slope_error": errors["rmse_slope"],
        "flat_um": errors["reference_rms_um"],
    }
    return scores | covered_shares(found - true, true > PRINTED_M, uncertainty_m)


def covered_shares(
    error_m: FloatArray, is_printed: BoolArray, uncertainty_m: FloatArray | None
) -> dict[str, float | None]:
    """Shares of the points whose error is within one and two standard uncertainties; of all, and of the printed ones.

    Bare plate that is found bare is within any uncertainty, and there is much of it: what an uncertainty is worth shows
    where something is printed.

    Args:
        error_m: shape [n, n] [m].
        is_printed: shape [n, n].
        uncertainty_m: standard uncertainty [m], shape [n, n]; all None without one, on relief where nothing is printed.
    """
    shares: dict[str, float | None] = {}
    for name, factor in COVERED:
        for where, counted in (("", np.full_like(is_printed, True)), ("_on_relief", is_printed)):
            is_known = uncertainty_m is not None and counted.any()
            within = np.abs(error_m) <= factor * np.float64(0 if uncertainty_m is None else uncertainty_m)
            shares[name + where] = float(within[counted].mean()) if is_known else None
    return shares


def without_form(heights_m: FloatArray) -> FloatArray:
    """Heights less their form of second order, by least squares (the F-operation of ISO 25178-2) [m], shape [n, n].

    What is taken out: mean, tilt and the three curvatures. A bent base has no other errors.
    """
    y, x = np.meshgrid(*(np.linspace(-1, 1, size) for size in heights_m.shape), indexing="ij")
    forms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    values = heights_m.astype(np.float64).ravel()
    amounts, *_ = np.linalg.lstsq(forms, values, rcond=None)
    rest: FloatArray = (values - forms @ amounts).reshape(heights_m.shape)
    return rest


def bench_scores(scene: Scene, n_photons: int, device: str) -> Callable[[Reconstruction, Field], Mapping[str, Any]]:
    """What scores results of cases; light paths and device do not matter to it.

    The scores are :data:`BENCH_SCORES`; ``warned``, whether the result carries a warning; ``trust``, the line of that
    name, and ``explained``, whether it says that the image is explained; None where the method does not tell.
    """

    def scores(result: Reconstruction, field: Field) -> dict[str, Any]:
        numbers = relief_scores(result.heights_m, field.heights_m, scene.plate_size_m, result.uncertainty_m)
        trust = result.trust
        return {
            **numbers,
            "warned": bool(result.warnings),
            "explained": None if trust is None else trust.is_explained,
            "trust": None if trust is None else trust.line,
        }

    return scores
