"""Blur of an image, told by its power spectrum beside that of a simulation.

Not by differences of pixels: caustic lines that a relief a little wrong puts a pixel beside their place look like
blurred ones to a least squares fit. Power knows nothing of places. Spectra across two channels have no noise in them
(that of the channels is independent); with less than three channels the noise is fitted as a white floor.

    measured(k) = amplitude exp(-b k^2) simulated(k) [+ floor],   b = (s_i^2 + s_j^2) / 2 of channels i and j
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from warp_caustics.reconstruct.seen_camera.image_window import frequencies
from warp_caustics.types import FloatArray

RINGS = 32
"""Frequencies up to that of the pixels are averaged over so many rings."""
SCATTER = 0.05
"""Relative scatter of a ring's ratio where lines are few or misplaced, beside that of its number of modes."""
LARGEST_SQUARE = 25.0
"""Of the blur [px^2] that is looked for."""
SIGNIFICANT = 4.0
"""Standard errors from 0 below which a blur is none."""
LEAST_SQUARE = 0.09
"""Blur [px^2] (0.3 px) below which it is none: photon footprints differ by 0.2 px, channels that were moved are
softened by up to 0.37, and it is nothing to a refinement."""


class Blur(NamedTuple):
    """What spectra tell of each channel, shapes [n_w]."""

    square: FloatArray
    """Variance of the PSF [px^2], may come out below 0."""
    error: FloatArray
    """Its standard error [px^2]."""
    gain: FloatArray
    """Amplitude of the structure, against the simulation."""

    def std_px(self) -> FloatArray:
        """Standard deviation [px]; exactly 0 where it cannot be told from 0."""
        is_told = self.square > np.maximum(SIGNIFICANT * self.error, LEAST_SQUARE)
        return np.asarray(np.where(is_told, np.sqrt(np.maximum(self.square, 0.0)), 0.0))


def estimated_blur(measured: torch.Tensor, simulated: torch.Tensor) -> Blur:
    """Blur of each channel.

    Args:
        measured: Fourier transforms (rfft2) of the channels, windowed, aligned, shape [n_w, m, m / 2 + 1].
        simulated: of the simulation in the same window.
    """
    channels = len(measured)
    pairs = [(i, j) for i in range(channels) for j in range(i, channels) if (i < j) == (channels > 2)]
    spectra, simulations, powers, rings = _ring_spectra(measured, simulated, pairs)
    noise = np.stack([powers[i] * powers[j] for i, j in pairs])
    square, error, amplitude = _fitted(spectra, simulations, noise, rings, has_floor=channels < 3)
    # Each pair says the mean of its two channels.
    design = np.zeros((len(pairs), channels))
    for row, (i, j) in enumerate(pairs):
        design[row, i] += 0.5
        design[row, j] += 0.5
    weight = 1 / error
    inverse = np.linalg.pinv(design * weight[:, None])
    # Errors of pairs go together, for it is the same relief that is wrong in all of them.
    together = np.abs(inverse).sum(axis=1) / 2
    own = inverse @ (weight * square)
    gain = np.exp(inverse @ (weight * np.log(amplitude) / 2))
    return Blur(own, together, gain)


class _Rings(NamedTuple):
    """Frequencies of a transform, ring by ring."""

    order: torch.Tensor
    """Their places in the flattened transform, without those of the first ring, and of the corners."""
    ends: torch.Tensor
    """Where each ring ends in that order."""
    weight: torch.Tensor
    """How often each counts: twice, for its conjugate, but for those along y; in that order, float64."""
    modes: FloatArray
    """How many a ring has, conjugates counted."""
    k: FloatArray
    """Root mean square frequency of a ring [1/px]."""


@lru_cache(maxsize=4)
def _rings(pixels: int, device: torch.device) -> _Rings:
    kx, ky = frequencies(pixels, torch.device("cpu"))
    k, rings = torch.hypot(kx, ky).flatten(), min(RINGS, pixels // 4)
    ring, size = (k * (rings / torch.pi)).long().numpy(), k.double().numpy()
    weight = np.where(np.arange(kx.shape[1]) == 0, 1.0, 2.0) * np.ones((pixels, 1))
    # The first ring, of what is as large as the image, belongs to ambient light and uneven lamps.
    order = np.argsort(ring, kind="stable")
    order = order[(ring[order] > 0) & (ring[order] < rings)]
    ends = np.cumsum(np.bincount(ring[order], minlength=rings)[1:])
    weight = weight.ravel()[order]
    begins = np.concatenate(([0], ends[:-1]))
    modes = np.add.reduceat(weight, begins)
    mean = np.sqrt(np.add.reduceat(weight * size[order] ** 2, begins) / modes)
    places, last, twice = (torch.as_tensor(values, device=device) for values in (order, ends - 1, weight))
    return _Rings(places, last, twice, modes, mean)


def _ring_spectra(
    measured: torch.Tensor, simulated: torch.Tensor, pairs: list[tuple[int, int]]
) -> tuple[FloatArray, FloatArray, FloatArray, _Rings]:
    """Mean over rings of cross spectra of both, shape [pairs, rings], and powers of the measured, [n_w, rings]."""
    rings = _rings(measured.shape[-2], measured.device)
    values = torch.stack((measured, simulated)).flatten(2)[..., rings.order]
    crossed = [(both[i] * both[j].conj()).real for both in values for i, j in pairs]
    parts = torch.cat((torch.stack(crossed), values[0].abs().square())).double() * rings.weight
    # Sums of rings as differences of running sums: no two threads add to one number, so that it is always the same.
    sums = parts.cumsum(-1)[:, rings.ends].cpu().numpy()
    means = np.diff(sums, axis=1, prepend=0.0) / rings.modes
    count = len(pairs)
    return means[:count], means[count : 2 * count], means[2 * count :], rings


def _fitted(
    spectrum: FloatArray, simulated: FloatArray, powers: FloatArray, rings: _Rings, has_floor: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """b [px^2], its standard error and the amplitude of each pair, shapes [P], from spectra of shape [P, rings].

    Least squares along a grid of b, then a finer one about the best.
    """
    k, modes = rings.k, rings.modes

    def misfits(grid: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        decay = np.exp(-grid[..., None] * k**2) * simulated[:, None]
        columns = np.stack((decay, np.ones_like(decay)), -1) if has_floor else decay[..., None]
        scaled, wanted = columns / np.sqrt(variance)[:, None, :, None], spectrum / np.sqrt(variance)
        # Floors are of the size of spectra: no scale needs guarding.
        normal = scaled.swapaxes(-1, -2) @ scaled
        right = scaled.swapaxes(-1, -2) @ wanted[:, None, :, None]
        ridge = 1e-12 * normal.max((2, 3), keepdims=True) * np.eye(normal.shape[-1])
        solution = np.linalg.solve(normal + ridge, right)
        left = wanted[:, None] - (scaled @ solution)[..., 0]
        return (left**2).sum(-1), solution[..., 0]

    root = np.concatenate((-np.geomspace(0.01, 1.0, 16)[::-1], [0.0], np.geomspace(0.01, LARGEST_SQUARE, 48)))
    pairs = np.arange(len(spectrum))
    grid, model, b = np.tile(root, (len(pairs), 1)), np.abs(spectrum), np.zeros(len(pairs))
    misfit, amplitude = np.zeros_like(grid), np.ones(len(pairs))
    for width in (0.0, 0.3, 0.03, 0.03):
        if width:
            grid = b[:, None] + width * np.maximum(np.abs(b), 0.2)[:, None] * np.linspace(-1, 1, 41)
        variance = (model**2 + powers) / (2 * modes) + (SCATTER * model) ** 2
        misfit, solution = misfits(grid, variance)
        best = misfit.argmin(axis=1)
        b, amplitude = grid[pairs, best], np.maximum(solution[pairs, best, 0], 1e-6)
        model = np.exp(-b[:, None] * k**2) * simulated * amplitude[:, None]
        if has_floor:
            model = model + np.maximum(solution[pairs, best, 1], 0.0)[:, None]
    # Half width at which the misfit has grown by its own size per ring.
    per_ring = np.maximum(misfit.min(axis=1) / max(len(k) - 2, 1), 1.0)
    curve = np.array([np.polyfit(grid[p] - b[p], misfit[p], 2)[0] for p in pairs])
    error = np.where(curve > 0, np.sqrt(per_ring / np.where(curve > 0, curve, 1.0)), LARGEST_SQUARE)
    return b, error, amplitude
