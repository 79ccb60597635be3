"""How a camera spreads a point of light: a lens before the pixels, sensor and software after them.

Light is blurred before it meets the pixels, and pixels are means over squares: their picture holds frequencies that
they fold back, and a blur of that picture is another one. On a plate of Tab. 3 (512 pixels; 1 % of noise is usual) the
best Gaussian in the pixels' band is 3.6, 3.5 and 2.4 % of flat light off a lens of 0.3, 0.5 and 0.7 px (root mean
square), 4 and 5 % off defocus of 0.7 px and a diffraction disc of 1.5 px, 2 % off a Gaussian of 0.5 px that is sampled
at pixels; a lens and 7 x 7 weights are 0.1 to 0.5 %, and 1 % for the disc.

    seen = w * shown + sum_k a_k (blur_k(shown) - shown),   shown = blur_band(bin(blur_lens(light on fine pixels)))

What lies beyond the weights w is a halo: rings of a diffraction disc have 4 % of its light there, and glass and sensor
scatter some. Left out it looks like stray light, and that like another index.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
import torch

from warp_caustics.extrapolated import with_photons
from warp_caustics.reconstruct.seen_camera.pixel_means import PLACED, Lay, pixel_means
from warp_caustics.resampling import blur_matrix
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

REACH = 3
"""Of the weights w [px]."""
FINENESS, MOST_FINE_PIXELS = 4, 4096
"""Fine pixels along a pixel, but no more than so many along the image: two along a pixel are 2 % of flat light off a
lens of 0.3 px, four 0.3 %."""
PHOTONS_PER_FINE_PIXEL = 2
HALOS_PX = (3.0, 9.0)
"""Standard deviations of blur_k."""
LEAST_HALO = -0.05
"""A halo is light, but for errors, and for what software sharpens."""
LEAST_ENTRY = 1e-12
"""Of a halo's matrix; below are errors of rounding. Of a picture that is zero but in places their products are too
small for usual single precision, by which a CPU takes twenty times as long."""
ALIKE = 0.003
"""Widths [px], and weights, that differ by less are the same."""


@dataclass(frozen=True)
class PointSpread:
    """Of one image's channels.

    Attributes:
        lens_px: standard deviation of a Gaussian before the pixels [px], shape [n_w].
        band_px: of one after them, within their band [px], shape [n_w].
        weights: w, after both, shape [n_w, 2 REACH + 1, 2 REACH + 1]; each channel's sum to 1.
        halos: a, shares of the light that lies in them, shape [n_w, K].
        stray: standard deviation of an image's stray light, of all channels together, by which halos there may be
            beside the told ones; 0 where nothing was asked.
    """

    lens_px: FloatArray
    band_px: FloatArray
    weights: FloatArray
    halos: FloatArray
    stray: float = 0.0

    @classmethod
    def of_lens(cls, lens_px: FloatArray) -> Self:
        """That of a lens and nothing else: standard deviations of its blur [px], shape [n_w]."""
        weights = np.zeros((len(lens_px), 2 * REACH + 1, 2 * REACH + 1))
        weights[:, REACH, REACH] = 1.0
        return cls(lens_px, np.zeros(len(lens_px)), weights, np.zeros((len(lens_px), len(HALOS_PX))))

    @classmethod
    def of_band(cls, band_px: FloatArray) -> Self:
        """That of a Gaussian after the pixels and nothing else: standard deviations [px], shape [n_w]."""
        return replace(cls.of_lens(np.zeros(len(band_px))), band_px=np.asarray(band_px, np.float64))

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> Self:
        """The one that :attr:`record` was made of."""
        names = ("lens_px", "band_px", "weights", "halos")
        lens, band, weights, halos = (np.asarray(record[name], dtype=np.float64) for name in names)
        return cls(lens, band, weights, halos, record.get("stray", 0.0))

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "lens_px": self.lens_px.tolist(),
            "band_px": self.band_px.tolist(),
            "weights": np.round(self.weights, 6).tolist(),
            "halos": np.round(self.halos, 6).tolist(),
            "stray": round(self.stray, 6),
        }

    @property
    def is_plausible(self) -> bool:
        """Whether a camera may be like that: one that is sharper than its lens by far makes up for wrong heights."""
        return bool((self.weights[:, REACH, REACH] > 0).all() and (self.halos > LEAST_HALO).all())

    def is_like(self, other: Self) -> bool:
        """Whether another one shows the same, but for what no noise of an image tells."""
        names = ("lens_px", "band_px", "weights", "halos")
        return all(np.abs(getattr(self, name) - getattr(other, name)).max() < ALIKE for name in names)

    def of_channel(self, channel: int) -> Self:
        """Of one alone."""
        kept = [channel]
        return type(self)(self.lens_px[kept], self.band_px[kept], self.weights[kept], self.halos[kept], self.stray)

    def __call__(self, fine: torch.Tensor, pixels: int, lays: Sequence[Lay] | None = None) -> torch.Tensor:
        """What the camera shows, shape [n_w, m, m], of light on fine pixels, [n_w, k m, k m].

        Args:
            fine: any unit.
            pixels: m.
            lays: where each channel's picture lay before it was brought back; None: where it belongs.
        """
        each = zip(fine, self.lens_px, self.band_px, lays or [PLACED] * len(fine), strict=True)
        shown = torch.stack(
            [pixel_means(light, pixels, float(lens), float(band), lay) for light, lens, band, lay in each]
        )
        weights = torch.as_tensor(self.weights, dtype=fine.dtype, device=fine.device)
        padded = torch.nn.functional.pad(shown[None], (REACH,) * 4, mode="replicate")
        seen: torch.Tensor = torch.nn.functional.conv2d(padded, weights[:, None], groups=len(fine))[0]
        shares = torch.as_tensor(self.halos, dtype=fine.dtype, device=fine.device)
        for k, halo in enumerate(in_halos(shown)):
            seen += shares[:, k, None, None] * halo
        return seen


def in_halos(shown: torch.Tensor) -> list[torch.Tensor]:
    """What each halo would change of pictures [..., m, m] if all light lay in it, same shape."""
    matrices = _halo_matrices(shown.shape[-1], shown.dtype, shown.device)
    return [matrix @ shown @ matrix - shown for matrix in matrices]


@lru_cache(maxsize=4)
def _halo_matrices(pixels: int, dtype: torch.dtype, device: torch.device) -> list[torch.Tensor]:
    matrices = [blur_matrix(pixels, sigma) for sigma in HALOS_PX]
    return [torch.where(matrix.abs() > LEAST_ENTRY, matrix, 0.0).to(device, dtype) for matrix in matrices]


def fine_pixels(pixels: int) -> int:
    """Fine pixels along an image of so many pixels."""
    return pixels * max(2, min(FINENESS, MOST_FINE_PIXELS // pixels))


class FineLight:
    """Caustics of reliefs on pixels so fine that a lens may be put before those of the camera.

    A picture of another size has as many more fine pixels across the plate, to a whole number on either side, of which
    those that the camera sees are shown: light that is not blurred yet is not resampled without an error, of 0.3 to
    0.5 % of flat light for pictures 0.2 to 1.5 % too large or small (root mean square, 128 pixels); 0.15 to 0.23 % are
    left.

    Args:
        simulator: a lattice of the scene, whose units and device are kept.
        size: so many times as large as the plate's the picture was taken, about.
        finer: times as many fine pixels as usual.

    Attributes:
        size: so many times as large as the plate's the light is.
    """

    def __init__(self, simulator: CausticSimulator, size: float = 1.0, finer: int = 1):
        self._simulator = simulator
        self.pixels = simulator.scene.image_pixels
        self.fine_pixels = finer * fine_pixels(self.pixels)
        self._beside = round(self.fine_pixels * (size - 1) / 2)
        self.size = 1 + 2 * self._beside / self.fine_pixels

    def lays_of_light(self, lays: Sequence[Lay] | None) -> list[Lay] | None:
        """Where channels' pictures lay on the pixels, told that the light is of its :attr:`size` already."""
        return None if lays is None else [lay._replace(of_light=self.size) for lay in lays]

    @cached_property
    def _whole(self) -> CausticSimulator:
        return self._with(PHOTONS_PER_FINE_PIXEL)

    @cached_property
    def _half(self) -> CausticSimulator:
        return self._with(PHOTONS_PER_FINE_PIXEL / 2)

    def _with(self, photons_per_pixel: float) -> CausticSimulator:
        fine = self.fine_pixels + 2 * self._beside
        return with_photons(self._simulator, round(photons_per_pixel * fine**2), fine)

    def _seen(self, light: torch.Tensor) -> torch.Tensor:
        """What the camera's pixels cover; beyond the plate's picture it is mirrored."""
        beside = self._beside
        if beside > 0:
            return light[..., beside:-beside, beside:-beside]
        return torch.nn.functional.pad(light, (-beside,) * 4, mode="reflect") if beside else light

    @torch.no_grad()
    def __call__(self, heights_m: torch.Tensor) -> torch.Tensor:
        """Irradiance [W/m^2] without the lattice's own error, shape [n_w, k m, k m], of a relief [m], shape [n, n]."""
        found: torch.Tensor = 2 * self._whole(heights_m) - self._half(heights_m)
        return self._seen(found)

    @torch.no_grad()
    def change(self, first_m: torch.Tensor, second_m: torch.Tensor) -> torch.Tensor:
        """Of reliefs less those of others, as of :meth:`~warp_caustics.simulator.CausticSimulator.change`."""
        of_half = self._half.change(first_m, second_m)
        return self._seen(self._whole.change(first_m, second_m).mul_(2).sub_(of_half))

    @torch.no_grad()
    def plain(self, heights_m: torch.Tensor, *, by_half: bool = False) -> torch.Tensor:
        """The same with the lattice's error, of all photons or of half of them."""
        found: torch.Tensor = (self._half if by_half else self._whole)(heights_m)
        return self._seen(found)
