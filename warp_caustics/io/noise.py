"""Pixel noise: how strong it is in an image, and how to suppress it in calibration frames."""

import numpy as np
import numpy.typing as npt

from warp_caustics.io.median import median_5x5

FloatImage = npt.NDArray[np.float64]
BoolImage = npt.NDArray[np.bool_]

SMOOTHING_WINDOW = 31
"""Pixels over which a flat field or dark frame is smoothed. Pixel noise falls about ninefold, while a quadratic follows
vignetting (corners at 70 %) to 3e-4 in the corner of a frame of 160 pixels and to 1e-5 at 512. The price: shadows of
dust smaller than this, and differences in sensitivity between pixels, stay in the image."""
_OUTLIER = 6.0
_MAD_TO_STD = 1.4826


def estimate_noise_std(image: FloatImage, level: float, valid: BoolImage | None = None) -> float:
    """Standard deviation of the white noise in an image, where its values are near a level.

    Immerkaer's mask [[1, -2, 1], [-2, 4, -2], [1, -2, 1]] (Computer Vision and Image Understanding 64, 300 (1996))
    cancels everything locally bilinear. Its median magnitude is taken over the flatter half of the pixels within
    0.7 to 1.4 of the level, because shot noise depends on brightness and caustic lines are no noise. Noise that is
    correlated between pixels (demosaicing, lossy compression) is underestimated.

    Args:
        image: one channel [W/m^2], shape [H, W].
        level: irradiance of interest [W/m^2].
        valid: pixels to use, shape [H, W]; all if not given.

    Returns:
        Noise [W/m^2]; NaN for fewer than 64 usable pixels.
    """
    from scipy import ndimage

    if min(image.shape) < 8:
        return float("nan")
    rows = image[2:] - 2 * image[1:-1] + image[:-2]
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]) / 6
    # Blurred far beyond the mask's 3 x 3, so that choosing pixels by it does not choose the noise.
    smooth = ndimage.gaussian_filter(image, 2.0)
    slope = np.hypot(*np.gradient(smooth))[1:-1, 1:-1]
    usable = np.ones(second.shape, bool)
    if valid is not None:
        usable &= ndimage.binary_erosion(valid, np.ones((3, 3), bool))[1:-1, 1:-1]
    inner = smooth[1:-1, 1:-1]
    near = usable & (inner > 0.7 * level) & (inner < 1.4 * level)
    chosen = near if near.sum() >= 256 else usable
    if chosen.sum() < 64:
        return float("nan")
    flat = chosen & (slope <= np.median(slope[chosen]))
    return float(_MAD_TO_STD * np.median(second[flat]))


def smooth_frame(frame: FloatImage) -> tuple[FloatImage, int]:
    """Suppress the noise of a flat field or dark frame, keeping single odd pixels (hot, dead, dusty) as they are.

    A quadratic is fitted along rows and columns (Savitzky-Golay). Unlike a
    Gaussian it has no bias where a slope meets the border.

    Args:
        frame: one channel in counts, shape [H, W].

    Returns:
        The smoothed frame, shape [H, W], and the number of pixels kept as they were.
    """
    from scipy import ndimage

    window = min(SMOOTHING_WINDOW, *(size - (size + 1) % 2 for size in frame.shape))
    if window < 5:
        return frame, frame.size

    # scipy.signal has this filter, and takes a second to load.
    places = np.vander(np.arange(window) - window // 2, 3).astype(float)
    projection = places @ np.linalg.pinv(places)

    def along_rows(values: FloatImage) -> FloatImage:
        """Values of quadratics through a window around each place; through the outermost one near the border."""
        half = window // 2
        found: FloatImage = ndimage.correlate1d(values, projection[half], axis=1)
        found[:, :half] = values[:, :window] @ projection[:half].T
        found[:, -half:] = values[:, -window:] @ projection[-half:].T
        return found

    def fitted(values: FloatImage) -> FloatImage:
        smoothed: FloatImage = along_rows(along_rows(np.ascontiguousarray(values.T)).T)
        return smoothed

    # Compared with a local median of the remainder, not of the frame: where vignetting is steep, that one is biased.
    smooth = fitted(frame)
    expected = smooth + median_5x5(frame - smooth)
    distance = np.abs(frame - expected)
    odd = distance > _OUTLIER * _MAD_TO_STD * np.median(distance)
    smooth = fitted(np.where(odd, expected, frame))
    return np.where(odd, frame, smooth), int(odd.sum())
