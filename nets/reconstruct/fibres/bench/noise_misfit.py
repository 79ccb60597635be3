r"""What a picture leaves of an image, in squared deviations of its noise.

$$\sum_i \rho(W (y(\theta) - y) / s)_i, \qquad \rho(r) = 2 c^2 (\sqrt{1 + r^2 / c^2} - 1),$$

y in the units of what was measured, so that stray light and the lamp's evenness change what is shown and not the noise;
s each pixel's noise, grain and all, by the light that is shown there; W makes noise white that neighbours share
(:mod:`warp_caustics.reconstruct.noise_spectrum`).
"""

import torch

from nets.reconstruct.fibres.bench.bench_and_light import ShownLight
from nets.reconstruct.fibres.image.image_fit import WIDTH
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.reconstruct.image_noise import NoiseOfLight
from warp_caustics.reconstruct.noise_spectrum import Whitening

ROBUST = 3.0
"""Deviations c from which on a pixel counts less."""


class NoiseMisfit:
    """Of an image and its noise.

    Args:
        view: of the image, whose noise is told as on the even plate of the bench of ``lit``.
        lit: the light there.

    Attributes:
        measured: shape [n_w, m, m].

    Raises:
        ValueError: the noise of the image is unknown.
    """

    def __init__(self, view: LinesView, lit: ShownLight):
        whole = view.discrepancy.whole
        if whole.noise is None:
            raise ValueError("steps by the noise of an image need that noise; tell it")
        self.measured = whole.irradiance.double() * lit.factor + lit.added
        self._counts = (whole.weight > 0).double()
        self._noise_of = NoiseOfLight.of(view.image_with_noise, view.scene, self.measured.device)
        self._own_factor = lit.factor
        self._noise = whole.noise.double() * lit.factor
        self._white = Whitening.none(self._counts)

    def ask_noise(self, picture: torch.Tensor, lit: ShownLight) -> None:
        """Noise by what is shown in a light, and its spectrum by what is left."""
        self._noise = self._noise_of((picture - lit.added) / lit.factor) * self._own_factor
        self._white = Whitening.of((picture - self.measured) / self._noise, self._counts)

    def deviations(self, change: torch.Tensor) -> torch.Tensor:
        """Of a change of what is shown, shape [n_w, m, m]."""
        return self._white(change / self._noise)

    def rest(self, picture: torch.Tensor) -> torch.Tensor:
        """Deviations that a picture leaves, shape [n_w, m, m]."""
        return self.deviations(picture - self.measured)

    def weight(self, rest: torch.Tensor) -> torch.Tensor:
        """Of each pixel by its deviations, shape [n_w, m, m]: half of the slope of rho over r."""
        return self._counts / (1 + (rest / ROBUST) ** 2).sqrt()

    def left(self, picture: torch.Tensor) -> float:
        """Squared deviations of what is left by a picture, shape [n_w, m, m]."""
        far = (self.rest(picture) / ROBUST) ** 2
        return float((self._counts * 2 * ROBUST**2 * ((1 + far).sqrt() - 1)).sum())

    def as_of_fits(self, picture: torch.Tensor) -> float:
        """As fits of lines tell it (Charbonnier)."""
        rest = (picture - self.measured) * self._counts
        return float(((rest**2 + WIDTH**2).sqrt() - WIDTH).sum() / self._counts.sum())
