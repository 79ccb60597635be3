"""Which share of a plate is as right as a result says, by what is there: bare plate, relief, folds.

Bare plate that is found bare is within any uncertainty, and there is much of it: what an uncertainty is worth shows
where something is printed, and most where light paths cross, for there several reliefs may explain an image.
"""

import numpy as np

from warp_caustics.fold_fraction import crossing_samples
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

PRINTED_M = 1e-6
"""True heights above which a point is counted as printed [m]."""
REGIONS = {
    "": "all points",
    "_bare": "points where nothing is printed",
    "_on_relief": f"points where something is printed, higher than {1e6 * PRINTED_M:g} um",
    "_on_lines": "of these, points where no light paths cross",
    "_on_folds": "of these, points where light paths cross",
}
"""Parts of a plate, by how names of their scores end; of the true relief on the bench that was told."""
SHORT = {"": "all", "_bare": "bare", "_on_relief": "relief", "_on_lines": "lines", "_on_folds": "folds"}
"""The same, for heads of tables."""
WITHIN = {"within_one": 1, "within_two": 2}
"""Scores, and how many standard uncertainties they are within."""
COVERAGE = {
    name + region: f"share of {what} within {'one' if factor == 1 else 'two'} standard uncertaint"
    + ("y" if factor == 1 else "ies")
    for region, what in REGIONS.items()
    for name, factor in WITHIN.items()
}
"""Scores, and what they are."""


def region_masks(true_m: FloatArray, scene: Scene) -> dict[str, BoolArray]:
    """Where each of :data:`REGIONS` is, shape [n, n].

    Args:
        true_m: true relief above the base [m], shape [n, n].
        scene: the set-up, of as many samples.
    """
    is_printed = np.asarray(true_m > PRINTED_M)
    is_crossed = crossing_samples(true_m, scene)
    return {
        "": np.full_like(is_printed, True),
        "_bare": ~is_printed,
        "_on_relief": is_printed,
        "_on_lines": is_printed & ~is_crossed,
        "_on_folds": is_printed & is_crossed,
    }


def covered_shares(
    error_m: FloatArray, regions: dict[str, BoolArray], uncertainty_m: FloatArray | None
) -> dict[str, float | None]:
    """All of :data:`COVERAGE`; None without an uncertainty, and for a region that a plate has nothing of.

    Args:
        error_m: found minus true heights [m], shape [n, n].
        regions: of the plate, from :func:`region_masks`.
        uncertainty_m: standard uncertainty [m], shape [n, n].
    """
    shares: dict[str, float | None] = {}
    for region, is_there in regions.items():
        for name, factor in WITHIN.items():
            if uncertainty_m is None or not is_there.any():
                shares[name + region] = None
            else:
                within = np.abs(error_m) <= factor * uncertainty_m.astype(np.float64)
                shares[name + region] = float(within[is_there].mean())
    return shares
