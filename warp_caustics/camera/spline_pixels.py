"""Pixels of one grid as means over those of another, without softening.

An image holds means over its pixels. It is taken for the quartic spline whose means over those pixels it is
(:mod:`warp_caustics.pixel_spline`), and a pixel of the other grid holds the mean of that spline over its own width:
light is conserved whatever the sizes, neighbours share their edge, an equal grid gives the image back, and whole pixels
of shift are exact. Lines 6 px apart keep their contrast to 1e-4 at half a pixel, and straight ones their place exactly.
Beyond its border the image is mirrored.
"""

from functools import lru_cache

import numpy as np
import torch

from warp_caustics.pixel_spline import DEGREE, mirrored, spline_taps


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
    first, weights = spline_taps(low, high)
    index = first.long()[..., None] + torch.arange(weights.shape[-1], device=low.device)
    return mirrored(index, pixels), weights / size[..., None]


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
