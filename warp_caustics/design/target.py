"""The wanted caustic: a picture as irradiance on the window, with as much light as a flat plate sends there.

Light is only moved, never made: the target has mean 1 in units of the radiosity, so a dark picture means
bright spots. A smooth relief cannot keep all light away from a place; what black keeps is the floor.
"""

from typing import Literal, get_args

import numpy as np
import skimage.transform

from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""

LEAST_SIDE = 2
"""A picture of one pixel shows nothing."""

Fit = Literal["crop", "pad", "stretch"]
"""What becomes of a picture of another shape than its frame: cut to it, set into the dark, or distorted."""


def grey(values: FloatArray) -> FloatArray:
    """One linear picture of all channels: luminance of three, else their mean.

    Args:
        values: linear light in any unit, shape [C, H, W].

    Returns:
        Shape [H, W], float64.
    """
    weights = LUMINANCE if len(values) == 3 else (1 / len(values),) * len(values)
    mixed: FloatArray = np.tensordot(np.asarray(weights), values.astype(np.float64), axes=1)
    return mixed


def target_irradiance(
    picture: FloatArray, scene: Scene, *, floor: float = 0.0, margin_m: float = 0.0, fit: Fit = "crop"
) -> FloatArray:
    """A picture as the irradiance that its caustic shall have.

    Args:
        picture: linear light in any unit, row 0 at the window's lowest y, shape [H, W].
        scene: gives the window.
        floor: irradiance that black keeps, in units of the mean; between 0 and 1.
        margin_m: dark border inside the window on every side [m].
        fit: how a picture of another aspect ratio fills the frame within the margin.

    Returns:
        Irradiance in units of the radiosity, mean 1, shape [m, m].

    Raises:
        InputError: too small a picture, no light in it, or values out of range.
    """
    if not 0 <= floor < 1:
        raise InputError(f"floor {floor:g} is not between 0 and 1 (exclusive); 0.1 leaves black a tenth of the mean")
    if fit not in get_args(Fit):
        raise InputError(f"fit {fit!r} is not known; use one of {', '.join(get_args(Fit))}")
    height, width = picture.shape
    if min(height, width) < LEAST_SIDE:
        raise InputError(
            f"the picture has {height} x {width} pixels, too few to show anything; "
            f"give at least {LEAST_SIDE} x {LEAST_SIDE}"
        )
    frame = frame_pixels(scene, margin_m, height / width if fit == "pad" else None)
    if fit == "crop":
        picture = _cropped(picture, frame_aspect(scene, margin_m))
    light = np.maximum(resampled(picture, frame), 0.0)
    mean = float(light.mean())
    if mean <= 0:
        raise InputError("the picture is black everywhere, so it says nowhere to send the light; give one with light")
    m = scene.image_pixels
    window = np.zeros((m, m))
    row, column = ((m - size) // 2 for size in frame)
    window[row : row + frame[0], column : column + frame[1]] = light
    target: FloatArray = floor + (1 - floor) * window / window.mean()
    return target


def frame_aspect(scene: Scene, margin_m: float) -> float:
    """Height over width of the window within a margin [m].

    Raises:
        InputError: no window is left.
    """
    width, length = scene.plate_size_m
    limit = min(width, length) / 2
    if not 0 <= margin_m < limit:
        raise InputError(f"margin {margin_m:g} m is not between 0 and half the plate, {limit:g} m; make it smaller")
    return (length - 2 * margin_m) / (width - 2 * margin_m)


def frame_pixels(scene: Scene, margin_m: float, aspect: float | None = None) -> tuple[int, int]:
    """Rows and columns of the window within a margin [m], of a given height over width if that is not None."""
    width, length = scene.plate_size_m
    whole = frame_aspect(scene, margin_m)
    width_m, length_m = width - 2 * margin_m, length - 2 * margin_m
    if aspect is not None:
        width_m, length_m = (length_m / aspect, length_m) if aspect > whole else (width_m, width_m * aspect)
    m = scene.image_pixels
    rows, columns = round(m * length_m / length), round(m * width_m / width)
    if min(rows, columns) < LEAST_SIDE:
        raise InputError(f"the picture would be {rows} x {columns} pixels of the window; use --fit crop or less margin")
    return rows, columns


def resampled(picture: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """The picture on another grid of pixels; fine detail is blurred away first where there are fewer."""
    if picture.shape == shape:
        return picture
    result: FloatArray = skimage.transform.resize(picture, shape, order=1, mode="edge", anti_aliasing=True)
    return result


def _cropped(picture: FloatArray, aspect: float) -> FloatArray:
    """The middle of a picture, of a given height over width."""
    height, width = picture.shape
    rows, columns = min(height, max(1, round(width * aspect))), min(width, max(1, round(height / aspect)))
    row, column = (height - rows) // 2, (width - columns) // 2
    return picture[row : row + rows, column : column + columns]
