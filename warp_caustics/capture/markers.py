"""Round marks at known places: dots printed on the plate's rim or on the screen, found as blobs.

Each dot must be the only mark within its search radius, darker or brighter
than what surrounds it. Its centre is the centroid of the contrast, weighted
by brightness, which noise and the pixel grid move by less than a tenth of a
pixel. A circle seen at an angle is an ellipse whose centre is not quite the
circle's; for dots of a fiftieth of the window and 10 % perspective that is
below a hundredth of the dot.
"""

import numpy as np

from warp_caustics.capture.distortion import Points
from warp_caustics.errors import InputError
from warp_caustics.io.noise import FloatImage

MIN_CONTRAST = 6.0
"""Contrast of a dot over the noise around it."""
MIN_ROUND = 0.35
"""Smallest ratio of a blob's axes; a mark seen at an angle is an ellipse, a line is no mark."""


def find_markers(brightness: FloatImage, near_px: Points, search_px: float, bright: bool) -> Points:
    """Centres of round marks near given places.

    Args:
        brightness: one channel, shape [H, W].
        near_px: where to look, (x, y), shape [N, 2].
        search_px: how far from there the centre may lie.
        bright: marks are brighter than their surround, not darker.

    Returns:
        Centres (x, y), shape [N, 2].

    Raises:
        InputError: no mark, several, or something that is not round.
    """
    return np.stack([_find_one(brightness, near, search_px, bright) for near in near_px])


def _find_one(brightness: FloatImage, near: Points, radius: float, bright: bool) -> Points:
    from scipy import ndimage
    from skimage import measure, segmentation

    height, width = brightness.shape
    name = f"mark near {near[0]:.1f}, {near[1]:.1f}"
    low = np.maximum(np.floor(near - 1.5 * radius).astype(int), 0)
    high = np.minimum(np.ceil(near + 1.5 * radius).astype(int) + 1, [width, height])
    if (high - low < 5).any():
        raise InputError(f"{name}: lies outside the photo of {width} x {height} pixels; check its place")
    box = slice(low[1], high[1]), slice(low[0], high[0])
    part = brightness[box] * (1.0 if bright else -1.0)
    soft = ndimage.gaussian_filter(part, 1.0)
    level = float(np.median(soft))
    peak = float(np.percentile(soft, 99.5)) if soft.size > 2000 else float(soft.max())
    noise = 1.4826 * float(np.median(np.abs(part - soft)))
    kind = "brighter" if bright else "darker"
    if not peak - level > MIN_CONTRAST * noise:
        raise InputError(f"{name}: nothing {kind} than its surround is seen within {radius:.0f} px; check its place")
    # What reaches the edge of the patch is no dot: the dark beside the window, or a caustic line.
    labels = segmentation.clear_border(measure.label(soft > (peak + level) / 2))
    marks = [
        mark
        for mark in measure.regionprops(labels)
        if mark.area >= 4 and np.hypot(*(np.array(mark.centroid)[::-1] + low - near)) <= radius
    ]
    if not marks:
        raise InputError(f"{name}: no {kind} dot within {radius:.0f} px; check its place")
    largest = max(marks, key=lambda mark: mark.area)
    if any(mark.area > 0.3 * largest.area for mark in marks if mark is not largest):
        raise InputError(f"{name}: several {kind} dots within {radius:.0f} px; give a smaller search_px")
    ratio = largest.axis_minor_length / max(largest.axis_major_length, 1e-9)
    if ratio < MIN_ROUND or largest.solidity < 0.8:
        raise InputError(f"{name}: what is {kind} there is not round (axes {ratio:.2f} to 1); check its place")
    zone = ndimage.binary_dilation(labels == largest.label, iterations=3)
    ring = ndimage.binary_dilation(zone, iterations=3) & ~zone
    weight = np.where(zone, part - np.median(part[ring] if ring.any() else part), 0.0)
    rows, columns = np.indices(part.shape)
    total = weight.sum()
    return np.array([(weight * columns).sum() / total + low[0], (weight * rows).sum() / total + low[1]])
