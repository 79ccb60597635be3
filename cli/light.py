"""How light is shown: which channels are red, green and blue, and what is white."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from warp_caustics.types import FloatArray

BRIGHTEST_PERCENT = 99.5
"""Light at this percentile is white: caustic lines would otherwise leave the rest black."""
DISPLAY_GAMMA = 2.2


def white_level(image: "FloatArray") -> float:
    """Value that is shown as white; 1 where an image has no light."""
    known = image[np.isfinite(image)]
    white = float(np.percentile(known, BRIGHTEST_PERCENT)) if known.size else 0.0
    return white if white > 0 else 1.0


def rgb_channels(wavelengths_m: tuple[float, ...], count: int) -> list[int]:
    """Channels for red, green and blue: longest, middle and shortest wavelength.

    Args:
        wavelengths_m: of the scene [m], shape [n_w].
        count: channels of the image; where they are not the scene's, first, middle and last.
    """
    order = np.argsort(wavelengths_m)[::-1] if count == len(wavelengths_m) else np.arange(count)
    return [int(order[index]) for index in (0, count // 2, -1)]


def rgb_composite(image: "FloatArray", wavelengths_m: tuple[float, ...], white: float) -> "FloatArray":
    """Longest, middle and shortest wavelength as red, green and blue; one wavelength is grey.

    Args:
        image: irradiance [W/m^2], shape [n_w, m, m].
        wavelengths_m: of the scene [m], shape [n_w]; see :func:`rgb_channels` where the image has other channels.
        white: irradiance shown at full brightness [W/m^2].

    Returns:
        Display values between 0 and 1, shape [m, m, 3].
    """
    chosen = np.moveaxis(image[rgb_channels(wavelengths_m, len(image))], 0, -1)
    shown: FloatArray = np.clip(chosen / white, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)
    return shown
