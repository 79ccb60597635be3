"""What is left of an image where its light is even, as the relief that would bend light so.

Heights of few numbers, as lines have, cannot make up for what is none of them: a drip, a scratch, a wave of the base,
a stripe of the lamp. What they leave is little of a whole image whose lines are twenty times as bright, and less than
the noise of a pixel; of many pixels together it is not. Where light is even, a relief that is low and smooth changes it
by

    E - 1 = - laplace(phi),   phi = (n - 1) D h,

(:mod:`warp_caustics.found_bench.thin_relief`, to first order), so that what is left is the relief that is missing,
or light that is not even, which looks the same: a Poisson equation, no slope on the rim, solved in cosines.

Only what is clearly left counts: more than noise leaves of means over ``MEAN_M``, and more than flat frames are wrong
by. Noise that neighbours share leaves more of such means than white noise: 2 % of speckle, a pixel wide, 3.5 times as
much, which looked like 2 um of relief all over 12 of 15 own plates of an ordinary bench, whose bare plate is 0.005 um
off at most. So it is told by what is left of waves that are shorter than those of a relief. Waves longer than
``LONGEST_M`` are left out: there a thousandth of light is tens of micrometres.
"""

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.reconstruct.rest import Rest
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

MEAN_M, LEAST_MEAN_PX = 0.4e-3, 1.5
"""Standard deviation of what is averaged over; but at least so many pixels."""
SIGNIFICANT = 6.0
"""Standard deviations of such means' noise, above which something is left: a whole image of noise has 4.5."""
LEAST_LIGHT = 3e-3
"""Of a flat plate's light, below which nothing is said: flat frames are as wrong, and what grain leaves of means."""
SHORTER = 0.5
"""Of that standard deviation, and as large a one: the difference of both means is of waves three times as long, which
no relief is looked for in. Of fewer than 500 pixels along a plate these are so fine that neighbours share less of
their noise: what they tell is too little by up to 1.6 there."""
NORMAL = 1.4826
"""Standard deviations of a normal distribution in the median of its absolute values: a drip here and there, or a
scratch, is not counted as noise."""
MOSTLY = 0.5
"""Share of such a mean that must be of even light."""
WHOLE = 0.95
"""Share of a mean that must be of even light for noise to be told by it."""
RIM_M, LEAST_RIM_PX = 0.6e-3, 4
"""What is not looked at along the picture's edge, which lies in these pixels where lamp or place are not as told."""
NEAR = 2.0
"""Around what is clearly left, that counts as well, in standard deviations of what is averaged over."""
SHORTEST_M, LONGEST_M = 0.8e-3, 10e-3
"""Wave lengths of what is told, from a line's width up."""
SPREAD_SAMPLES = 2.0
"""Over which the size of what is missing is told: where exactly its flanks are does not matter."""


def relief_left(rest: Rest, scene: Scene) -> FloatArray:
    """The relief that would leave what is left of even light [m], shape [n, n]; 0 where that is noise.

    Args:
        rest: of the image.
        scene: the bench.
    """
    weight = rest.measurement.weight.double() / rest.variance
    weight = weight.sum(0)
    mean = (rest.left / rest.variance).sum(0) / weight.clamp_min(1e-12)
    even, _ = rest.regions()
    return as_relief(_numpy(mean), _numpy(weight * even * _within_rim(even, scene)), scene)


def _within_rim(even: torch.Tensor, scene: Scene) -> torch.Tensor:
    """1 where pixels are farther than the rim from the picture's edge, else 0, shape [m, m]."""
    rim = max(LEAST_RIM_PX, round(RIM_M * len(even) / max(scene.plate_size_m)))
    inside = torch.zeros_like(even)
    inside[rim:-rim, rim:-rim] = True
    return inside


def as_relief(light: FloatArray, weight: FloatArray, scene: Scene) -> FloatArray:
    """The relief that changes even light so [m], shape [n, n]; 0 where it is noise.

    Args:
        light: difference, relative to that of a flat plate, shape [m, m].
        weight: inverse of its variance, 0 where light is not even, shape [m, m].
        scene: the bench.
    """
    shown = np.where(left_clearly(light, weight, scene), light, 0.0)
    n, pixels = scene.height_samples, len(light)
    waves = scipy.fft.dctn(shown, norm="ortho")
    size_x, size_y = scene.plate_size_m
    along = np.pi * np.arange(pixels)
    squared = (along[:, None] / size_y) ** 2 + (along[None, :] / size_x) ** 2
    longest, shortest = ((2 * np.pi / length) ** 2 for length in (LONGEST_M, SHORTEST_M))
    told = np.exp(-squared / shortest) * (1 - np.exp(-((squared / longest) ** 2)))
    phi = waves * told / np.where(squared > 0, squared, np.inf)
    # The first cosines are those of the coarser grid: no wave as short as its samples is left.
    kept = min(n, pixels)
    coarse = np.zeros((n, n))
    coarse[:kept, :kept] = phi[:kept, :kept]
    heights: FloatArray = scipy.fft.idctn(coarse, norm="ortho") * (n / pixels) / ThinRelief.of(scene).linear
    return heights


def left_clearly(light: FloatArray, weight: FloatArray, scene: Scene) -> BoolArray:
    """Where even light differs by more than noise and flat frames do, and near that, shape [m, m].

    Args:
        light: difference, relative to that of a flat plate, shape [m, m].
        weight: inverse of its variance, 0 where light is not even, shape [m, m].
        scene: the bench.
    """
    size = len(light) / max(scene.plate_size_m)
    pixels = max(LEAST_MEAN_PX, size * MEAN_M)

    def mean(values: FloatArray) -> FloatArray:
        # Without what would lie beyond the rim: mirrored, it would count twice.
        return np.asarray(scipy.ndimage.gaussian_filter(values, pixels, mode="constant"))

    counted = np.maximum(mean(weight), 1e-12)
    # Of the mean of white noise over a Gaussian.
    sigma = np.sqrt(1 / counted / (4 * np.pi * pixels**2)) * noise_shared(light * np.sqrt(weight), weight > 0, pixels)
    is_even = mean(np.where(weight > 0, 1.0, 0.0)) > MOSTLY * mean(np.ones_like(weight))
    clear = (np.abs(mean(light * weight) / counted) > np.maximum(SIGNIFICANT * sigma, LEAST_LIGHT)) & is_even
    near = scipy.ndimage.binary_dilation(clear, iterations=round(NEAR * pixels)) if clear.any() else clear
    return np.asarray(near & (weight > 0))


def noise_shared(deviations: FloatArray, counts: BoolArray, pixels: float) -> float:
    """By how much noise leaves more of means than if each pixel erred by itself; at least 1.

    Args:
        deviations: in units of each pixel's noise, 0 where none counts, shape [m, m].
        counts: which do, same shape.
        pixels: standard deviation of what means are taken over [px].
    """
    near, far = SHORTER * pixels, pixels

    def mean(values: FloatArray, over: float) -> FloatArray:
        return np.asarray(scipy.ndimage.gaussian_filter(values, over, mode="constant"))

    whole = counts & (mean(counts.astype(float), far) > WHOLE)
    if not whole.any():
        return 1.0
    apart = np.abs(mean(deviations, near) - mean(deviations, far))[whole]
    # Of white noise: the integral of the square of the difference of both Gaussians.
    white = (1 / near**2 + 1 / far**2 - 4 / (near**2 + far**2)) / (4 * np.pi)
    return max(1.0, NORMAL * float(np.median(apart)) / float(np.sqrt(white)))


def size_of(heights_m: FloatArray) -> FloatArray:
    """How large a relief is around each sample, root mean square [m], shape [n, n]."""
    size: FloatArray = np.sqrt(np.maximum(scipy.ndimage.gaussian_filter(np.square(heights_m), SPREAD_SAMPLES), 0.0))
    return size


def _numpy(values: torch.Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
