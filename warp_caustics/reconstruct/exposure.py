"""Exposure of an image, told by all its light together.

A plate moves light about and loses next to none, so whatever the relief, the sum
over the pixels is that of the model: on images with 2 % of noise, from reliefs
that are 20 um wrong, the ratio is right to 3e-5. A lamp that drifts between flat
frame and capture, or an exposure time that is not quite what it says, is found so.
"""

import dataclasses

import numpy as np
import torch

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.types import FloatArray

LEAST_EXPOSURE_ERROR = 2e-4
"""Smaller deviations are left alone: 18 own fields show up to 1.7e-4 by reliefs that networks found."""

MOST_LIGHT_LOST = 0.02
"""Printed plates of Tab. 3 lose less light than this beside the screen: up to 1 % of it in 18 own fields."""

MOST_MASKED = 2e-4
"""With a larger share of pixels that do not count nothing is told: saturated ones hold the light of caustic lines, and
one pixel in a hundred may hold a tenth of all light."""

WARNED_EXPOSURE_ERROR = 0.01
"""Larger ones are worth a warning."""

MOST_LIGHT_RATIO = 4.0
"""Ratios beyond this, or below its inverse, are no exposure but another unit, and left to be seen in the residual."""


def light_ratio(measurement: Measurement, simulated: torch.Tensor | None = None) -> FloatArray:
    """Measured over simulated light of each wavelength, shape [n_w]; 1 where there is none, or pixels are masked.

    The outermost pixels do not count.

    Args:
        measurement: what was seen, all pixels, in units of the radiosity.
        simulated: the same of a relief, shape [n_w, m, m]; None for a flat plate.
    """
    inside = (slice(None), slice(1, -1), slice(1, -1))
    weight = measurement.weight[inside].double()
    seen = (measurement.irradiance[inside] * weight).sum(dim=(1, 2))
    expected = weight.sum(dim=(1, 2)) if simulated is None else (simulated[inside] * weight).sum(dim=(1, 2))
    is_told = (seen > 0) & (expected > 0) & (weight.mean(dim=(1, 2)) >= 1 - MOST_MASKED)
    ratio = torch.where(is_told, seen / torch.where(is_told, expected, 1.0), 1.0)
    return np.asarray(ratio.tolist())


def agreed_ratio(by_relief: FloatArray, by_flat: FloatArray) -> FloatArray:
    """Light ratio of each wavelength that a relief and a flat plate tell alike.

    The relief's where they agree to 2 %, for it knows what light is lost. Where they do not, the relief is wrong or
    sends much light beside the screen: then what both have in common, which is 1 if one says more and the other less.
    """
    more = np.maximum(np.minimum(by_relief, by_flat), 1.0)
    less = np.minimum(np.maximum(by_relief, by_flat), 1.0)
    common = np.where(more > 1, more, less)
    return np.where(np.abs(by_relief / by_flat - 1) < MOST_LIGHT_LOST, by_relief, common)


def is_exposure(ratio: FloatArray, noticed: float = LEAST_EXPOSURE_ERROR) -> bool:
    """Whether light ratios are to be divided out: noticeable, and no other unit."""
    is_plausible = ratio.min() > 1 / MOST_LIGHT_RATIO and ratio.max() < MOST_LIGHT_RATIO
    return bool(is_plausible and np.abs(ratio - 1).max() > noticed)


def at_nominal(image: CausticImage, ratio: FloatArray) -> CausticImage:
    """The image as the scene's light would have made it; its noise alike."""
    noise = None if image.noise_std is None else image.noise_std / ratio
    return dataclasses.replace(image, irradiance=image.irradiance / ratio[:, None, None], noise_std=noise)


def untreated_warning(ratio: FloatArray, method: str, least: float = MOST_LIGHT_LOST) -> str | None:
    """What the user should know of an exposure that a method takes for the relief's doing; None up to ``least``."""
    if np.abs(ratio - 1).max() <= least:
        return None
    shares = ", ".join(f"{value:.2%}" for value in ratio)
    return (
        f"the image has {shares} of the light that this scene gives, which {method} explains by the relief (limit "
        f"{least:.0%}); check exposure and flat frame, or try --method refine"
    )


def exposure_warning(ratio: FloatArray, least: float = WARNED_EXPOSURE_ERROR) -> str | None:
    """What the user should know of an exposure that was divided out; None for one below ``least``."""
    if np.abs(ratio - 1).max() <= least:
        return None
    shares = ", ".join(f"{value:.2%}" for value in ratio)
    return f"the image has {shares} of the light that this scene gives; divided out, but check exposure and flat frame"
