"""Blur of an image, told by its power spectrum beside that of a simulation.

Not by differences of pixels: caustic lines that a relief a little wrong puts a pixel beside their place look like
blurred ones to a least squares fit. Power knows nothing of places. Spectra across two channels have no noise in them
(that of the channels is independent); with less than three channels the noise is fitted as a white floor.

    measured(k) = amplitude exp(-b k^2) simulated(k) [+ floor],   b = (s_i^2 + s_j^2) / 2 of channels i and j
"""

from typing import NamedTuple

import numpy as np
import torch

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
    spectra, simulations, powers, modes, k = _ring_spectra(measured, simulated, pairs)
    found = np.array(
        [
            _fitted(spectra[p], simulations[p], powers[i] * powers[j], modes, k, has_floor=i == j)
            for p, (i, j) in enumerate(pairs)
        ]
    )
    # Each pair says the mean of its two channels.
    design = np.zeros((len(pairs), channels))
    for row, (i, j) in enumerate(pairs):
        design[row, i] += 0.5
        design[row, j] += 0.5
    square, error, amplitude = found.T
    weight = 1 / error
    inverse = np.linalg.pinv(design * weight[:, None])
    # Errors of pairs go together, for it is the same relief that is wrong in all of them.
    together = np.abs(inverse).sum(axis=1) / 2
    own = inverse @ (weight * square)
    gain = np.exp(inverse @ (weight * np.log(amplitude) / 2))
    return Blur(own, together, gain)


def _ring_spectra(
    measured: torch.Tensor, simulated: torch.Tensor, pairs: list[tuple[int, int]]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mean over rings of cross spectra of both, powers of the measured, modes, and frequency [1/px]."""
    pixels, device = measured.shape[-2], measured.device
    ky = 2 * torch.pi * torch.fft.fftfreq(pixels, device=device)[:, None]
    kx = 2 * torch.pi * torch.fft.rfftfreq(pixels, device=device)[None]
    k = torch.hypot(kx, ky)
    twice = torch.full_like(k, 2.0)
    twice[:, 0] = 1.0
    rings = min(RINGS, pixels // 4)
    # The first ring, of what is as large as the image, belongs to ambient light and uneven lamps.
    ring = (k * (rings / torch.pi)).long().clamp_max(rings).flatten()

    def averaged(values: torch.Tensor) -> torch.Tensor:
        sums = torch.zeros(*values.shape[:-2], rings + 1, dtype=torch.float64, device=device)
        return sums.index_add_(-1, ring, (values * twice).flatten(-2).double())[..., 1:rings]

    modes = averaged(torch.ones_like(k))
    first, second = [i for i, _ in pairs], [j for _, j in pairs]
    parts = [(spectra[first] * spectra[second].conj()).real for spectra in (measured, simulated)]
    values = torch.cat([*parts, measured.abs().square(), (k**2)[None]])
    means = (averaged(values) / modes).cpu().numpy()
    count = len(pairs)
    return means[:count], means[count : 2 * count], means[2 * count : -1], modes.cpu().numpy(), np.sqrt(means[-1])


def _fitted(
    spectrum: FloatArray, simulated: FloatArray, powers: FloatArray, modes: FloatArray, k: FloatArray, has_floor: bool
) -> tuple[float, float, float]:
    """b [px^2], its standard error and the amplitude: least squares along a grid of b, then a finer one."""

    def misfits(grid: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        decay = np.exp(-grid[:, None] * k**2) * simulated
        columns = np.stack((decay, np.ones_like(decay)), -1) if has_floor else decay[..., None]
        scaled, wanted = columns / np.sqrt(variance)[:, None], spectrum / np.sqrt(variance)
        # Floors are of the size of spectra: no scale needs guarding.
        normal = np.einsum("gkc,gkd->gcd", scaled, scaled)
        right = np.einsum("gkc,k->gc", scaled, wanted)
        solution = np.linalg.solve(
            normal + 1e-12 * normal.max((1, 2))[:, None, None] * np.eye(len(normal[0])), right[..., None]
        )[..., 0]
        left = wanted - np.einsum("gkc,gc->gk", scaled, solution)
        return (left**2).sum(1), solution

    root = np.concatenate((-np.geomspace(0.01, 1.0, 16)[::-1], [0.0], np.geomspace(0.01, LARGEST_SQUARE, 48)))
    grid, model = root, np.abs(spectrum)
    b, error, amplitude = 0.0, LARGEST_SQUARE, 1.0
    for width in (0.0, 0.3, 0.03, 0.03):
        if width:
            grid = b + width * max(abs(b), 0.2) * np.linspace(-1, 1, 41)
        variance = (model**2 + powers) / (2 * modes) + (SCATTER * model) ** 2
        misfit, solution = misfits(grid, variance)
        best = int(misfit.argmin())
        b, amplitude = float(grid[best]), float(max(solution[best, 0], 1e-6))
        model = np.exp(-b * k**2) * simulated * amplitude
        if has_floor:
            model = model + max(float(solution[best, 1]), 0.0)
    # Half width at which the misfit has grown by its own size per ring.
    per_ring = max(float(misfit.min()) / max(len(k) - 2, 1), 1.0)
    curve = np.polyfit(grid - b, misfit, 2)[0]
    error = float(np.sqrt(per_ring / curve)) if curve > 0 else LARGEST_SQUARE
    return b, error, amplitude
