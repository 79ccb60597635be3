"""How far lines may be from where steps by noise end, by nothing but the noise of the image.

Laplace's approximation, as of :mod:`~nets.reconstruct.fibres.bench.line_posterior`; but each pixel errs by itself, what
neighbours share divided out, and the lens's numbers are open beside bench and light. By the information A of the last
derivatives the covariance is its inverse, of which the lens's rows and columns are left out.
"""

import numpy as np

from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from warp_caustics.prints.line_shape import COSINE_HALF, Shape, half_height
from warp_caustics.prints.model import WIDTH
from warp_caustics.types import FloatArray

RIDGE = 1e-9
"""Of the scaled matrix, that keeps lines on top of each other apart, which are one number in single precision."""


def noise_posterior(
    information: FloatArray, shape: Shape, places: tuple[int, ...], n_lines: int, n_beside: int
) -> JointCovariance:
    """Of lines, their section, bench and light, by the information of all numbers in the units of steps by noise.

    Args:
        information: of 6 L numbers of lines, S of their section, K of bench and light and those of a lens, with what is
            believed of them, shape [N, N].
        shape: of the lines where it was taken.
        places: of the S numbers in it.
        n_lines: L.
        n_beside: K.
    """
    scale = np.sqrt(np.diag(information))
    scaled = information / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    kept = 6 * n_lines + len(places) + n_beside
    matrix: FloatArray = (np.linalg.inv(scaled) / np.outer(scale, scale))[:kept, :kept]
    if places:
        # Widths are told as of a cosine that is as wide at half its height.
        by = np.ones(kept)
        by[WIDTH : 6 * n_lines : 6] = COSINE_HALF / half_height(shape)
        matrix = matrix * np.outer(by, by)
    return JointCovariance(matrix, places, is_by_noise=True)
