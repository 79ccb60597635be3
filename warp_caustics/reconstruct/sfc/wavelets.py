"""Heights as wavelet coefficients, with the exact adjoint of the synthesis.

Zero padding (the relief is taken to be zero beyond the plate), so there are
somewhat more coefficients than samples. Analysis is a right inverse of the
synthesis, S A = 1, but for biorthogonal wavelets not its adjoint: a gradient
over heights becomes one over coefficients by S^T, which is the analysis with
the synthesis filters reversed in time.
"""

import numpy as np
import pywt  # type: ignore[import-untyped]

from warp_caustics.errors import InputError
from warp_caustics.types import FloatArray

_MODE = "zero"


class WaveletBasis:
    """Discrete wavelet transform of [n, n] heights, coefficients as one vector.

    Args:
        samples: n.
        name: PyWavelets name of a discrete wavelet: db3, coif3, bior1.5, ...
        levels: how often the coarse part is split again; the coarsest scale is 2^levels samples.

    Raises:
        InputError: unknown wavelet, or more levels than samples.
    """

    def __init__(self, samples: int, name: str, levels: int):
        if name not in pywt.wavelist(kind="discrete"):
            raise InputError(f"wavelet {name!r} is not known; use db3, coif3, bior1.5 or another of PyWavelets")
        if not 1 <= levels <= np.log2(samples):
            limit = int(np.log2(samples))
            raise InputError(f"{levels} wavelet levels do not fit {samples} samples; use 1 to {limit}")
        self.samples, self.levels = samples, levels
        wavelet = pywt.Wavelet(name)
        self._wavelet = wavelet
        bank = [wavelet.rec_lo[::-1], wavelet.rec_hi[::-1], wavelet.dec_lo[::-1], wavelet.dec_hi[::-1]]
        self._dual = pywt.Wavelet(f"{name} dual", filter_bank=bank)
        coarse = np.zeros((samples, samples))
        self._sizes = [samples]
        for _ in range(levels):
            coarse = pywt.dwt2(coarse, wavelet, _MODE)[0]
            self._sizes.append(len(coarse))

    def analyse(self, heights: FloatArray) -> FloatArray:
        """A h: coefficients of heights [n, n], finest details first; shape [k], unit of the heights."""
        return self._split(heights, self._wavelet)

    def adjoint(self, gradient: FloatArray) -> FloatArray:
        """S^T g: gradient over coefficients, shape [k], of a gradient over heights, shape [n, n]."""
        return self._split(gradient, self._dual)

    def synthesise(self, coefficients: FloatArray) -> FloatArray:
        """S c: heights [n, n] of coefficients [k]."""
        end = len(coefficients) - self._sizes[-1] ** 2
        coarse = coefficients[end:].reshape(self._sizes[-1], -1)
        for level in range(self.levels, 0, -1):
            size = self._sizes[level]
            start = end - 3 * size**2
            details = coefficients[start:end].reshape(3, size, size)
            finer = pywt.idwt2((coarse, tuple(details)), self._wavelet, _MODE)
            # Odd sizes and padding leave more than there was.
            coarse, end = finer[: self._sizes[level - 1], : self._sizes[level - 1]], start
        heights: FloatArray = coarse
        return heights

    def _split(self, values: FloatArray, wavelet: pywt.Wavelet) -> FloatArray:
        parts: list[FloatArray] = []
        coarse = values
        for _ in range(self.levels):
            coarse, details = pywt.dwt2(coarse, wavelet, _MODE)
            parts.extend(part.ravel() for part in details)
        return np.concatenate([*parts, coarse.ravel()])

    def squared_norm(self, iterations: int = 30) -> float:
        """||S||^2, by power iteration: 1 for orthogonal wavelets, above for biorthogonal ones."""
        heights: FloatArray = np.random.default_rng(0).standard_normal((self.samples, self.samples))
        norm = 1.0
        for _ in range(iterations):
            heights = heights / np.linalg.norm(heights)
            heights = self.synthesise(self.adjoint(heights))
            norm = float(np.linalg.norm(heights))
        return norm
