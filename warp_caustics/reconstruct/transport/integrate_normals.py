"""From slopes to heights, and where the bare plate lies.

Heights are sums of cosines with free edges, sampled at cell centres. Their
slopes are then sums of sines and cosines, and the least-squares heights for
given slopes (p, q) follow mode by mode (Frankot and Chellappa 1988, IEEE PAMI 10,
439, their projection onto integrable slopes, with the cosine transform for the
free edges instead of the Fourier transform):

    H(k) = -(k_x P(k) + k_y Q(k)) / (k_x^2 + k_y^2),    P, Q sine spectra along the slope, cosine ones across.
"""

import math

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.one_thread import one_thread
from warp_caustics.types import FloatArray

FEW_MODES, LEVEL_MODES = 4, 10
"""Cosine modes per axis of the plate's apparent bend: to learn how large it is, and to describe it."""

LEVEL_SAMPLES = 64
"""Samples per side on which that bend is fitted."""

LEVEL_STEPS = 30
"""Reweighted fits; the width of what counts as bare falls by a quarter each."""

LIGHT_ERROR = 5e-4
"""Error of the irradiance per cosine mode, relative to the radiosity, that the bend may make up for. At the border
of a plate light is lost and doubled in ways no image shows; seen so far: up to 4e-4."""

FAST_MODES_FACTOR = 3.0
"""Light errors of fast modes may be so much larger than those of the slowest typically are."""

BARE_WIDTH_M = 5e-6
"""Bare plate is known that well from its caustic [m]."""

CORRELATED_SAMPLES = 16
"""Errors of neighbouring samples are alike: so many count as one."""


def integrate_slopes(slopes: FloatArray, plate_size_m: tuple[float, float]) -> FloatArray:
    """Heights whose slopes come closest to given ones in the mean square.

    Args:
        slopes: (dh/dx, dh/dy) at the centres of the cells, shape [2, N, N].
        plate_size_m: extent along x and y [m].

    Returns:
        Cosine spectrum (orthonormal DCT-II) of the heights [m], mean 0, shape [N, N].
    """
    wave_x, wave_y = (_wave_numbers(slopes.shape[1], length) for length in plate_size_m)
    along_x = scipy.fft.dct(_sine_spectrum(slopes[0], 1), axis=0, norm="ortho")
    along_y = scipy.fft.dct(_sine_spectrum(slopes[1], 0), axis=1, norm="ortho")
    squared = wave_x[None, :] ** 2 + wave_y[:, None] ** 2
    squared[0, 0] = 1.0
    spectrum: FloatArray = -(wave_x[None, :] * along_x + wave_y[:, None] * along_y) / squared
    spectrum[0, 0] = 0.0
    return spectrum


def heights_of(spectrum: FloatArray, samples: int) -> FloatArray:
    """Heights of a cosine spectrum at the centres of samples x samples cells; what those cannot hold is left out."""
    count = len(spectrum)
    kept = np.zeros((samples, samples))
    common = min(count, samples)
    kept[:common, :common] = spectrum[:common, :common]
    heights: FloatArray = scipy.fft.idctn(kept, norm="ortho") * (samples / count)
    return heights


def _wave_numbers(count: int, length_m: float) -> FloatArray:
    return np.arange(count) * (math.pi / length_m)


def _sine_spectrum(values: FloatArray, axis: int) -> FloatArray:
    """Orthonormal DST-II, entry j for the sine that belongs to cosine j; entry 0 is 0."""
    spectrum: FloatArray = np.roll(scipy.fft.dst(values, type=2, axis=axis, norm="ortho"), 1, axis=axis)
    # The last sine has no cosine: it alternates from cell to cell.
    first = [slice(None)] * values.ndim
    first[axis] = slice(0, 1)
    spectrum[tuple(first)] = 0.0
    return spectrum


def plate_bend(heights: FloatArray, plate_size_m: tuple[float, float], strength_m: float) -> FloatArray:
    """The smooth surface that the bare plate seems to lie on.

    An image tells slow bends of the plate badly: an irradiance off by e in a mode of wave number
    k bends it by e / ((1 - 1/n) d k^2), micrometres for 1e-5. But prints leave part of the plate
    bare, and bare plate is flat: a surface is fitted to the lower side of the heights, stiff
    by how far light errors of :data:`LIGHT_ERROR` could bend it. Its mean is free.

    Args:
        heights: [m], shape [n, n].
        plate_size_m: extent along x and y [m].
        strength_m: (1 - 1/n) d [m].

    Returns:
        [m], shape [n, n].
    """
    # A plate without bend must not be bent by the foot of a wide relief: the slowest modes, which no relief looks
    # like, tell how large light errors are, and the others are held to that.
    _, errors = _fitted_bend(heights, plate_size_m, strength_m, FEW_MODES, LIGHT_ERROR)
    typical = float(np.sqrt(np.mean(errors.ravel()[1:] ** 2)))
    allowed = min(LIGHT_ERROR, FAST_MODES_FACTOR * typical)
    return _fitted_bend(heights, plate_size_m, strength_m, LEVEL_MODES, allowed)[0]


def _fitted_bend(
    heights: FloatArray, plate_size_m: tuple[float, float], strength_m: float, modes: int, light_error: float
) -> tuple[FloatArray, FloatArray]:
    """The bend [m], shape [n, n], and the light errors that its modes stand for, shape [modes, modes]."""
    n = len(heights)
    modes = min(modes, n)
    index = np.arange(0, n, max(1, n // LEVEL_SAMPLES))
    cosines = np.cos(np.arange(modes)[:, None] * (math.pi / n) * (np.arange(n) + 0.5))
    few = torch.from_numpy(cosines[:, index])
    # Modes are products of cosines along y and x, and products of two modes of such products: samples are summed
    # axis by axis, a fortieth of the work of a matrix with a column for each mode.
    pairs = (few[:, None] * few[None]).flatten(0, 1)
    values = torch.from_numpy(heights[np.ix_(index, index)].astype(np.float64))
    wave_x, wave_y = (_wave_numbers(modes, length) for length in plate_size_m)
    squared = wave_x[None, :] ** 2 + wave_y[:, None] ** 2
    # The mean is free; RMS of a mode is half its amplitude.
    per_height = strength_m * squared / 2
    stiffness = (per_height / max(light_error, 1e-12)).ravel() ** 2
    bend = torch.full_like(values, float(np.quantile(values, 0.1)))
    width = max(float(values.std(correction=0)), BARE_WIDTH_M)
    held = torch.diag(torch.from_numpy(stiffness))
    held[0, 0] += 1e-12 / BARE_WIDTH_M**2
    with one_thread():
        for _ in range(LEVEL_STEPS):
            # Weights of rho(r) = r^2 / (1 + r^2) (Geman and McClure 1987) for what is above; what is below counts in
            # full.
            above = (values - bend).clamp_min(0.0) / width
            weight = 1 / ((1 + above**2) * width) ** 2 / CORRELATED_SAMPLES
            products = (pairs @ weight @ pairs.T).reshape(modes, modes, modes, modes)
            normal = products.transpose(1, 2).reshape(modes**2, modes**2) + held
            right = few @ (weight * values) @ few.T
            amplitudes = torch.linalg.solve(normal, right.flatten()).reshape(modes, modes)
            bend = few.T @ amplitudes @ few
            width = max(BARE_WIDTH_M, 0.75 * width)
    spectrum: FloatArray = amplitudes.numpy()
    surface: FloatArray = cosines.T @ spectrum @ cosines
    return surface, spectrum * per_height
