"""Which pixels of a colour image a sensor measured behind its filters, and which were made up from their neighbours.

Bilinear demosaicing leaves a channel's own pixels as they are, so that it gives the same image again from those: of
the four places that a pattern of 2 x 2 filters can lie at, the true one leaves nothing, others as much as the image has
structure. Found so where pixels still lie as on the sensor; an image that was resampled or binned is one of pixels that
all saw every colour. Demosaicing that mixes colours is not found.
"""

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.camera.mosaic import CHANNELS, demosaicked, filter_mask, mosaicked
from warp_caustics.types import FloatArray

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
FOUND_RATIO = 0.5
"""Of what the best pattern leaves to what the second leaves, at most: of eight own photos through a mosaic, divided by
their flat frames, 0 to 0.04; of the same without 0.994 to 1."""
LEAST_STRUCTURE = 1e-3
"""Of the image's mean that the second pattern must leave: without structure nothing tells them apart."""
BORDER_PX = 4
"""That does not count: there neighbours are made up, too. Even, so that parities within are those of the image."""


def found_pattern(irradiance: npt.NDArray[np.floating]) -> str | None:
    """The filters that an image was taken through, row by row of the first 2 x 2 pixels; None for none.

    Args:
        irradiance: of red, green and blue in the order of the channels, finite, shape [3, m, m]; other images, whose
            colours nobody knows, have none.
    """
    if irradiance.shape[0] != len(CHANNELS) or min(irradiance.shape[1:]) < 4 * BORDER_PX:
        return None
    left = _left_by_patterns(np.asarray(irradiance, np.float64))
    best, second = sorted(PATTERNS, key=left.__getitem__)[:2]
    is_clear = (
        left[second] > LEAST_STRUCTURE * float(np.abs(irradiance).mean(dtype=np.float64))
        and left[best] < FOUND_RATIO * left[second]
    )
    return best if is_clear else None


def _left_by_patterns(image: FloatArray) -> dict[str, float]:
    """Root mean square that each pattern's :func:`~warp_caustics.camera.mosaic.demosaicked` leaves within its border.

    Made up are means of two neighbours along a row or a column, of four along diagonals, or, for green, of both rows
    and columns. Which of these a pixel is depends on the pattern alone, so that what each would leave is asked once.

    Args:
        image: shape [3, H, W].
    """
    made_up = [_squares_of_places(channel) for channel in image]
    pixels = image[:, BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX].size

    def squares(pattern: str) -> float:
        total = 0.0
        for place, name in enumerate(pattern):
            (y, x), kinds = divmod(place, 2), made_up[CHANNELS.index(name)]
            if name == "g":  # on two places of four; of each the pixel beside it in its row is made up
                total += kinds["cross"][y, 1 - x]
            else:
                total += kinds["row"][y, 1 - x] + kinds["column"][1 - y, x] + kinds["diagonal"][1 - y, 1 - x]
        return total

    return {pattern: float(np.sqrt(squares(pattern) / pixels)) for pattern in PATTERNS}


def _squares_of_places(channel: FloatArray) -> dict[str, FloatArray]:
    """Of pixels less the means of their neighbours, sums of squares by parity of row and column, each shape [2, 2]."""
    height, width = channel.shape

    def moved(down: int, right: int) -> FloatArray:
        rows, columns = BORDER_PX + down, BORDER_PX + right
        return channel[rows : height - 2 * BORDER_PX + rows, columns : width - 2 * BORDER_PX + columns]

    inside, beside = moved(0, 0), moved(0, -1) + moved(0, 1)
    above = moved(-1, 0) + moved(1, 0)
    across = moved(-1, -1) + moved(-1, 1) + moved(1, -1) + moved(1, 1)
    means = {"row": beside / 2, "column": above / 2, "cross": (beside + above) / 4, "diagonal": across / 4}
    left = {kind: np.square(inside - mean) for kind, mean in means.items()}
    return {kind: np.array([[each[y::2, x::2].sum() for x in (0, 1)] for y in (0, 1)]) for kind, each in left.items()}


def own_pixels(pattern: str, pixels: int) -> npt.NDArray[np.bool_]:
    """True where a channel's own filter lies, shape [3, m, m]."""
    return np.asarray(filter_mask(pattern, pixels, pixels, torch.float64, torch.device("cpu")).numpy() > 0)


def through_filters(image: torch.Tensor, own: npt.NDArray[np.bool_]) -> torch.Tensor:
    """An image as it looks through colour filters and bilinear demosaicing, shape [3, m, m].

    Args:
        image: shape [3, m, m].
        own: of :func:`own_pixels`.
    """
    pattern = pattern_of(own)
    return demosaicked(mosaicked(image, pattern), pattern)


def pattern_of(own: npt.NDArray[np.bool_]) -> str:
    """Name of the filters that :func:`own_pixels` belong to."""
    return "".join(CHANNELS[int(own[:, y, x].argmax())] for y in (0, 1) for x in (0, 1))


def moved_pixels(own: npt.NDArray[np.bool_], shift: tuple[float, float], scale: float) -> npt.NDArray[np.bool_]:
    """Of one channel, after a resampling: pixels whose nearest in the image they came from is the channel's own.

    Args:
        own: of the channel, shape [m, m].
        shift: of the picture there against where it is wanted, towards larger x and y [px].
        scale: its magnification about the middle, less 1.
    """
    middle = (own.shape[-1] - 1) / 2
    at = np.arange(own.shape[-1]) - middle
    x, y = (np.rint(middle + at * (1 + scale) + each).astype(int) for each in shift)
    # Beyond the border a picture is mirrored about its outermost pixels, which keeps the order of its filters.
    x, y = (np.abs(each) for each in (x, y))
    x, y = (np.where(each >= len(at), 2 * (len(at) - 1) - each, each) for each in (x, y))
    return np.asarray(own[y[:, None], x[None, :]])


def of_one_filter(own: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    """Rows and columns of pixels, every second, that all are a channel's own, of shape [m, m] before a resampling."""
    y, x = np.argwhere(own[:2, :2])[0]
    return slice(int(y), None, 2), slice(int(x), None, 2)
