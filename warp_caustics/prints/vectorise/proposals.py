"""Where a line may be missing: ridges of what the lines so far leave unexplained."""

import numpy as np
import numpy.typing as npt
import scipy  # loads its parts when they are first used

from warp_caustics.prints.model import Shape, half_height
from warp_caustics.types import FloatArray

ANGLES = 24
FOLLOWED_STEPS = 100
"""Steps of half a sample along which a ridge is followed, each way."""
RIDGE_END_SHARE = 0.45
"""A ridge ends where it falls below this share of its height at the start: lines on top only raise it."""
COSINE = Shape()
STARTS_APART = 6.0
"""Distance of the starts of different proposals [samples]."""


def proposed_lines(
    residual_m: FloatArray, plate_size_m: tuple[float, float], count: int, shape: Shape = COSINE
) -> FloatArray:
    """Lines along the highest ridges, two directions each.

    Args:
        residual_m: unexplained heights, shape [n, n] [m].
        plate_size_m: extent along x and y [m].
        count: number of ridges.
        shape: section of the lines, whose full width follows from that at half their height.

    Returns:
        Shape [at most 2 count, 6] [m], without claim to be right: a start for a fit.
    """
    smooth = scipy.ndimage.gaussian_filter(residual_m, 0.7)
    free = smooth.copy()
    rows, columns = np.ogrid[: len(smooth), : smooth.shape[1]]
    wider = 1 / half_height(shape)
    lines: list[list[float]] = []
    for _ in range(count):
        i, j = (int(k) for k in np.unravel_index(int(free.argmax()), free.shape))
        if free[i, j] <= 0:
            break
        lines += _through(smooth, i, j, plate_size_m, wider)
        free[(rows - i) ** 2 + (columns - j) ** 2 < STARTS_APART**2] = -1.0
    return np.array(lines).reshape(-1, 6)


def _through(smooth: FloatArray, i: int, j: int, plate_size_m: tuple[float, float], wider: float) -> list[list[float]]:
    """The two best directions of a ridge through a sample; lines are ``wider`` than at half their height."""
    n, top = len(smooth), smooth[i, j]
    pitch_x, pitch_y = (size / n for size in plate_size_m)
    pitch = (pitch_x + pitch_y) / 2
    steps = np.arange(-FOLLOWED_STEPS, FOLLOWED_STEPS + 1) / 2
    angles = np.arange(ANGLES) * np.pi / ANGLES
    # Directions in samples: of a plate that is not square they are a little off, the fit turns them.
    dx, dy = np.cos(angles)[:, None] * steps, np.sin(angles)[:, None] * steps
    along = scipy.ndimage.map_coordinates(smooth, [i + dy, j + dx], order=1, mode="constant", cval=-1.0)
    across = scipy.ndimage.map_coordinates(smooth, [i + dx, j - dy], order=1, mode="constant", cval=-1.0)
    runs, runs_across = _runs(along > RIDGE_END_SHARE * top), _runs(across > 0.5 * top)
    found = []
    for k, (angle, (first, last), (low, high)) in enumerate(zip(angles, runs, runs_across, strict=True)):
        # Counted in steps, equally long ridges are equal; lengths would be rounded.
        found.append(
            (
                last - first - (high - low),
                angle,
                steps[first] * pitch,
                steps[last] * pitch,
                (high - low) * pitch / 2,
                along[k, first : last + 1],
            )
        )
    found.sort(key=lambda candidate: candidate[:2], reverse=True)
    kept = [found[0]]
    kept += [f for f in found if min(abs(f[1] - kept[0][1]), np.pi - abs(f[1] - kept[0][1])) > 0.2][:1]
    x, y = (j + 0.5) * pitch_x - plate_size_m[0] / 2, (i + 0.5) * pitch_y - plate_size_m[1] / 2
    return [
        [
            x + low * np.cos(angle),
            y + low * np.sin(angle),
            x + high * np.cos(angle),
            y + high * np.sin(angle),
            float(np.clip(wider * width, 2e-4, 4e-3)),
            max(float(np.quantile(ridge, 0.3)), 3e-5),
        ]
        for _, angle, low, high, width, ridge in kept
    ]


def _runs(is_high: npt.NDArray[np.bool_]) -> list[list[int]]:
    """First and last index of the run of True around the middle of each row; of rows [K, N], a list of K pairs."""
    middle = is_high.shape[1] // 2
    before = np.minimum.accumulate(is_high[:, :middle][:, ::-1], axis=1).sum(axis=1)
    after = np.minimum.accumulate(is_high[:, middle + 1 :], axis=1).sum(axis=1)
    pairs: list[list[int]] = np.stack([middle - before, middle + after], axis=1).tolist()
    return pairs
