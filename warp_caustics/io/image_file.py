"""One image as its file holds it, and what its array of pixels must satisfy."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError

Array = npt.NDArray[Any]

FitsCheck = Callable[[int, int, int], None]
"""Called with channels, rows and columns before pixels are decoded; raises to refuse them."""

MAX_PIXELS = 64_000_000
MAX_VALUES = 256_000_000
"""Of all channels together, a gigabyte as float32: the one limit of what a file may claim."""
MAX_CHANNELS = 64
"""The largest number of wavelengths a scene may have."""
MAX_NEGATIVE = 5e-3
"""Dark subtraction leaves negative noise, and resampling of lines 20 times as bright as the rest 1.3e-3 of them beside
them; below -MAX_NEGATIVE times the maximum something is wrong."""


@dataclass(frozen=True, eq=False)
class ImageFile:
    """One image as its file holds it.

    Attributes:
        values: pixels in the file's own linear unit (counts or W/m^2), float32, shape [C, H, W].
        full_scale: largest value the file's type can hold (255, 65535), None for floats.
        bit_depth: bits per value in the file.
        format: ``png``, ``tiff``, ``jpeg``, ``exr``, ``npy``, ``npz`` or ``hdf5``.
        warnings: one line for each thing a person should know.
        wavelengths_m: wavelength of each channel [m], shape [C], where the file records it.
        count_W_m2: irradiance of one count [W/m^2], where the file records it (PNG by ``write_image``).
    """

    values: npt.NDArray[np.float32]
    full_scale: float | None
    bit_depth: int
    format: str
    warnings: tuple[str, ...] = ()
    wavelengths_m: tuple[float, ...] | None = None
    count_W_m2: float | None = None


def check_pixels(name: str, shape: Sequence[int], max_pixels: int) -> None:
    """Refuse a size from a header before anything is allocated.

    Raises:
        InputError: an axis is empty, or there are more than ``max_pixels`` pixels, MAX_CHANNELS channels or
            MAX_VALUES values.
    """
    if len(shape) not in (2, 3):
        raise InputError(f"{name} has {len(shape)} axes {tuple(shape)}; give [row, column] or [channel, row, column]")
    if min(shape) < 1:
        raise InputError(f"{name} is empty, its shape is {tuple(shape)}; give an image of at least 1 x 1")
    channels = 1 if len(shape) == 2 else min(shape)
    values = math.prod(shape)
    if values > min(max_pixels * channels, MAX_VALUES) or channels > MAX_CHANNELS:
        size = " x ".join(map(str, shape))
        raise InputError(
            f"{name} claims {size} values; at most {max_pixels:.3g} pixels, {MAX_CHANNELS} channels and "
            f"{MAX_VALUES:.3g} values are read; crop it"
        )


def check_image(name: str, shape: Sequence[int], max_pixels: int, fits: FitsCheck | None) -> None:
    """:func:`check_pixels`, and what the reader of the image asks.

    Args:
        name: of the file, for messages.
        shape: [H, W] or [C, H, W].
        max_pixels: largest H * W.
        fits: called with C, H, W; None takes any.
    """
    check_pixels(name, shape, max_pixels)
    if fits is not None:
        channels, rows, columns = (1, *shape)[-3:]
        fits(channels, rows, columns)


def channel_axis(shape: Sequence[int]) -> int:
    """Which axis of a bare three-axis array is the channel: 0, 2, or -1 where nobody can tell.

    Up to 4 entries on the first axis make it the channel, else up to 4 on the
    last; else up to MAX_CHANNELS and fewer than both others, first axis first.
    """
    first, _, last = shape
    if first <= 4 or last <= 4:
        return 0 if first <= 4 else 2
    if first <= MAX_CHANNELS and first < min(shape[1:]):
        return 0
    return 2 if last <= MAX_CHANNELS and last < min(shape[:2]) else -1


def channel_first(array: Array, name: str) -> Array:
    """The array with its channel axis in front, [H, W] as one channel.

    Raises:
        InputError: nobody can tell which axis is the channel.
    """
    if array.ndim == 2:
        return array[None]
    axis = channel_axis(array.shape)
    if axis < 0:
        raise InputError(f"{name} has shape {array.shape}: no axis looks like channels; save [channel, row, column]")
    return np.moveaxis(array, axis, 0)


def checked_values(array: Array, name: str) -> npt.NDArray[np.float32]:
    """Pixels as float32, in memory order.

    Raises:
        InputError: a value is NaN, infinite or more negative than noise.
    """
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(array, dtype=np.float32)
    bad = ~np.isfinite(values)
    if bad.any():
        first = ", ".join(map(str, np.unravel_index(int(bad.argmax()), bad.shape)))
        raise InputError(f"{name}: {int(bad.sum())} pixels are NaN or infinite, first at [{first}]; repair them")
    low, high = float(values.min()), float(values.max())
    if low < -MAX_NEGATIVE * max(high, 0.0):
        raise InputError(
            f"{name}: lowest value {low:.4g} is below -{MAX_NEGATIVE:g} of the highest, {high:.4g}; "
            "light cannot be negative, check dark subtraction"
        )
    return values
