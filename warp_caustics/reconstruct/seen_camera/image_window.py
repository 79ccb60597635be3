"""Pictures that are compared by their spectra: faded out at the border, their mean taken off, holes filled."""

from functools import lru_cache

import torch

TAPER_PX = 16
"""Width at which images fade out at their border."""
FILLED_PX = (1.5, 6.0, 24.0)
"""Widths of the means that stand in for pixels that do not count, each far behind the one before."""


@lru_cache(maxsize=8)
def frequencies(pixels: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Of a transform of m x m pixels along x, shape [1, m / 2 + 1], and y, [m, 1], in 1/px; not to be changed."""
    ky = 2 * torch.pi * torch.fft.fftfreq(pixels, device=device)[:, None]
    kx = 2 * torch.pi * torch.fft.rfftfreq(pixels, device=device)[None]
    return kx, ky


@lru_cache(maxsize=16)
def gaussian(pixels: int, std: float, device: torch.device) -> torch.Tensor:
    """Transfer function of a blur of standard deviation std [px], shape [m, m / 2 + 1]; not to be changed."""
    kx, ky = frequencies(pixels, device)
    return torch.exp(-0.5 * std**2 * (kx**2 + ky**2))


@lru_cache(maxsize=8)
def taper(pixels: int, device: torch.device) -> torch.Tensor:
    """1 inside, falling to 0 at the border, shape [m, m]; not to be changed."""
    along = torch.arange(pixels, device=device, dtype=torch.float32)
    to_border = torch.minimum(along, along.flip(0))
    fade = torch.sin((to_border / TAPER_PX).clamp_max(1.0) * (torch.pi / 2)) ** 2
    return fade[:, None] * fade[None, :]


class ImageWindow:
    """What of the pixels of some channels is looked at.

    Args:
        weight: 1 where a pixel counts, 0 where not, shape [n_w, m, m].
        has_gaps: whether any does not.

    Attributes:
        fade: :func:`taper`, shape [m, m].
    """

    def __init__(self, weight: torch.Tensor, has_gaps: bool):
        pixels, device = weight.shape[-1], weight.device
        self.fade, self.weight, self.has_gaps = taper(pixels, device), weight, has_gaps
        self._counts = self.fade * weight if has_gaps else self.fade
        self._total = self._counts.sum(dim=(-2, -1))
        if has_gaps:
            self._smooth = sum(1e-3**k * gaussian(pixels, std, device) for k, std in enumerate(FILLED_PX))
            self._near = self._blurred(weight).clamp_min(1e-6)

    def _blurred(self, values: torch.Tensor) -> torch.Tensor:
        pixels = values.shape[-1]
        blurred: torch.Tensor = torch.fft.irfft2(torch.fft.rfft2(values) * self._smooth, s=(pixels, pixels))
        return blurred

    def centred(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Values [..., n_w, m, m] less their mean, and that mean, shape [..., n_w].

        Pixels that do not count take a mean of their neighbours: a hole with hard edges would look sharp, whatever
        the blur. The simulation gets the same holes.
        """
        mean = (values * self._counts).sum(dim=(-2, -1)) / self._total
        centred = values - mean[..., None, None]
        if self.has_gaps:
            is_seen = self.weight > 0
            filled = self._blurred(torch.where(is_seen, centred, 0.0)) / self._near
            centred = torch.where(is_seen, centred, filled)
        return centred, mean

    def transformed(self, centred: torch.Tensor) -> torch.Tensor:
        """Fourier transform (rfft2) of what :meth:`centred` gave, faded out at the border."""
        transform: torch.Tensor = torch.fft.rfft2(centred * self.fade)
        return transform
