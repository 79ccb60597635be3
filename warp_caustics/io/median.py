"""Medians of 5 x 5 pixels, in a fifth of the time that SciPy's take, to the last bit the same.

Columns of five are sorted once for the five windows that they are in. What is left of a window are 13 values that may
be its median, which a network of comparisons finds, whole rows of pixels at a time (D. E. Knuth, The Art of Computer
Programming 3, section 5.3.4: Batcher's network; what is never exchanged and what nobody asks for is left out).
"""

from functools import cache

import numpy as np
import numpy.typing as npt

SIDE = 5
REACH = SIDE // 2
ROWS = 16
"""Rows of pixels at a time: so many of 512 to 2048 pixels, 25 times, stay in a core's cache."""

_SORTED_FIVE = ((0, 1), (3, 4), (2, 4), (2, 3), (1, 4), (0, 3), (0, 2), (1, 3), (1, 2))
"""Exchanges that sort five values."""

Step = tuple[int, int, bool, bool]
"""Two values, and whether the smaller, which goes to the first, and the larger, to the second, are used later."""


def median_5x5(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Median of the 25 values around each pixel, the image mirrored at its border.

    As ``scipy.ndimage.median_filter(image, 5)``.

    Args:
        image: any unit, without NaN, shape [H, W].

    Returns:
        The medians, shape [H, W].
    """
    height, width = image.shape
    padded = np.pad(image, REACH, mode="symmetric")
    result = np.empty_like(image)
    steps, middle = _network()
    for top in range(0, height, ROWS):
        rows = min(ROWS, height - top)
        ranks = [padded[top + k : top + k + rows].copy() for k in range(SIDE)]
        _exchanged(ranks, tuple((a, b, True, True) for a, b in _SORTED_FIVE))
        # Contiguous copies: the views begin at any byte, and each is read several times.
        values = [rank[:, k : k + width].copy() for rank in ranks for k in range(SIDE)]
        _exchanged(values, steps)
        result[top : top + rows] = values[middle]
    return result


def _exchanged(values: list[npt.NDArray[np.float64]], steps: tuple[Step, ...]) -> None:
    """Put smaller values first where the steps say so, in place."""
    spare = np.empty_like(values[0])
    for first, second, keeps_smaller, keeps_larger in steps:
        a, b = values[first], values[second]
        if keeps_smaller and keeps_larger:
            np.minimum(a, b, out=spare)
            np.maximum(a, b, out=b)
            values[first], spare = spare, a
        elif keeps_smaller:
            np.minimum(a, b, out=a)
        else:
            np.maximum(a, b, out=b)


@cache
def _network() -> tuple[tuple[Step, ...], int]:
    """Steps that find the median of five sorted columns, value r of column c being number 5 r + c; and its number."""
    # When columns and rows are sorted, (r + 1)(c + 1) values are at most value r, c: with more than 13 it is above the
    # median, or beside an equal one; and the same from the other end.
    most = SIDE * SIDE // 2 + 1
    left = [
        SIDE * r + c
        for r in range(SIDE)
        for c in range(SIDE)
        if (r + 1) * (c + 1) <= most and (SIDE - r) * (SIDE - c) <= most
    ]
    pairs = [(SIDE * r + a, SIDE * r + b) for r in range(SIDE) for a, b in _SORTED_FIVE]
    pairs += [(left[a], left[b]) for a, b in _batcher(len(left))]
    # What never exchanges zeros and ones never exchanges anything (Knuth's zero-one principle).
    zeros = np.indices((SIDE + 1,) * SIDE).reshape(SIDE, -1)
    bits = [rank >= zeros[column] for rank in range(SIDE) for column in range(SIDE)]
    exchanging = []
    for a, b in pairs:
        if np.any(bits[a] & ~bits[b]):
            exchanging.append((a, b))
            bits[a], bits[b] = bits[a] & bits[b], bits[a] | bits[b]
    middle = left[len(left) // 2]
    wanted, steps = {middle}, []
    for a, b in reversed(exchanging):
        if a in wanted or b in wanted:
            steps.append((a, b, a in wanted, b in wanted))
            wanted |= {a, b}
    return tuple(reversed(steps)), middle


def _batcher(count: int) -> list[tuple[int, int]]:
    """Exchanges that sort so many values: merge exchange (Knuth's algorithm 5.2.2 M)."""
    pairs = []
    block = 1
    while block < count:
        step = block
        while step >= 1:
            for start in range(step % block, count - step, 2 * step):
                for k in range(start, min(start + step, count - step)):
                    if k // (2 * block) == (k + step) // (2 * block):
                        pairs.append((k, k + step))
            step //= 2
        block *= 2
    return pairs
