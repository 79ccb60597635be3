"""Blur by lens and pixel: a Gaussian and a square, given by their transfer functions within the pixels' band.

At the photo's border the picture is mirrored, which keeps all light and makes the operator its own adjoint.
"""

import math

import torch

from warp_caustics.resampling import BLUR_REACH, gaussian_kernel, mirrored_rows

RING_REACH = 16
"""Pixels, at least, before a kernel is cut: one within the pixels' band rings on. Matrices are full in any case."""


def psf_reach(largest_px: float, box_px: float) -> int:
    """Where a PSF is cut [px]: of a Gaussian's largest standard deviation and a square's largest width [px]."""
    return RING_REACH + math.ceil(BLUR_REACH * largest_px + box_px / 2)


def psf_matrix(pixels: int, psf_px: torch.Tensor, box_px: torch.Tensor, reach: int) -> torch.Tensor:
    """Blur along one axis, shape [..., m, m]: symmetric; rows and columns sum to 1.

    Args:
        pixels: m.
        psf_px: standard deviation of the Gaussian [px], shape [...].
        box_px: width of the square [px], same shape.
        reach: where both are cut [px], see :func:`psf_reach`.
    """
    return mirrored_rows(gaussian_kernel(psf_px, reach, box_px), pixels)
