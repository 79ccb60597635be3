"""Grain: fine variations of an image that grow with its light and that neighbouring pixels share.

Speckle, pixels of unequal sensitivity, the noise of a flat frame, lossy compression. What neighbours do not share, as
:func:`~warp_caustics.io.noise.estimate_noise_std` finds it, is a part of it: 1.5 % on a bench whose even light varies
by 2.5 %, and by 14 % where lines are five times as bright and shot noise would make 3.

Grain is looked for in squares of even light, around a mean over a few pixels. Such squares are not all as noisy: those
that are quiet, which tell what is no faint relief, have less than the mean of all. And of grain that is as wide as
speckle the mean takes a part along. How much both are follows from how wide the grain is.
"""

from functools import lru_cache

import numpy as np

from warp_caustics.io.noise import BoolImage, FloatImage
from warp_caustics.types import FloatArray

BACKGROUND_PX = 6.0
"""Standard deviation of the mean that fine variations are counted from."""
BLOCK = 16
"""Pixels along squares that are looked at one by one."""
FLATTEST = 0.3
"""Share of the squares, by how little their background changes, that tell."""
QUIETEST = (0.1, 0.25)
"""Quantiles of their variances of which the one is taken that makes less of the grain: faint light of a relief is in
many squares, grain in all."""
RELIEF_IN_MOST = 1.5
"""Times what noise makes of it, the median of the variances over their quarter is where relief is in most squares. Of
116 channels of random benches 110 had at most 1.33 times, all but three of them 1.1, and six had 1.6 to 3.4."""
FEWEST = 24
"""Squares that tell; an image with fewer tells nothing."""
LEAST_SHARE = 0.15
"""Of the white noise's variance that is grain at least: errors of both estimates are smaller."""
WIDTHS_PX = np.geomspace(0.3, 4.0, 60)
"""Of speckle (:mod:`warp_caustics.camera.speckle`): the one is taken whose neighbours have as much in common."""


def estimate_grain(image: FloatImage, level: float, noise_std: float, valid: BoolImage | None = None) -> float:
    """Standard deviation of the grain, relative to the light; 0 where white noise is all there is.

    The variance of quiet squares among those near the level whose background is flattest, brought to that of all
    squares and all widths, less that of the white noise.

    Args:
        image: one channel [W/m^2], shape [H, W].
        level: irradiance of even light [W/m^2].
        noise_std: of the white noise there, by :func:`~warp_caustics.io.noise.estimate_noise_std` [W/m^2].
        valid: pixels to use, shape [H, W]; all if not given.
    """
    found = _even_squares(image, level, valid)
    if found is None:
        return 0.0
    mean, variance, one, two = found
    white = float(np.median(noise_std**2 / (level * mean)))
    quarter, half = np.quantile(variance, [QUIETEST[-1], 0.5])
    if quarter - white <= LEAST_SHARE * white:
        return 0.0
    quiet = variance <= half
    width, of_all = _speckle(float(one[quiet].mean()), float(two[quiet].mean()), float(quarter))
    seen = of_all * float(covariance_left(width, 0.0))
    lower = _quiet_share(np.array([*QUIETEST, 0.5]), _freedom(round(width, 2), round(min(1.0, seen / quarter), 2)))
    if half / quarter > RELIEF_IN_MOST * lower[-1] / lower[-2]:
        return float(np.sqrt(max(0.0, np.quantile(variance, QUIETEST[0]) - white)))
    total = float((np.quantile(variance, QUIETEST) / lower[:-1]).min())
    return float(np.sqrt(max(0.0, total - white + (of_all - seen) * total / quarter)))


def _even_squares(image: FloatImage, level: float, valid: BoolImage | None) -> FloatArray | None:
    """Of squares of even light their mean, the variance of what is fine, and its covariance one and two pixels apart.

    Relative to the square of the mean, shape [4, S]; None where there are too few.
    """
    from scipy import ndimage

    rows, columns = (size // BLOCK for size in image.shape)
    if rows * columns < FEWEST or not level > 0:
        return None
    background = ndimage.gaussian_filter(image, BACKGROUND_PX)
    fine = image - background
    whole = np.ones(image.shape) if valid is None else valid
    values = (image, np.hypot(*np.gradient(background)), whole, fine**2, _products(fine, 1), _products(fine, 2))
    mean, slope, counted, *of_fine = (
        each[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK).mean((1, 3)) for each in values
    )
    near = (counted == 1) & (mean > 0.7 * level) & (mean < 1.4 * level)
    if near.sum() * FLATTEST < FEWEST:
        return None
    flat = near & (slope <= np.quantile(slope[near], FLATTEST))
    return np.stack([mean[flat], *(each[flat] / mean[flat] ** 2 for each in of_fine)])


def _products(fine: FloatImage, apart: int) -> FloatImage:
    """Of pixels so far apart, mean of both axes; shape [H, W]."""
    found = np.zeros_like(fine)
    found[:, :-apart] += fine[:, :-apart] * fine[:, apart:] / 2
    found[:-apart] += fine[:-apart] * fine[apart:] / 2
    return found


def covariance_left(width_px: float | FloatArray, apart_px: float | FloatArray) -> FloatArray:
    r"""Covariance of speckle of variance 1 after its mean over :data:`BACKGROUND_PX` was taken away.

    $$C_0 - 2 C_{B^2 / 2} + C_{B^2}, \qquad C_s(d) = \frac{w^2}{w^2 + s} e^{-d^2 / 4 (w^2 + s)},$$

    the second and third what the mean has in common with the speckle, and with itself.

    Args:
        width_px: w, standard deviation of the Gaussian that white noise was filtered with [px].
        apart_px: d [px], of a shape that goes with it.
    """
    square = np.square(width_px)
    parts = ((1.0, 0.0), (-2.0, BACKGROUND_PX**2 / 2), (1.0, BACKGROUND_PX**2))
    return np.asarray(
        sum(
            sign * square / (square + more) * np.exp(-np.square(apart_px) / (4 * (square + more)))
            for sign, more in parts
        )
    )


def _speckle(one: float, two: float, most: float) -> tuple[float, float]:
    """Width [px] and variance of speckle with such covariances one and two pixels apart, after the mean was taken away.

    No more than what is there; of nothing in common the least width and none.
    """
    if one <= 0:
        return float(WIDTHS_PX[0]), 0.0
    at_one = covariance_left(WIDTHS_PX, 1.0)
    width = float(np.interp(two / one, covariance_left(WIDTHS_PX, 2.0) / at_one, WIDTHS_PX))
    return width, min(one / float(covariance_left(width, 1.0)), most / float(covariance_left(width, 0.0)))


@lru_cache(maxsize=256)
def _freedom(width_px: float, share: float) -> float:
    """Degrees of freedom of a square's variance: 1 / nu = sum over its pairs of correlation squared / pixels^2.

    Args:
        width_px: of the speckle.
        share: of the variance that is speckle; the rest is white.
    """
    apart = np.arange(1 - BLOCK, BLOCK)
    pairs = 1 - np.abs(apart) / BLOCK
    alike = covariance_left(width_px, np.hypot(apart[:, None], apart)) / covariance_left(width_px, 0.0)
    shared = float((np.outer(pairs, pairs) * alike**2).sum())
    return BLOCK**2 / (1 + share**2 * (shared - 1))


def _quiet_share(quantiles: FloatArray, freedom: float) -> FloatArray:
    """Quantiles of a variance of so many degrees of freedom over its mean."""
    from scipy import stats

    return np.asarray(stats.chi2.ppf(quantiles, freedom) / freedom)
