"""How good a relief is on a bench that is not as told."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nets.evaluation.alignment import aligned_rmse_um
from nets.evaluation.bench.coverage import COVERAGE, covered_shares, region_masks
from nets.evaluation.fields import Field
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

BENCH_SCORES = {
    "rmse_um": "relief RMSE [um]",
    "rmse_aligned_um": "RMSE after the best move sideways [um]",
    "rmse_mean_removed_um": "RMSE without the mean [um]",
    "rmse_form_removed_um": "RMSE without the best bow, tilt and mean, which a bent plate has and no image tells [um]",
    "slope_error": "RMS slope error [1]",
    "stated_um": "root mean square of the stated standard uncertainty [um]",
    **COVERAGE,
    "flat_um": "RMSE of a flat guess [um]",
}
"""Numbers of a case, and what they are."""
SHORT_SCORES = {
    "rmse_um": "RMSE [um]",
    "rmse_aligned_um": "aligned [um]",
    "rmse_mean_removed_um": "without mean [um]",
    "rmse_form_removed_um": "without form [um]",
    "slope_error": "slopes [1]",
    "stated_um": "stated u [um]",
    "within_one": "within u",
    "within_two": "within 2 u",
    "flat_um": "flat guess [um]",
}
"""Heads of tables of them; what is covered by region has a table of its own."""


def relief_scores(
    found_m: FloatArray, true_m: FloatArray, scene: Scene, uncertainty_m: FloatArray | None = None
) -> dict[str, float | None]:
    """All :data:`BENCH_SCORES`.

    Args:
        found_m: recovered relief [m], shape [n, n].
        true_m: true relief [m], same shape.
        scene: the set-up that was told.
        uncertainty_m: standard uncertainty [m], same shape; without one nothing is said to be covered.
    """
    found, true = found_m.astype(np.float64), true_m.astype(np.float64)
    errors = height_errors(found, true, scene.plate_size_m)
    scores: dict[str, float | None] = {
        "rmse_um": errors["rmse_um"],
        "rmse_aligned_um": min(aligned_rmse_um(found, true), errors["rmse_um"]),
        "rmse_mean_removed_um": errors["rmse_mean_removed_um"],
        "rmse_form_removed_um": 1e6 * float(np.sqrt(np.mean(without_form(found - true) ** 2))),
        "slope_error": errors["rmse_slope"],
        "stated_um": None
        if uncertainty_m is None
        else 1e6 * float(np.sqrt(np.mean(np.square(uncertainty_m, dtype=np.float64)))),
        "flat_um": errors["reference_rms_um"],
    }
    return scores | covered_shares(found - true, region_masks(true, scene), uncertainty_m)


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
    name, and ``explained``, whether it says that the image is explained; ``doubted``, whether it says that heights may
    be wrong by more than is stated. None where the method does not tell.
    """

    def scores(result: Reconstruction, field: Field) -> dict[str, Any]:
        numbers = relief_scores(result.heights_m, field.heights_m, scene, result.uncertainty_m)
        trust = result.trust
        return {
            **numbers,
            "warned": bool(result.warnings),
            "explained": None if trust is None else trust.is_explained,
            "doubted": result.counters.get("doubt", {}).get("is_doubtful"),
            "trust": None if trust is None else trust.line,
        }

    return scores
