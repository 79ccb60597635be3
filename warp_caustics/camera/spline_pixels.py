"""Pixels of one grid as means over those of another, without softening.

An image holds means over its pixels. It is taken for the quartic spline

    f(x) = sum_k c_k beta^4(x - k)

whose means over those pixels it is: c solves sum_k c_k beta^5(j - k) = image_j.
A pixel of the other grid, from x_lo to x_hi, then holds the mean of f over it,

    sum_k c_k (S(x_hi - k) - S(x_lo - k)) / (x_hi - x_lo),      S the integral of beta^4,

so that light is conserved whatever the sizes, neighbours share their edge, an
equal grid gives the image back, and whole pixels of shift are exact. Between
equal grids this is interpolation by quintic splines (Unser, Splines: a perfect
fit for signal and image processing, IEEE Signal Processing Magazine 16(6),
1999, eqs. 4 and 15): lines 6 px apart keep their contrast to 1e-4 at half a
pixel, and straight ones their place exactly, where the eight-tap sinc of
:mod:`warp_caustics.resampling` is up to 0.015 px off. Beyond its border the
image is mirrored.
"""

from functools import lru_cache

import numpy as np
import torch

DEGREE = 5
"""Of the spline between equal pixels."""
TAPS = 7
"""Coefficients that a pixel of up to two pixels' width takes part in: 5 of an edge, and one for each pixel between."""
HALF_SUPPORT = DEGREE / 2


@lru_cache(maxsize=8)
def _filter_rows(pixels: int) -> torch.Tensor:
    from scipy import ndimage

    return torch.from_numpy(ndimage.spline_filter1d(np.eye(pixels), order=DEGREE, axis=0, mode="reflect"))


@lru_cache(maxsize=16)
def filter_matrix(pixels: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Coefficients from an image's rows, shape [m, m]; symmetric."""
    return _filter_rows(pixels).to(device, dtype)


def spline_coefficients(image: torch.Tensor) -> torch.Tensor:
    """c of an image, both of shape [..., m, m]."""
    matrix = filter_matrix(image.shape[-1], image.dtype, image.device)
    return matrix @ image @ matrix


def edge_integral(position: torch.Tensor) -> torch.Tensor:
    """S: integral of beta^4 from minus infinity to a position [px], same shape; 0 at -2.5, 1 at 2.5."""
    right = (position + HALF_SUPPORT).clamp(0, DEGREE)
    # The tail that is nearer: with powers of up to 2.5 no digits are lost.
    # Chosen, not the minimum: that has no derivative in the middle, where edges lie half a pixel off.
    tail = torch.where(right < HALF_SUPPORT, right, DEGREE - right)
    powers = tail**5 - 5 * (tail - 1).clamp(min=0) ** 5 + 10 * (tail - 2).clamp(min=0) ** 5
    return torch.where(right < HALF_SUPPORT, powers / 120, 1 - powers / 120)


def pixel_taps(low: torch.Tensor, high: torch.Tensor, pixels: int, is_dark: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Coefficients that camera pixels take part in, and how: indices and weights, shape [..., TAPS] both.

    Args:
        low: lower edges in pixel coordinates of the image, whose centres are whole numbers, shape [...].
        high: upper edges, at most two pixels above, same shape.
        pixels: m.
        is_dark: no light beyond the image's border; else it is mirrored there.
    """
    size = high - low
    if is_dark:
        low, high = low.clamp(-0.5, pixels - 0.5), high.clamp(-0.5, pixels - 0.5)
    first = torch.floor(low - HALF_SUPPORT).detach() + 1
    tap = first[..., None] + torch.arange(TAPS, device=low.device, dtype=low.dtype)
    weights = (edge_integral(high[..., None] - tap) - edge_integral(low[..., None] - tap)) / size[..., None]
    index = torch.remainder(tap.long(), 2 * pixels)
    return torch.minimum(index, 2 * pixels - 1 - index), weights


def pixel_matrix(edges: torch.Tensor, pixels: int, is_dark: bool) -> torch.Tensor:
    """Rows that give each camera pixel as a weighted sum of the image's, shape [..., M, m].

    Args:
        edges: of the camera's pixels in pixel coordinates of the image, rising, shape [..., M + 1].
        pixels: m.
        is_dark: as of :func:`pixel_taps`.
    """
    index, weights = pixel_taps(edges[..., :-1], edges[..., 1:], pixels, is_dark)
    rows = weights.new_zeros(*weights.shape[:-1], pixels).scatter_add(-1, index, weights)
    return rows @ filter_matrix(pixels, edges.dtype, edges.device)
