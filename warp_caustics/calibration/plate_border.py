"""Where the border of a plate's picture lies in the window: pixels that it crosses say nothing of heights.

A capture that was divided by its flat frame is as bright there as elsewhere, one that was not is half dark, and what
simulates neither knows which.
"""

import math

import numpy as np

from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray

LEAST_PART = 0.01
"""Of a pixel, beyond or within the border, that is nothing."""


def border_of_picture(scene: Scene, axis: int) -> tuple[float, float]:
    """Where light through the lower and upper edge of a flat plate lands along an axis, in its middle [m].

    By Snell's law at both faces; of several wavelengths the mean, which are a thousandth of a pixel apart.

    Args:
        scene: the bench.
        axis: 0 for x, 1 for y.
    """
    half, gap = scene.plate_size_m[axis] / 2, -scene.screen_position_m[2]
    glass, outside = (float(np.mean(each)) for each in (scene.glass_indices, scene.exit_indices))
    landed = []
    for edge in (-half, half):
        if scene.is_collimated:
            across, slope = math.tan(scene.light_tilt_rad[1 - axis]), math.tan(scene.light_tilt_rad[axis])
        else:
            away = scene.light_distance_m
            across = -scene.light_position_m[1 - axis] / away
            slope = (edge - scene.light_position_m[axis]) / away
        length = math.sqrt(1 + slope**2 + across**2)
        sine, along = math.hypot(slope, across) / length, slope / length
        at = edge
        for way, index in ((scene.base_thickness_m, glass), (gap, outside)):
            at += way * along / index / math.sqrt(max(1e-6, 1 - (sine / index) ** 2))
        landed.append(at)
    return landed[0], landed[1]


def crossed_pixels(scene: Scene) -> BoolArray:
    """Pixels of the window that the border of the plate's picture crosses, shape [m, m]."""
    pixels, crossed = scene.image_pixels, []
    for axis in (0, 1):
        size, middle = scene.pixel_size_m[axis], scene.screen_position_m[axis]
        lower = np.arange(pixels) - pixels / 2
        lines = [(edge - middle) / size for edge in border_of_picture(scene, axis)]
        crossed.append(np.any([(at - lower > LEAST_PART) & (lower + 1 - at > LEAST_PART) for at in lines], axis=0))
    along_x, along_y = crossed
    found: BoolArray = along_x[None, :] | along_y[:, None]
    return found
