"""Where a line may be missing: ridges of what the lines so far leave unexplained."""

import numpy as np
import numpy.typing as npt
import scipy  # loads its parts when they are first used

from warp_caustics.prints.line_shape import Shape, half_height
from warp_caustics.types import FloatArray, IntArray

ANGLES = 24
"""Directions of half a turn; an even number, so that across each of them lies another one."""
FOLLOWED_STEPS = 100
"""Steps of half a sample along which a ridge is followed, each way."""
STEPS_AT_ONCE = 20
"""Of these, after which it is seen which ridges go on: most directions lead across one."""
RIDGE_END_SHARE = 0.45
"""A ridge ends where it falls below this share of its height at the start: lines on top only raise it."""
COSINE = Shape()
STARTS_APART = 6.0
"""Distance of the starts of different proposals [samples]."""
OTHER_DIRECTION = 0.2
"""Angle from which on a direction is another one than the best."""
LOW_OF_RIDGE = 0.3
"""Quantile of the heights along a ridge that is taken for the line's own: others lie on top in places."""

_ANGLES = np.arange(ANGLES) * np.pi / ANGLES
_STEPS = np.arange(-FOLLOWED_STEPS, FOLLOWED_STEPS + 1) / 2


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
    tops: list[tuple[int, int]] = []
    for _ in range(count):
        i, j = (int(k) for k in np.unravel_index(int(free.argmax()), free.shape))
        if free[i, j] <= 0:
            break
        tops.append((i, j))
        free[(rows - i) ** 2 + (columns - j) ** 2 < STARTS_APART**2] = -1.0
    if not tops:
        return np.zeros((0, 6))
    return _through(smooth, np.array(tops), plate_size_m, 1 / half_height(shape))


def _through(smooth: FloatArray, tops: IntArray, plate_size_m: tuple[float, float], wider: float) -> FloatArray:
    """The two best directions of a ridge through each sample [K, 2]; lines [2 K, 6] are ``wider`` than there."""
    n = len(smooth)
    pitch_x, pitch_y = (size / n for size in plate_size_m)
    pitch = (pitch_x + pitch_y) / 2
    along = _along(smooth, tops)
    height = smooth[tuple(tops.T)][:, None, None]
    first, last = _runs(along > RIDGE_END_SHARE * height)
    # Across a direction lies the one at a right angle to it, which is another of them.
    low, high = _runs(along > 0.5 * height)
    across = np.roll(high - low, ANGLES // 2, axis=1)
    # Counted in steps, equally long ridges are equal; lengths would be rounded.
    longer = last - first - across
    lines = []
    for k, top in enumerate(tops):
        found = np.lexsort((_ANGLES, longer[k]))[::-1]
        turned = np.abs(_ANGLES[found] - _ANGLES[found[0]])
        others = found[np.minimum(turned, np.pi - turned) > OTHER_DIRECTION]
        x, y = (top[::-1] + 0.5) * (pitch_x, pitch_y) - np.array(plate_size_m) / 2
        for angle in (found[0], *others[:1]):
            ends = _STEPS[[first[k, angle], last[k, angle]]] * pitch
            ridge = np.sort(along[k, angle, first[k, angle] : last[k, angle] + 1])
            typical = np.interp(LOW_OF_RIDGE * (len(ridge) - 1), np.arange(len(ridge)), ridge)
            width = np.clip(wider * (across[k, angle] * pitch / 2), 2e-4, 4e-3)
            turn = np.cos(_ANGLES[angle]), np.sin(_ANGLES[angle])
            lines.append([*(np.array([x, y]) + ends[:, None] * turn).ravel(), width, max(typical, 3e-5)])
    return np.array(lines)


def _along(smooth: FloatArray, tops: IntArray) -> FloatArray:
    """Heights along all directions through samples [K, 2], shape [K, angles, steps]; -1 beyond a ridge's end."""
    # Directions in samples: of a plate that is not square they are a little off, the fit turns them.
    ways = np.stack([np.sin(_ANGLES), np.cos(_ANGLES)])
    along = np.full((len(tops), ANGLES, 2 * FOLLOWED_STEPS + 1), -1.0)
    along[..., FOLLOWED_STEPS] = smooth[tuple(tops.T)][:, None]
    ends = RIDGE_END_SHARE * along[..., FOLLOWED_STEPS]
    for side in (-1, 1):
        k, angle = np.indices(ends.shape).reshape(2, -1)
        for begun in range(0, FOLLOWED_STEPS, STEPS_AT_ONCE):
            steps = side * np.arange(begun + 1, min(begun + STEPS_AT_ONCE, FOLLOWED_STEPS) + 1)
            at = tops[k].T[..., None] + ways[:, angle, None] * (steps / 2)
            heights = scipy.ndimage.map_coordinates(smooth, at, order=1, mode="constant", cval=-1.0)
            along[k[:, None], angle[:, None], FOLLOWED_STEPS + steps] = heights
            goes_on = (heights > ends[k, angle, None]).all(axis=1)
            k, angle = k[goes_on], angle[goes_on]
            if not len(k):
                break
    return along


def _runs(is_high: npt.NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """First and last index of the run of True around the middle of the last axis, shape of the others."""
    middle = is_high.shape[-1] // 2
    before = np.minimum.accumulate(is_high[..., :middle][..., ::-1], axis=-1).sum(axis=-1)
    after = np.minimum.accumulate(is_high[..., middle + 1 :], axis=-1).sum(axis=-1)
    return middle - before, middle + after
