"""A checked image on its way to a file."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError
from warp_caustics.io.image_file import Array, channel_axis, checked_values


@dataclass(frozen=True)
class Output:
    """A checked image on its way to a file; shapes and units as in write_image."""

    array: Array
    wavelengths_m: tuple[float, ...] | None
    pixel_size_m: tuple[float, float] | None

    def description(self, **more: object) -> str:
        content: dict[str, object] = {
            "software": "nsfc",
            "units": "counts" if self.array.dtype.kind == "u" else "W/m^2",
            "axes": "channel, row, column",
        }
        for key in ("wavelengths_m", "pixel_size_m"):
            if getattr(self, key) is not None:
                content[key] = getattr(self, key)
        return json.dumps(content | more)


def checked_output(
    values: npt.ArrayLike, wavelengths_m: Sequence[float] | None, pixel_size_m: float | tuple[float, float] | None
) -> Output:
    """Check what :func:`warp_caustics.io.images.write_image` was given.

    Raises:
        InputError: pixels, wavelengths or a pixel size that no format can hold.
    """
    array = np.asarray(values)
    if array.dtype.kind != "f" and array.dtype not in (np.uint8, np.uint16):
        raise InputError(f"images of {array.dtype} are not written; give uint8, uint16 or float32")
    array = array[None] if array.ndim == 2 else array
    if array.ndim != 3 or array.size == 0:
        raise InputError(f"an image of shape {array.shape} is not written; give [channel, row, column]")
    if channel_axis(array.shape) != 0:
        raise InputError(f"shape {array.shape} does not read as [channel, row, column]; move the channels to the front")
    if array.dtype.kind == "f":
        array = checked_values(array, "the image")
    if wavelengths_m is not None:
        wavelengths_m = tuple(float(value) for value in wavelengths_m)
        if len(wavelengths_m) != len(array) or len(set(wavelengths_m)) != len(array):
            raise InputError(f"{len(array)} channels but wavelengths {wavelengths_m}; give one each, none twice")
        if not all(0 < value < 1e-4 for value in wavelengths_m):
            raise InputError(f"wavelengths {wavelengths_m} are not metres; 530 nm is 530e-9")
    if isinstance(pixel_size_m, int | float):
        pixel_size_m = (float(pixel_size_m), float(pixel_size_m))
    if pixel_size_m is not None and not all(0 < size < 1 for size in pixel_size_m):
        raise InputError(f"pixel size {pixel_size_m} is not between 0 and 1 m; give metres")
    return Output(array, wavelengths_m, pixel_size_m)
