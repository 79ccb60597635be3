"""The quartic spline whose means over pixels are given, and what part of it lies in pixels elsewhere.

    f(x) = sum_k c_k beta^4(x - k),        image_j = sum_k c_k beta^5(j - k).

A pixel from x_lo to x_hi holds the mean of f over it, sum_k c_k (S(x_hi - k) - S(x_lo - k)) / (x_hi - x_lo), S the
integral of beta^4. Between equal grids this is interpolation by quintic splines (Unser, Splines: a perfect fit for
signal and image processing, IEEE Signal Processing Magazine 16(6), 1999, eqs. 4 and 15).
"""

import math

import torch

DEGREE = 5
"""Of the spline between equal pixels."""
TAPS = 7
"""Coefficients that a pixel of up to two pixels' width takes part in: 5 of an edge, and one for each pixel between."""
HALF_SUPPORT = DEGREE / 2


def edge_integral(position: torch.Tensor) -> torch.Tensor:
    """S: integral of beta^4 from minus infinity to a position [px], same shape; 0 at -2.5, 1 at 2.5."""
    right = (position + HALF_SUPPORT).clamp(0, DEGREE)
    # The tail that is nearer: with powers of up to 2.5 no digits are lost.
    # Chosen, not the minimum: that has no derivative in the middle, where edges lie half a pixel off.
    tail = torch.where(right < HALF_SUPPORT, right, DEGREE - right)
    powers = tail**5 - 5 * (tail - 1).clamp(min=0) ** 5 + 10 * (tail - 2).clamp(min=0) ** 5
    return torch.where(right < HALF_SUPPORT, powers / 120, 1 - powers / 120)


def spline_taps(low: torch.Tensor, high: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The first coefficient that pixels take part in, and the weights of it and those after it.

    Args:
        low: lower edges in pixel coordinates of the image, whose centres are whole numbers, shape [...].
        high: upper edges, at most two pixels above, same shape.

    Returns:
        Whole numbers of the edges' type, shape [...], and weights times the pixel's width, shape [..., TAPS].
    """
    first = torch.floor(low - HALF_SUPPORT).detach() + 1
    tap = first[..., None] + torch.arange(TAPS, device=low.device, dtype=low.dtype)
    above, below = edge_integral(torch.stack((high, low))[..., None] - tap)
    return first, above - below


def mirrored(index: torch.Tensor, pixels: int) -> torch.Tensor:
    """Whole numbers beyond an image's border as those of the pixels that a mirror at its border shows, same shape."""
    index = torch.remainder(index, 2 * pixels)
    return torch.minimum(index, 2 * pixels - 1 - index)


def filter_transfer(omega: torch.Tensor) -> torch.Tensor:
    """Of the filter from images to coefficients, 1 over the transfer function of beta^5 at whole numbers, same shape.

    Args:
        omega: angular frequency [1/px].
    """
    return 120 / (66 + 52 * torch.cos(omega) + 2 * torch.cos(2 * omega))


def filter_reach(remainder: float) -> int:
    """Pixels after which the filter from images to coefficients has fallen to ``remainder`` of its middle.

    It falls by the larger root of beta^5's polynomial, 0.4306, from each pixel to the next.
    """
    return math.ceil(math.log(remainder) / math.log(0.430575))
