"""The metric of the descent: in which sense a step is small.

For small slopes the image depends on the heights through their curvature,
E - 1 = (1 - 1/n) d Laplacian(h), so height modes of long wavelength hardly change
it. The ``curvature`` metric steps in Laplacian(h) instead of h (a Sobolev
gradient, Neuberger 1997): all modes then
converge alike, in a few dozen L-BFGS steps from a flat start. Where the light
paths cross (folds) that very freedom leads astray, and small local steps, the
``height`` metric, keep to the given start.
"""

import math

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import FloatArray


class CurvatureMetric:
    """Change of variables h = K u, with K close to the inverse of d image / d h.

    K is diagonal in the cosine transform (free edges): 1 / ((1 - 1/n) d (k^2 + k0^2)),
    k0 half the lowest mode. The mean is not a variable: one image hardly shows it.

    Args:
        samples: n.
        plate_size_m: extent along x and y [m].
        strength_m: (1 - 1/n) d [m].
    """

    def __init__(self, samples: int, plate_size_m: tuple[float, float], strength_m: float):
        mode = np.arange(samples)
        squared = [(2 - 2 * np.cos(math.pi * mode / samples)) * (samples / length) ** 2 for length in plate_size_m]
        laplacian = squared[0][None, :] + squared[1][:, None]
        lowest = math.pi / max(plate_size_m)
        self.gain = 1 / (strength_m * (laplacian + (lowest / 2) ** 2))
        self.gain[0, 0] = 0.0

    def apply(self, u: FloatArray) -> FloatArray:
        """K u; K is symmetric, so this is its adjoint too. Shape [n, n]."""
        spectrum = scipy.fft.dctn(u, norm="ortho") * self.gain
        heights: FloatArray = scipy.fft.idctn(spectrum, norm="ortho")
        return heights
