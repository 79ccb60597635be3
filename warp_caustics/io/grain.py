"""Grain: fine variations of an image that grow with its light and that neighbouring pixels share.

Speckle, pixels of unequal sensitivity, the noise of a flat frame, lossy compression. What neighbours do not share, as
:func:`~warp_caustics.io.noise.estimate_noise_std` finds it, is a part of it: 1.5 % on a bench whose even light varies
by 2.5 %, and by 14 % where lines are five times as bright and shot noise would make 3.
"""

import numpy as np

from warp_caustics.io.noise import BoolImage, FloatImage

BACKGROUND_PX = 6.0
"""Standard deviation of the mean that fine variations are counted from."""
BLOCK = 16
"""Pixels along squares that are looked at one by one."""
FLATTEST = 0.3
"""Share of the squares, by how little their background changes, that tell."""
QUIETEST = 0.25
"""Quantile of their variances that is taken: faint light of a relief is in many, grain in all."""
FEWEST = 24
"""Squares that tell; an image with fewer tells nothing."""
LEAST_SHARE = 0.15
"""Of the white noise's variance that is grain at least: errors of both estimates are smaller."""


def estimate_grain(image: FloatImage, level: float, noise_std: float, valid: BoolImage | None = None) -> float:
    """Standard deviation of the grain, relative to the light; 0 where white noise is all there is.

    The variance of quiet squares among those near the level whose background is flattest, less that of the white noise.

    Args:
        image: one channel [W/m^2], shape [H, W].
        level: irradiance of even light [W/m^2].
        noise_std: of the white noise there, by :func:`~warp_caustics.io.noise.estimate_noise_std` [W/m^2].
        valid: pixels to use, shape [H, W]; all if not given.
    """
    from scipy import ndimage

    rows, columns = (size // BLOCK for size in image.shape)
    if rows * columns < FEWEST or not level > 0:
        return 0.0
    background = ndimage.gaussian_filter(image, BACKGROUND_PX)
    slope = np.hypot(*np.gradient(background))
    squares = [
        values[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK).swapaxes(1, 2)
        for values in ((image - background) ** 2, slope, image, np.ones(image.shape) if valid is None else valid)
    ]
    variance, slope, mean, whole = (values.mean((2, 3)) for values in squares)
    near = (whole == 1) & (mean > 0.7 * level) & (mean < 1.4 * level)
    if near.sum() * FLATTEST < FEWEST:
        return 0.0
    flat = near & (slope <= np.quantile(slope[near], FLATTEST))
    relative = variance[flat] / mean[flat] ** 2
    white = noise_std**2 / (level * mean[flat])
    grain = float(np.quantile(relative, QUIETEST) - np.median(white))
    return float(np.sqrt(grain)) if grain > LEAST_SHARE * float(np.median(white)) else 0.0
