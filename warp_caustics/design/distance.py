"""How far the screen should be.

A slope moves light in proportion to the distance, so the relief of a picture is about inversely as high as the
screen is far. Near screens are sharper (sources have an extent, light is diffracted), far screens need less glass.
"""

import math

import numpy as np

from warp_caustics.design.start import relief_of
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.reconstruct.transport.transport_map import TransportMap
from warp_caustics.scene import Scene

NEAREST_M, FARTHEST_M = 0.1, 2.0
"""Distances that are chosen without being asked for [m]."""

STEP_M = 0.01
"""Whole centimetres are easy to set up."""

USED_SHARE = 0.85
"""Of the height limit, by the start: the descent needs room."""


def at_distance(scene: Scene, distance_m: float) -> Scene:
    """The scene with its screen so far below the plate [m]."""
    x, y, _ = scene.screen_position_m
    return scene.model_copy(update={"screen_position_m": (x, y, -distance_m)})


def least_distance(transport: TransportMap, scene: Scene, max_height_m: float) -> float:
    """Least whole number of centimetres at which the relief of a map fits a height limit [m], within bounds.

    Exact for small slopes, of which height times distance (the glass counting as its thickness over its index) is
    a constant.
    """
    nearest = at_distance(scene, NEAREST_M)
    heights, _ = relief_of(transport, nearest)
    path = LightPath.of_scene(nearest)
    optical_m = path.thickness_m / path.glass + path.gap_m / path.outside
    needed_m = optical_m * float(np.ptp(heights)) / (USED_SHARE * max_height_m)
    gap_m = path.outside * (needed_m - path.thickness_m / path.glass)
    steps = math.ceil(gap_m / STEP_M - 1e-6)
    return min(max(round(steps * STEP_M, 6), NEAREST_M), FARTHEST_M)
