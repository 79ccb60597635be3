"""Pixels of the sensor that lie: hot in the dark frame, dead in the flat field, odd among their neighbours.

A caustic line is bright too, but a lens spreads it over more than a pixel and
along its length: some neighbour is nearly as bright. A hot pixel towers over
all eight. Where the lens is so sharp that a point of light falls on a single
pixel, the test among neighbours would remove it; switch it off there.
"""

import numpy as np

from warp_caustics.capture.preview import preview, preview_marks
from warp_caustics.capture.stage import CaptureStage, Work
from warp_caustics.io.median import median_5x5
from warp_caustics.io.noise import BoolImage, FloatImage

DARK_SIGMAS = 8.0
"""Distance from the dark frame's level, in its own noise, from which a pixel is hot."""
NEIGHBOUR_SIGMAS = 8.0
"""Distance from all neighbours, in the noise expected at that brightness."""
NEIGHBOUR_SHARE = 0.5
"""Distance from all neighbours as part of the neighbours' own range and brightness: what optics could have made."""
DEAD_SHARE = 0.5
MAX_SHARE = 0.02
"""More hot pixels than that are no defects but a wrong frame or a wrong test."""


def replace_hot_pixels(work: Work, dark: FloatImage | None) -> None:
    """Replace pixels that lie in signal and flat field, and mask them.

    Args:
        work: signal in counts without offset.
        dark: dark frame as it was taken, shape [C, H, W].
    """
    before = preview(work.signal)
    bad = np.stack([odd_among_neighbours(signal) for signal in work.signal])
    bad &= work.mask  # a saturated pixel is none
    by_neighbours = int(bad.sum())
    if dark is not None:
        bad |= np.stack([hot_in_dark(frame) for frame in dark])
    if work.light is not None:
        bad |= np.stack([dead_in_flat(frame, work.region) for frame in work.light])
    share = float(bad.mean())
    if share > MAX_SHARE:
        work.warnings.append(
            f"{share:.1%} of the pixels look hot (limit {MAX_SHARE:.0%}), which no sensor has; they were kept. "
            "Check the dark frame, or say hot_pixels: false"
        )
        return
    work.signal = np.stack([replaced(signal, odd) for signal, odd in zip(work.signal, bad, strict=True)])
    work.mask &= ~bad
    count = int(bad.sum())
    text = f"{count} hot or dead pixels replaced and masked ({by_neighbours} of them stand out of their neighbours)"
    work.done("hot pixels", text, before, hot_pixels=float(count), by_neighbours=float(by_neighbours))
    marks = np.unique(np.argwhere(bad)[:, :0:-1], axis=0).astype(np.float64)
    last = work.stages.pop()
    shown = preview_marks(marks, work.signal.shape[1:])
    work.stages.append(CaptureStage(last.name, last.text, last.before, last.after, shown, last.figures))
    if work.light is not None:
        work.light = np.stack([replaced(frame, odd) for frame, odd in zip(work.light, bad, strict=True)])


def hot_in_dark(dark: FloatImage) -> BoolImage:
    """Pixels of a dark frame that stand out, shape [H, W]; they have their own dark current and its noise."""
    rest = dark - median_5x5(dark)
    spread = 1.4826 * float(np.median(np.abs(rest)))
    return np.asarray(np.abs(rest) > DARK_SIGMAS * max(spread, 1e-12), bool)


def dead_in_flat(flat: FloatImage, region: BoolImage | None) -> BoolImage:
    """Pixels that see less than half of the light that their neighbours see in the flat field, shape [H, W].

    Args:
        flat: flat field without offset, shape [H, W].
        region: pixels in the window, whose border is no defect; None if all are.
    """
    from scipy import ndimage

    dead = flat < DEAD_SHARE * median_5x5(flat)
    return np.asarray(dead if region is None else dead & ndimage.binary_erosion(region, iterations=3), bool)


def odd_among_neighbours(signal: FloatImage) -> BoolImage:
    """Pixels that tower above, or lie below, all eight neighbours by more than noise and optics explain.

    Args:
        signal: one channel after dark subtraction [counts], shape [H, W].

    Returns:
        True where odd, shape [H, W].
    """
    from scipy import ndimage

    ring = np.ones((3, 3), bool)
    ring[1, 1] = False
    highest = ndimage.maximum_filter(signal, footprint=ring, mode="mirror")
    lowest = ndimage.minimum_filter(signal, footprint=ring, mode="mirror")
    noise = _noise(signal, ring)
    optics = NEIGHBOUR_SHARE * np.maximum(highest - lowest, np.maximum(highest, 0.0))
    limit = np.maximum(NEIGHBOUR_SIGMAS * noise, optics)
    # A dead pixel is dark by all of its light; a dark spot between caustic lines keeps neighbours that are dark too.
    dark_limit = np.maximum(NEIGHBOUR_SIGMAS * noise, np.maximum(NEIGHBOUR_SHARE * lowest, highest - lowest))
    return np.asarray((signal > highest + limit) | (signal < lowest - dark_limit), bool)


def _noise(signal: FloatImage, ring: BoolImage) -> FloatImage:
    """Standard deviation of the pixel noise at each pixel's brightness, as shot noise and a floor, shape [H, W]."""
    from scipy import ndimage

    local = ndimage.median_filter(signal, footprint=ring, mode="mirror")
    deviation = np.abs(signal - local).ravel()
    order = np.argsort(local, axis=None)
    bins = np.array_split(order, max(1, min(32, order.size // 512)))
    level = np.array([max(float(local.ravel()[part].mean()), 0.0) for part in bins])
    # The lower quartile: structure raises the deviation in most pixels of a busy picture, noise in all.
    spread = np.array([float(np.quantile(deviation[part], 0.25)) / 0.3186 for part in bins])
    weight = 1 / np.maximum(spread, 1e-12) ** 2
    floor, slope = _line_above_zero(level, spread**2, weight**2)
    return np.asarray(np.sqrt(floor + slope * np.maximum(local, 0.0)))


def _line_above_zero(x: FloatImage, y: FloatImage, weight: FloatImage) -> tuple[float, float]:
    from scipy import optimize

    root = np.sqrt(weight)
    matrix = np.stack([root, root * x], axis=1)
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    found, _ = optimize.nnls(matrix / scale, root * y)
    return float(found[0] / scale[0]), float(found[1] / scale[1])


def replaced(signal: FloatImage, bad: BoolImage) -> FloatImage:
    """A copy in which bad pixels take the median of their good neighbours (5 x 5), shape [H, W]."""
    from scipy import ndimage

    if not bad.any():
        return signal
    result = signal.copy()
    height, width = signal.shape
    for row, column in np.argwhere(bad):
        for reach in (1, 2, 4, 8):
            rows = slice(max(0, row - reach), min(height, row + reach + 1))
            columns = slice(max(0, column - reach), min(width, column + reach + 1))
            good = signal[rows, columns][~bad[rows, columns]]
            if good.size >= 3:
                result[row, column] = np.median(good)
                break
        else:
            result[row, column] = float(ndimage.mean(signal, ~bad, True))
    return result
