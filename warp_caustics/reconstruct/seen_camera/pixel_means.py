"""From light on fine pixels to the means over a camera's pixels, wherever these lay on the picture.

Channels that lie apart, and pictures of another size, are brought to where they belong by resampling what was measured
(:mod:`~warp_caustics.reconstruct.seen_camera.aligned_channels`). But means over other pixels hold other parts of what
is finer than a pixel, and no resampling makes one of the other: the caustics of a plate of Tab. 3 differ by 3 to 12 %
of flat light between channels half a pixel apart. So what is simulated is averaged over the pixels that there were,
and brought back in the same way.
"""

from functools import lru_cache
from typing import NamedTuple

import torch

from warp_caustics.resampling import blur_matrix, blurred_rows, resampling_matrix


class Lay(NamedTuple):
    """How one channel's picture lay on the pixels: ``size`` times ((1 + scale) x + shift) [px], about the middle.

    And whether it is brought back from there, or left as it was taken; and so many times as large as the plate's the
    light on fine pixels already is (:class:`~warp_caustics.reconstruct.seen_camera.point_spread.FineLight`).
    """

    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 0.0
    size: float = 1.0
    is_back: bool = True
    of_light: float = 1.0

    def along(self, axis: int) -> "Along":
        """Of one axis, 0 for x and 1 for y."""
        return Along(self.shift[axis], self.scale, self.size, self.is_back, self.of_light)


class Along(NamedTuple):
    """:class:`Lay` along one axis."""

    shift: float
    scale: float
    size: float
    is_back: bool
    of_light: float


PLACED = Lay()
"""A picture that lay where it belongs."""
AT_HAND = 12
"""Matrices kept on a device, two for each of six channels: 4 MB each for 512 pixels of 2048, 32 MB for 2048 of 4096;
and as many without lenses, of twice the size."""


def pixel_means(
    light: torch.Tensor, pixels: int, lens_px: float = 0.0, band_px: float = 0.0, lay: Lay = PLACED
) -> torch.Tensor:
    """One channel's picture [m, m], where it belongs, of light on fine pixels, [k m, k m].

    Args:
        light: any unit.
        pixels: m.
        lens_px: standard deviation of a Gaussian before the pixels [px].
        band_px: of one after them, within their band [px].
        lay: where the picture lay when it met the pixels.
    """
    kind = light.dtype, light.device
    rows, columns = (_along_as(*kind, pixels, light.shape[-1], lens_px, band_px, lay.along(axis)) for axis in (1, 0))
    seen: torch.Tensor = rows @ light @ columns.T
    return seen


@lru_cache(maxsize=AT_HAND)
def _along_as(
    dtype: torch.dtype, device: torch.device, pixels: int, fine: int, lens_px: float, band_px: float, lay: Along
) -> torch.Tensor:
    """From fine pixels through a lens to means over pixels, brought back and blurred in their band."""
    along = blurred_rows(_met(device, pixels, fine, lay), lens_px * (fine // pixels))
    if lay.is_back and lay.size != 1:
        along = _resampling(pixels, 0.0, 1 / lay.size - 1).to(device) @ along
    if lay.is_back and (lay.shift or lay.scale):
        back = _resampling(pixels, -lay.shift / (1 + lay.scale), 1 / (1 + lay.scale) - 1)
        along = back.to(device) @ along
    return (blur_matrix(pixels, band_px).to(device) @ along if band_px else along).to(dtype)


@lru_cache(maxsize=AT_HAND)
def _met(device: torch.device, pixels: int, fine: int, lay: Along) -> torch.Tensor:
    """Means over the pixels that there were of light that no lens blurs, shape [m, k m], float64.

    Kept apart, for it is of k m x k m numbers, and widths of lenses that are tried are many.
    """
    k = fine // pixels
    if lay == PLACED.along(0):
        met = torch.eye(pixels, dtype=torch.float64).repeat_interleave(k, dim=1) / k
    else:
        shift, total = lay.size * lay.shift * k, lay.size / lay.of_light * (1 + lay.scale) - 1
        met = _resampling(fine, shift, total).reshape(pixels, k, fine).mean(1)
    return met.to(device)


def _resampling(pixels: int, shift: float, scale: float) -> torch.Tensor:
    return resampling_matrix(pixels, *(torch.tensor(each, dtype=torch.float64) for each in (shift, scale)))
