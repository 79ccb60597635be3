"""What the maker of a design should know, each with the value, the limit and what to change."""

from typing import Any

from warp_caustics.design.options import DesignOptions
from warp_caustics.scene import Scene

STEEP_SHARE = 0.8
"""Of the sine at total reflection; beyond, much light is reflected at the bottom face, which is not modelled."""

BLUR_SHARE = 0.01
"""Of the window: a picture of a hundred resolved points per side."""

SHALLOW_M = 20e-6
"""Lower relief is within what printing and milling leave on a plate meant to be flat."""

FLAT_M = 1e-9
"""A relief that no one would call one; an even picture needs none."""

LOST_SHARE = 0.01
"""Of the light, beside the window."""

POOR_DB = 20.0


def design_warnings(figures: dict[str, Any], scene: Scene, options: DesignOptions, needed_m: float) -> list[str]:
    """Warnings on a design.

    Args:
        figures: ``picture`` and ``relief``, see ``judgement.py``.
        scene: with the distance of the design.
        options: what was asked.
        needed_m: height range that the start needs at this distance [m].
    """
    picture, relief = figures["picture"], figures["relief"]
    distance_m = -scene.screen_position_m[2]
    warnings = []
    if needed_m > options.max_height_m:
        farther = distance_m * needed_m / options.max_height_m
        warnings.append(
            f"the picture needs about {needed_m * 1e3:.3g} mm of relief at {distance_m:.4g} m, the limit of "
            f"{options.max_height_m * 1e3:.3g} mm keeps light back; raise the limit, the floor, or the distance to "
            f"about {farther:.2g} m"
        )
    if FLAT_M < relief["height_range_m"] < SHALLOW_M:
        warnings.append(
            f"the relief is only {relief['height_range_m'] * 1e6:.3g} um high, less than the {SHALLOW_M * 1e6:g} um "
            "that making it may add; bring the screen nearer"
        )
    if relief["total_reflection_share"] > STEEP_SHARE:
        warnings.append(
            f"the steepest slope, {relief['max_slope']:.3g}, bends light to {relief['total_reflection_share']:.0%} of "
            f"total reflection (limit {STEEP_SHARE:.0%}); take the screen farther away"
        )
    window_m = min(scene.plate_size_m)
    if relief["diffraction_blur_m"] > BLUR_SHARE * window_m:
        warnings.append(
            f"at {distance_m:.4g} m diffraction, which is not simulated, blurs by about "
            f"{relief['diffraction_blur_m'] * 1e3:.2g} mm, more than {BLUR_SHARE:.0%} of the window; bring the screen "
            "nearer and allow more height, or enlarge the plate"
        )
    if picture["light_in_window"] < 1 - LOST_SHARE:
        warnings.append(
            f"{1 - picture['light_in_window']:.1%} of the light misses the window, more than {LOST_SHARE:.0%}; "
            "leave a margin around the picture"
        )
    if picture["psnr_dB"] < POOR_DB:
        warnings.append(
            f"the caustic is {picture['psnr_dB']:.1f} dB from the picture, below {POOR_DB:g} dB; raise the floor, the "
            "height limit or the iterations"
        )
    return warnings
