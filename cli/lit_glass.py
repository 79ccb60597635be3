"""A relief as lit glass, heights towards the viewer, row 0 on top as in all pictures."""

import numpy as np
import scipy.ndimage

from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

_SHOWN_SLOPE = 1.2
_LIGHT = np.array([-0.55, -0.6, 0.58]) / np.linalg.norm([-0.55, -0.6, 0.58])
"""From the upper left: y grows downwards in the picture."""
_TINT = np.array([0.56, 0.74, 0.80])
_MIN_SIDE = 192


def exaggeration(true_m: FloatArray, scene: Scene) -> float:
    """Factor on the heights that makes the slopes of a relief visible, and leaves steep ones below a right angle.

    Taken from the truth and used for all that is found of it, so that pictures can be compared.
    """
    steep = float(np.quantile(np.hypot(*_slopes(true_m, scene)), 0.98))
    return float(np.clip(_SHOWN_SLOPE / steep, 0.1, 50.0)) if steep > 0 else 1.0


def lit_glass(heights_m: FloatArray, scene: Scene, factor: float = 1.0) -> FloatArray:
    """Shaded relief with a highlight and bright rims, lit from the upper left.

    Args:
        heights_m: [m], shape [n, n].
        scene: gives the plate's size.
        factor: on the heights.

    Returns:
        Display values between 0 and 1, shape [k, k, 3].
    """
    zoom = max(1, -(-_MIN_SIDE // len(heights_m)))
    smooth: FloatArray = scipy.ndimage.zoom(heights_m.astype(np.float64), zoom, order=3, mode="nearest", grid_mode=True)
    slope_y, slope_x = _slopes(smooth, scene)
    normal = np.stack([-factor * slope_x, -factor * slope_y, np.ones_like(smooth)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    half = _LIGHT + np.array([0.0, 0.0, 1.0])
    diffuse = np.clip(normal @ _LIGHT, 0.0, 1.0)[..., None]
    highlight = np.clip(normal @ (half / np.linalg.norm(half)), 0.0, 1.0)[..., None] ** 60
    rim = (1 - normal[..., 2:]) ** 2
    shown: FloatArray = np.clip(_TINT * (0.3 + 0.75 * diffuse) + 0.7 * highlight + 0.25 * rim, 0.0, 1.0)
    return shown


def _slopes(heights_m: FloatArray, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """dh/dy and dh/dx."""
    rows, columns = heights_m.shape
    pitch_x, pitch_y = scene.plate_size_m[0] / columns, scene.plate_size_m[1] / rows
    return np.gradient(heights_m, pitch_y, axis=0), np.gradient(heights_m, pitch_x, axis=1)
