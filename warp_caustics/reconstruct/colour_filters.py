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

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
FOUND_RATIO = 0.5
"""Of what the best pattern leaves to what the second leaves, at most: of eight own photos through a mosaic, divided by
their flat frames, 0 to 0.04; of the same without 0.994 to 1."""
LEAST_STRUCTURE = 1e-3
"""Of the image's mean that the second pattern must leave: without structure nothing tells them apart."""
BORDER_PX = 4
"""That does not count: there neighbours are made up, too."""


def found_pattern(irradiance: npt.NDArray[np.floating]) -> str | None:
    """The filters that an image was taken through, row by row of the first 2 x 2 pixels; None for none.

    Args:
        irradiance: of red, green and blue in the order of the channels, finite, shape [3, m, m]; other images, whose
            colours nobody knows, have none.
    """
    if irradiance.shape[0] != len(CHANNELS) or min(irradiance.shape[1:]) < 4 * BORDER_PX:
        return None
    image = torch.as_tensor(np.asarray(irradiance, np.float64))
    inside = (..., slice(BORDER_PX, -BORDER_PX), slice(BORDER_PX, -BORDER_PX))
    left = {
        pattern: float((image - demosaicked(mosaicked(image, pattern), pattern))[inside].square().mean().sqrt())
        for pattern in PATTERNS
    }
    best, second = sorted(PATTERNS, key=left.__getitem__)[:2]
    is_clear = left[second] > LEAST_STRUCTURE * float(image.abs().mean()) and left[best] < FOUND_RATIO * left[second]
    return best if is_clear else None


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
