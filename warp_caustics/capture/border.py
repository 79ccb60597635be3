"""The border of the lit window in a photo, found to a fraction of a pixel.

A rough quadrilateral comes from the bright area; along each of its sides the
brightness is followed across the border, and a straight line is fitted to the
places where it passes half way. With a lens that is done in ideal pixels,
where straight lines are straight.

Not handled: a window whose surround is not dark, and one that touches the edge
of the photo.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.distortion import Distortion, Points
from warp_caustics.capture.registration import check_quadrilateral
from warp_caustics.errors import InputError
from warp_caustics.io.noise import FloatImage

MAX_RMS_PX = 1.0
"""Root mean square distance of the border from its straight lines, beyond which it is no straight border."""
MIN_KEPT = 0.5
"""Part of the places along a side that must agree on its line."""
MIN_AREA = 0.02
"""Part of the photo that the window must fill."""
ROUGH_PX = 512
"""The bright area is found in a photo reduced to about so many pixels per side."""
PROFILES = 240
"""Places along a side."""
END_SHARE = 0.06
"""Part of a side left out at each end, where the other side rounds the corner."""
STEP_PX = 0.25

HINT = "give the four corners in a file, or photograph the flat plate against a dark surround"


@dataclass(frozen=True, eq=False)
class Border:
    """A quadrilateral and how well it fits.

    Attributes:
        corners_px: corners in the photo, clockwise as displayed with row 0 on top, from the upper left, shape [4, 2].
        rms_px: root mean square distance of the border from its lines [px].
        kept: part of the places along the border that were used.
    """

    corners_px: Points
    rms_px: float
    kept: float


def find_border(brightness: FloatImage, distortion: Distortion | None = None) -> Border:
    """Find the bright quadrilateral of a photo.

    Args:
        brightness: one channel, shape [H, W].
        distortion: the lens; without it the lines are fitted in the photo as it is.

    Raises:
        InputError: nothing bright, no quadrilateral, or sides that are not straight.
    """
    from scipy import ndimage

    rough = _rough_corners(brightness)
    soft = ndimage.gaussian_filter(brightness, 1.0)
    corners, used, total = rough, np.zeros(0), 0
    for _ in range(2):
        sides = [_side(soft, a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        lines, distances, total = [], [], 0
        for places, wanted in sides:
            total += wanted
            ideal = places if distortion is None or not len(places) else distortion.undistort(places)
            centre, direction, distance, kept = _line(ideal)
            if kept.sum() < MIN_KEPT * wanted:
                raise InputError(
                    f"one side of the bright window is seen in {int(kept.sum())} of {wanted} places only; {HINT}"
                )
            lines.append((centre, direction))
            distances.append(distance[kept])
        ideal_corners = np.stack([_crossing(lines[side - 1], lines[side]) for side in range(4)])
        corners = ideal_corners if distortion is None else distortion.distort(ideal_corners)
        used = np.concatenate(distances)
    rms = float(np.sqrt(np.mean(used**2)))
    if rms > MAX_RMS_PX:
        lens = "" if distortion is not None else ", or give the lens distortion"
        raise InputError(
            f"the border of the bright window is not straight: {rms:.3g} px off its lines (limit {MAX_RMS_PX:g}); "
            f"{HINT}{lens}"
        )
    check_quadrilateral(corners, None)
    return Border(corners, rms, len(used) / total)


def _rough_corners(brightness: FloatImage) -> Points:
    """Corners of the bright area to a few pixels, clockwise from the upper left, shape [4, 2]."""
    from scipy import ndimage
    from skimage import filters, measure

    height, width = brightness.shape
    k = max(1, max(height, width) // ROUGH_PX)
    small = brightness[: height // k * k, : width // k * k].reshape(height // k, k, width // k, k).mean(axis=(1, 3))
    small = ndimage.median_filter(small, 3)
    if min(small.shape) < 16 or not np.ptp(small) > 0:
        raise InputError(f"the photo is too small or too even to show a bright window; {HINT}")
    # Caustic lines are far brighter than the rest: without a limit they alone would be the bright class.
    for _ in range(3):
        threshold = float(filters.threshold_otsu(small))
        small = np.minimum(small, np.median(small[small > threshold]))
    labels, count = ndimage.label(ndimage.binary_closing(np.pad(small > threshold, 4), np.ones((3, 3)), iterations=3))
    if not count:
        raise InputError(f"no bright window is seen; {HINT}")
    largest = labels == 1 + int(np.argmax(ndimage.sum_labels(labels > 0, labels, np.arange(1, count + 1))))
    area = ndimage.binary_fill_holes(largest)[4:-4, 4:-4]
    share = float(area.mean())
    if share < MIN_AREA or share > 0.98:
        raise InputError(f"the bright area fills {share:.1%} of the photo (2 to 98 % is usable); {HINT}")
    hull = measure.find_contours(np.pad(area, 1).astype(float), 0.5)
    outline = max(hull, key=len)[:, ::-1] - 1
    corners = _largest_quadrilateral(outline)
    covered = area.sum() / _area(corners)
    if not 0.85 < covered < 1.12:
        raise InputError(
            f"the bright area is no quadrilateral (it fills {covered:.0%} of the best one, "
            f"85 to 112 % is usable); {HINT}"
        )
    return _from_upper_left(corners * k + (k - 1) / 2)


def _largest_quadrilateral(outline: Points) -> Points:
    """Of all quadrilaterals with corners on a convex hull the largest, shape [4, 2]."""
    from scipy.spatial import ConvexHull

    hull = outline[ConvexHull(outline).vertices]
    if len(hull) < 4:
        raise InputError(f"the bright area is no quadrilateral; {HINT}")
    best = -1.0
    found: Points = hull[:4]
    for i in range(len(hull)):
        for j in range(i + 2, len(hull)):
            diagonal = hull[j] - hull[i]
            away = diagonal[0] * (hull[:, 1] - hull[i, 1]) - diagonal[1] * (hull[:, 0] - hull[i, 0])
            low, high = int(away.argmin()), int(away.argmax())
            if away[high] > 0 > away[low] and away[high] - away[low] > best:
                best, found = float(away[high] - away[low]), hull[[i, low, j, high]]
    return found


def _area(corners: Points) -> float:
    x, y = corners.T
    return float(abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2)


def _from_upper_left(corners: Points) -> Points:
    angle = np.arctan2(*(corners - corners.mean(axis=0)).T[::-1])
    order = np.argsort(angle)
    first = int(np.argmin(np.abs(angle[order] + 3 * np.pi / 4)))
    return np.asarray(corners[np.roll(order, -first)])


def _side(soft: FloatImage, start: Points, end: Points) -> tuple[Points, int]:
    """Where the brightness passes half way along one side, shape [N, 2], and at how many places that was tried."""
    from scipy import ndimage

    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    inward = np.array([-along[1], along[0]])
    reach = max(6.0, 0.02 * length)
    count = int(min(PROFILES, max(16, length / 2)))
    at = start + (np.linspace(END_SHARE, 1 - END_SHARE, count)[:, None] * length) * along
    depth = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
    points = at[:, None] + depth[None, :, None] * inward
    profile = ndimage.map_coordinates(soft, [points[..., 1], points[..., 0]], order=1, mode="nearest")
    third = len(depth) // 3
    outside, inside = np.median(profile[:, :third], axis=1), np.median(profile[:, -third:], axis=1)
    contrast = inside - outside
    clear = contrast > 0.3 * np.median(contrast)
    half = (inside + outside)[:, None] / 2
    crossing = (profile[:, :-1] < half) & (profile[:, 1:] >= half)
    # The steepest crossing: caustic lines beside the border cross half way too.
    steepness = np.where(crossing, np.diff(profile, axis=1), -np.inf)
    index = steepness.argmax(axis=1)
    row = np.arange(count)
    found = clear & crossing[row, index]
    below, above = profile[row, index], profile[row, np.minimum(index + 1, len(depth) - 1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (half[:, 0] - below) / (above - below)
    places = at + (depth[index] + fraction * STEP_PX)[:, None] * inward
    in_photo = ((places >= 0) & (places <= np.array(soft.shape[::-1]) - 1)).all(axis=1)
    return places[found & in_photo], count


def _line(points: Points) -> tuple[Points, Points, npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Line through points by total least squares, outliers left out in turns: centre, direction, distances, kept."""
    kept = np.ones(len(points), bool)
    distance = np.zeros(len(points))
    centre, direction = np.zeros(2), np.array([1.0, 0.0])
    if len(points) < 8:
        return centre, direction, distance, np.zeros(len(points), bool)
    # From the medians of the offsets along the chord first: least squares alone would follow a group of outliers.
    chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    normal = np.array([-chord[1], chord[0]])
    offset = points @ normal
    along = points @ chord
    slope, cut = _theil_sen(along, offset)
    distance = offset - (slope * along + cut)
    for _ in range(10):
        spread = 1.4826 * float(np.median(np.abs(distance - np.median(distance))))
        kept = np.abs(distance) <= max(3 * spread, 0.15)
        if kept.sum() < 8:
            break
        centre = points[kept].mean(axis=0)
        _, _, axes = np.linalg.svd(points[kept] - centre, full_matrices=False)
        direction = axes[0]
        distance = (points - centre) @ np.array([-direction[1], direction[0]])
    return centre, direction, distance, kept


def _theil_sen(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> tuple[float, float]:
    half = len(x) // 2
    slope = float(np.median((y[half : 2 * half] - y[:half]) / (x[half : 2 * half] - x[:half])))
    return slope, float(np.median(y - slope * x))


def _crossing(first: tuple[Points, Points], second: tuple[Points, Points]) -> Points:
    """Where two lines (centre, direction) cross."""
    (a, u), (b, v) = first, second
    matrix = np.stack([u, -v], axis=1)
    if abs(np.linalg.det(matrix)) < 0.1:
        raise InputError(f"two neighbouring sides of the bright window are parallel; {HINT}")
    return np.asarray(a + np.linalg.solve(matrix, b - a)[0] * u)
