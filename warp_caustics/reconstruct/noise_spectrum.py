r"""Noise that neighbouring pixels share, made white.

Speckle, unequal pixels and demosaicing give neighbours the same noise. Over a few pixels means of it are as noisy as
one pixel, and finer than that there is hardly any: 2 % of speckle as wide as a pixel beside 1.5 % of each pixel's own
have 17 times the power of white noise of the same variance in what is wider than 50 pixels, 0.4 times in the finest.
Least squares that take it for white believe in the one too much, and in the other, where caustics are sharp, too
little. Generalised least squares divide its spectrum out (Aitken 1935):

$$\sum_k \frac{|F_k(r / s)|^2}{S(|k|)},$$

r what is left, s each pixel's noise, S the mean of |F(r / s)|^2 over frequencies that are as large.

Limits: one spectrum for an image, though noise of dark pixels is finer than that of bright ones, which costs some of
what it tells and bends nothing; and what is left must be mostly noise.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch

BINS = 40
"""Of frequencies, by their logarithm, between which S is interpolated."""


@dataclass(frozen=True)
class Whitening:
    """Divides the spectrum of noise out of pictures.

    Attributes:
        counts: 1 where a pixel counts, 0 where not, shape [n_w, m, m], float64.
        gain: 1 / sqrt(S), shape [n_w, m, m // 2 + 1].
    """

    counts: torch.Tensor
    gain: torch.Tensor

    @classmethod
    def none(cls, counts: torch.Tensor) -> Self:
        """Of noise that is white.

        Args:
            counts: 1 where a pixel counts, 0 where not, shape [n_w, m, m], float64.
        """
        channels, pixels = len(counts), counts.shape[-1]
        return cls(counts, counts.new_ones(channels, pixels, pixels // 2 + 1))

    @classmethod
    def of(cls, left: torch.Tensor, counts: torch.Tensor) -> Self:
        """By what is left of an image.

        Args:
            left: in standard deviations of each pixel, mostly noise, shape [n_w, m, m], float64.
            counts: 1 where a pixel counts, 0 where not, same shape.
        """
        pixels = left.shape[-1]
        seen = counts.sum((-2, -1), keepdim=True).clamp_min(1)
        power = (torch.fft.rfft2(left * counts).abs() ** 2 / seen).cpu().numpy()
        along, across = np.fft.fftfreq(pixels)[:, None], np.fft.rfftfreq(pixels)[None]
        place = np.log(np.clip(pixels * np.hypot(along, across), 1, pixels / 2)) / np.log(pixels / 2) * (BINS - 1)
        each = np.rint(place).astype(int).ravel()
        number = np.bincount(each, minlength=BINS)
        known = number > 0
        where = np.bincount(each, place.ravel(), BINS)[known] / number[known]
        gains = []
        for channel in power:
            mean = np.bincount(each, channel.ravel(), BINS)[known] / number[known]
            spectrum = np.exp(np.interp(place, where, np.log(np.maximum(mean, 1e-12))))
            gains.append(spectrum**-0.5)
        return cls(counts, torch.as_tensor(np.stack(gains), device=left.device))

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """Values in standard deviations of each pixel, [n_w, m, m], as they would be if its noise were white."""
        spectrum = torch.fft.rfft2(values.double() * self.counts) * self.gain
        white: torch.Tensor = torch.fft.irfft2(spectrum, s=values.shape[-2:]) * self.counts
        return white
