"""Where a plate is out of tolerance, where it is in, and where the measurement cannot tell.

The tolerance zone is that of ISO 1101's profile of a surface: all points not
farther from the nominal surface than the tolerance t, measured along its
normal. Where the surface has the slope s, that allows vertical deviations up to
t sqrt(1 + s^2). Without this, a fibre with a flank of 45 degrees would be out of
tolerance by its height as soon as it is by its place.
"""

from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from warp_caustics.errors import InputError
from warp_caustics.types import BoolArray, FloatArray

COVERAGE_FACTOR = 2.0
"""k: a deviation counts as certain when it exceeds the tolerance by k standard uncertainties."""
SMALLEST_CELLS = 5
"""A connected part of fewer cells is taken for an error of the measurement: its heights are correlated over about
two cells, so that a single wrong one looks like up to four."""
SPIKE_LIMITS = 5.0
"""A deviation that is certainly so many times the largest one allowed is out of tolerance, however small its part of
the plate is: errors of the measurement are not as high as that and as small. One that is so many times too large, but
not certainly, is undecided whatever its area."""
MOST_SPECKS = 0.005
"""Share of the judged plate that parts too small to be judged may cover together: beyond it they are undecided. Errors
of the measurement are few where it is certain of itself."""
BARE_M = 1e-6
"""A nominal height up to which the plate is bare [m]."""
FEWEST_BARE = 0.02
"""Share of the judged plate that must be bare for its level to be taken from there."""


@dataclass(frozen=True, eq=False)
class Zones:
    """Verdict of every cell, shape [n, n] each.

    Attributes:
        out: certainly out of tolerance.
        undecided: beyond tolerance or not, the uncertainty does not tell.
        limit_m: largest vertical deviation allowed [m].
        specks: beyond tolerance, but in parts too small to be told from errors of the measurement, and none of them a
            spike; not judged, but where they are many, undecided as well.
    """

    out: BoolArray
    undecided: BoolArray
    limit_m: FloatArray
    specks: BoolArray


def vertical_limit(nominal_m: FloatArray, tolerance_m: float, pitch_m: tuple[float, float]) -> FloatArray:
    """Largest vertical deviation inside the tolerance zone [m], shape [n, n].

    The slope of a cell is the steeper of its two sides, along x and along y, so that crests and feet of narrow
    fibres, whose central difference is 0, have one too.

    Args:
        nominal_m: the design's relief [m], shape [n, n].
        tolerance_m: t [m].
        pitch_m: distance of samples along x and y [m].
    """
    squared = np.zeros_like(nominal_m, dtype=np.float64)
    for axis, pitch in ((0, pitch_m[1]), (1, pitch_m[0])):
        step = np.abs(np.diff(nominal_m.astype(np.float64), axis=axis)) / pitch
        before = np.pad(step, [(1, 0) if a == axis else (0, 0) for a in (0, 1)])
        after = np.pad(step, [(0, 1) if a == axis else (0, 0) for a in (0, 1)])
        squared += np.maximum(before, after) ** 2
    limit: FloatArray = tolerance_m * np.sqrt(1 + squared)
    return limit


def level(deviation_m: FloatArray, nominal_m: FloatArray, mask: BoolArray) -> tuple[float, str]:
    """The height to take from a deviation before it is judged, and where it comes from.

    One image hardly shows the thickness of a plate. Its bare part tells where zero is: the median deviation there.
    Where hardly any of the plate is bare, the median of all that is judged stands in.

    Args:
        deviation_m: measured minus nominal [m], shape [n, n].
        nominal_m: the design's relief [m], shape [n, n].
        mask: True where the plate is judged, shape [n, n].

    Returns:
        Offset [m], and the part of the plate in words.
    """
    bare = mask & (np.abs(nominal_m - nominal_m[mask].min()) <= BARE_M)
    if bare.sum() >= FEWEST_BARE * mask.sum():
        return float(np.median(deviation_m[bare])), "the bare plate"
    return float(np.median(deviation_m[mask])), "all that is judged, since hardly any of the plate is bare"


def zones(
    deviation_m: FloatArray,
    sigma_m: FloatArray | None,
    limit_m: FloatArray,
    mask: BoolArray,
    *,
    coverage: float = COVERAGE_FACTOR,
    smallest_cells: int = SMALLEST_CELLS,
) -> Zones:
    """Judge every cell.

    A cell is out where |deviation| - k sigma exceeds the limit; it is undecided where |deviation| exceeds the
    limit but not by k sigma, or where k sigma exceeds it, so that an error as large as the limit could hide.
    Connected parts of fewer than ``smallest_cells`` are dropped, unless |deviation| - k sigma exceeds
    ``SPIKE_LIMITS`` times the limit somewhere in them, or, of undecided ones, |deviation| does. Where those that are
    dropped cover more than ``MOST_SPECKS`` of the plate, they are undecided. Where the uncertainty is no number, or
    below 0, nothing is certain.

    Args:
        deviation_m: measured minus nominal, level removed [m], shape [n, n].
        sigma_m: standard uncertainty of the heights [m], shape [n, n]; None if the method has none.
        limit_m: see :func:`vertical_limit`.
        mask: True where the plate is judged, shape [n, n].
        coverage: k.
        smallest_cells: least size of a part.
    """
    if not mask.any():
        raise InputError("the mask leaves nothing of the plate to judge; mark the judged part with values other than 0")
    sigma = np.zeros_like(limit_m)
    if sigma_m is not None:
        sigma = np.where(np.isfinite(sigma_m) & (sigma_m >= 0), sigma_m, np.inf)
    size = np.abs(deviation_m)
    certain = size - coverage * sigma
    beyond = mask & (size > limit_m)
    wholly_out = mask & (certain > limit_m)
    out = without_specks(wholly_out, smallest_cells, spikes=mask & (certain > SPIKE_LIMITS * limit_m))
    blind = mask & (coverage * sigma > limit_m)
    far = mask & (size > SPIKE_LIMITS * limit_m)
    undecided = without_specks((beyond | blind) & ~out, smallest_cells, spikes=far & ~out)
    specks = beyond & ~out & ~undecided
    if specks.sum() > MOST_SPECKS * mask.sum():
        undecided = undecided | specks
    return Zones(out, undecided, limit_m, specks)


def without_specks(marked: BoolArray, smallest_cells: int, spikes: BoolArray | None = None) -> BoolArray:
    """Only connected parts of at least so many cells, diagonal neighbours included, and those that hold a spike."""
    labels, count = scipy.ndimage.label(marked, structure=np.ones((3, 3)))
    is_kept = np.bincount(labels.ravel(), minlength=count + 1) >= smallest_cells
    if spikes is not None:
        is_kept[np.unique(labels[spikes & marked])] = True
    kept: BoolArray = marked & is_kept[labels]
    return kept


def ridges(nominal_m: FloatArray, tolerance_m: float) -> BoolArray:
    """Where a relief has ridges of hardly more than a sample, higher than a tolerance; shape [n, n].

    There a sample is above the mean of its neighbours, along x or y, by more than the tolerance and by half of its
    height over the lowest of the 5 x 5 samples around. A fibre narrower than two samples shows no slope there, so
    its zone is too narrow: moved aside by less than the tolerance, it may leave it.

    Args:
        nominal_m: the design's relief [m], shape [n, n].
        tolerance_m: [m].
    """
    high = np.maximum(tolerance_m, 0.5 * (nominal_m - scipy.ndimage.minimum_filter(nominal_m, 5)))
    narrow = np.zeros(nominal_m.shape, bool)
    narrow[1:-1] |= (nominal_m[1:-1] - (nominal_m[:-2] + nominal_m[2:]) / 2) > high[1:-1]
    narrow[:, 1:-1] |= (nominal_m[:, 1:-1] - (nominal_m[:, :-2] + nominal_m[:, 2:]) / 2) > high[:, 1:-1]
    return narrow
