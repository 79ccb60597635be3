"""What cameras, lamps and users do to an image that no model of this project knows; relative to even light.

Each takes an image of shape [n_w, m, m], relative to that of a flat plate, and random numbers, and returns another.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy.ndimage

from warp_caustics.types import FloatArray

Change = Callable[[FloatArray, np.random.Generator], FloatArray]


def places(count: int) -> tuple[FloatArray, FloatArray]:
    """x and y of cell centres from -1 to 1, shape [count, count] each."""
    along = (np.arange(count) + 0.5) / count * 2 - 1
    x, y = np.meshgrid(along, along)
    return x, y


def blurred(image: FloatArray, sigma_px: float | tuple[float, float]) -> FloatArray:
    """Every channel by a Gaussian of a standard deviation [px], or of one along y and one along x."""
    return np.asarray([scipy.ndimage.gaussian_filter(channel, sigma_px, mode="nearest") for channel in image])


def warped(image: FloatArray, x_px: FloatArray | float, y_px: FloatArray | float) -> FloatArray:
    """The image whose pixels show what lies so far beside them [px], shape [m, m] or one number."""
    rows, columns = np.mgrid[: image.shape[-1], : image.shape[-1]].astype(float)
    at = [rows + y_px, columns + x_px]
    return np.asarray([scipy.ndimage.map_coordinates(channel, at, order=3, mode="nearest") for channel in image])


def power(exponent: float) -> Change:
    """A sensor that is not linear."""
    return lambda image, rng: np.maximum(image, 0) ** exponent


def clipped(most: float) -> Change:
    """Bright pixels that saturate, and nobody says so."""
    return lambda image, rng: np.minimum(image, most)


def veiled(share: float, sigma_px: float) -> Change:
    """A part of the light spread wide, as glass and lenses scatter it."""
    return lambda image, rng: (1 - share) * image + share * blurred(image, sigma_px)


def ghost(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A second picture, 4 % as bright, 7 px beside."""
    return 0.96 * image + 0.04 * np.roll(blurred(image, 1), (5, 7), (1, 2))


def corner_blur(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Sharp in the middle, blurred by 2 px in the corners."""
    x, y = places(image.shape[-1])
    share = np.minimum(np.hypot(x, y) / 1.41, 1) ** 2
    return np.asarray(image * (1 - share) + blurred(image, 2) * share)


def moved_while_exposed(by_px: float) -> Change:
    """Half the light where the picture was before."""
    return lambda image, rng: 0.5 * (image + warped(image, by_px, 0))


def barrel(rim_px: float) -> Change:
    """Distorted by a lens, so much at the middle of a side."""

    def change(image: FloatArray, rng: np.random.Generator) -> FloatArray:
        x, y = places(image.shape[-1])
        return warped(image, rim_px * x * (x * x + y * y), rim_px * y * (x * x + y * y))

    return change


def keystone(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Seen at a small angle, 1 px at the corners."""
    x, y = places(image.shape[-1])
    return warped(image, x * y, y * y)


def sheared(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """By 1 px at the rim."""
    return warped(image, places(image.shape[-1])[1], 0.0)


def stripes(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of a lamp, 3 %, 6 mm apart."""
    x, _ = places(image.shape[-1])
    return np.asarray(image * (1 + 0.03 * np.sin(8 * np.pi * x)))


def vignette(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A quarter less light in the corners."""
    x, y = places(image.shape[-1])
    return image * (1 - 0.25 * (x * x + y * y) / 2)


def hair(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Across the screen, and a dozen grains."""
    x, y = places(image.shape[-1])
    image = image * np.where(np.abs(y - 0.3 * np.sin(2 * x) - 0.2) < 0.006, 0.3, 1)
    for _ in range(12):
        at_x, at_y = rng.uniform(-1, 1, 2)
        image = image * np.where(np.hypot(x - at_x, y - at_y) < 0.012, 0.2, 1)
    return image


def dark_corner(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Hidden by something."""
    x, y = places(image.shape[-1])
    return image * np.where((x > 0.6) & (y > 0.6), 0.02, 1)


def row_noise(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of 1 %, every row by its own."""
    rows = np.asarray(1 + 0.01 * rng.standard_normal(image.shape[-1]))
    return np.asarray(image * rows[None, :, None])


def dead_columns(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Six that nobody masked."""
    image = image.copy()
    image[:, :, rng.integers(0, image.shape[-1], 6)] = 0
    return image


def smooth_noise(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of 2 %, over neighbours, as of a mosaic of colours."""
    white = [scipy.ndimage.gaussian_filter(rng.standard_normal(channel.shape), 1) for channel in image]
    return image + 0.02 * 2 * math.sqrt(math.pi) * np.stack(white)


LIGHT: dict[str, tuple[str, Change]] = {
    "gamma95": ("a sensor that is not linear, power 0.95", power(0.95)),
    "gamma90": ("power 0.9", power(0.9)),
    "clip4": ("saturated at four times flat light, not masked", clipped(4)),
    "ghost": ("a second picture of 4 %", ghost),
    "veil": ("5 % of the light over 25 px", veiled(0.05, 25)),
    "halo": ("10 % over 5 px", veiled(0.1, 5)),
    "corner_blur": ("blurred by 2 px in the corners", corner_blur),
    "motion2": ("moved by 2 px while exposed", lambda image, rng: 0.5 * (image + np.roll(image, 2, 2))),
    "motion05": ("moved by 0.5 px", moved_while_exposed(0.5)),
    "astig": ("blurred by 1.5 px along x alone", lambda image, rng: blurred(image, (0, 1.5))),
    "barrel": ("distorted by 0.5 px at the rim", barrel(0.5)),
    "barrel2": ("by 2 px", barrel(2.0)),
    "keystone": ("seen from an angle, 1 px", keystone),
    "shear": ("sheared by 1 px", sheared),
    "stripes": ("stripes of light, 3 %, 6 mm apart", stripes),
    "vignette": ("corners a quarter darker", vignette),
    "hair": ("a hair and a dozen grains", hair),
    "corner_dark": ("a corner hidden", dark_corner),
    "rows": ("noise of rows, 1 %", row_noise),
    "mirrored": ("mirrored", lambda image, rng: image[:, :, ::-1]),
    "turned": ("turned by 90 degrees", lambda image, rng: np.rot90(image, 1, (1, 2))),
    "rgb_swap": ("red and blue changed over", lambda image, rng: image[::-1]),
    "gain10": (
        "red 10 % brighter, blue darker",
        lambda image, rng: image * np.array([1.1, 1, 0.9], np.float32)[:, None, None],
    ),
    "ambient20": ("stray light of 20 %", lambda image, rng: image + 0.2),
    "deadcols": ("six dead columns, not masked", dead_columns),
    "corr_noise": ("noise of 2 % that neighbours share", smooth_noise),
    "quant": ("8 bits", lambda image, rng: np.round(image * 12) / 12),
}
"""By name: in words, and what it does."""
