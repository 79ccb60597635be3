"""Images in and out without losing a bit.

Arrays are [channel, row, column]; row grows with +y and files hold row 0
first, nothing is flipped. Integers keep their counts. The content decides the
format, not the suffix. Each file either gives exactly its numbers or one line
that says why not: ordinary readers turn 16-bit RGB PNG into 8 bits, ignore
rotation tags and read damaged files without a word.

Not handled: tone curves other than sRGB (export linear data), colour profiles
(reported, not applied), and HDF5 files crafted to crash the HDF5 library.
"""

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError
from warp_caustics.io.arrays import read_array, write_hdf5, write_npy, write_npz
from warp_caustics.io.atomic import PathLike, atomic_path, reason, regular_file
from warp_caustics.io.decoded import Decoded
from warp_caustics.io.exr import read_exr, write_exr
from warp_caustics.io.image_file import (
    MAX_PIXELS,
    Array,
    FitsCheck,
    ImageFile,
    channel_axis,
    channel_first,
    check_image,
    check_pixels,
    checked_values,
)
from warp_caustics.io.image_format import SUFFIXES, sniff_format
from warp_caustics.io.image_output import Output, checked_output
from warp_caustics.io.jpeg import read_jpeg
from warp_caustics.io.png import read_png, write_png
from warp_caustics.io.tiff import read_tiff, write_tiff

__all__ = ["MAX_PIXELS", "ImageFile", "read_image", "write_image"]


def _linearised(array: Array, transfer: str | None, full_scale: float | None, name: str) -> tuple[Array, list[str]]:
    if transfer not in (None, "srgb", "linear"):
        raise InputError(f"transfer {transfer!r} is not known; use srgb or linear")
    if transfer == "srgb":
        if full_scale is None:
            raise InputError(f"{name} holds floats, which have no sRGB curve here; leave --transfer srgb out")
        x = array.astype(np.float64) / full_scale
        # IEC 61966-2-1
        return full_scale * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4), []
    if transfer is None and full_scale == 255:
        levels = "8 bits leave 256 levels, and the tone curve is unknown: linear was assumed"
        return array, [f"{name}: {levels}; export 16 bits, or give --transfer srgb or linear"]
    return array, []


def _check_bare(name: str, shape: Sequence[int], max_pixels: int, fits: FitsCheck | None) -> None:
    """Shape of a bare array, whose channel axis is a guess."""
    check_pixels(name, shape, max_pixels)
    axis = channel_axis(shape) if len(shape) == 3 else 0
    if axis >= 0:
        check_image(name, (shape[2], *shape[:2]) if axis == 2 else shape, max_pixels, fits)


def _value_notes(values: npt.NDArray[np.float32], array: Array, name: str) -> list[str]:
    high = float(values.max())
    notes = []
    if values.size > 1 and high == float(values.min()):
        notes.append(f"{name}: all pixels are {high:g}")
    if array.dtype.itemsize == 2 and high in (1023.0, 4095.0, 16383.0):
        bits = int(high + 1).bit_length() - 1
        notes.append(f"{name}: the highest value {high:.0f} looks like saturated {bits}-bit data, taken as 16-bit")
    if array.dtype == np.float16:
        notes.append(f"{name} holds 16-bit floats with 3 digits; export float32")
    return notes


def _recorded_wavelengths_m(decoded: Decoded, channels: int, name: str) -> tuple[float, ...] | None:
    recorded = decoded.description.get("wavelengths_m")
    if recorded is None:
        return None
    try:
        wavelengths = tuple(float(value) for value in recorded)
    except (TypeError, ValueError):
        wavelengths = ()
    if len(wavelengths) != channels or not all(0 < value < 1e-4 for value in wavelengths):
        decoded.notes.append(f"{name} records wavelengths that do not fit its {channels} channels; ignored")
        return None
    return wavelengths


def read_image(
    path: PathLike,
    *,
    page: int | None = None,
    dataset: str | None = None,
    transfer: str | None = None,
    max_pixels: int = MAX_PIXELS,
    fits: FitsCheck | None = None,
) -> ImageFile:
    """Read one image with every level it holds.

    Bare arrays (NPY, NPZ, HDF5) may be [H, W], [C, H, W] or [H, W, C]; see
    :func:`warp_caustics.io.image_file.channel_axis` for the rule ([3, 512, 3] is three channels of 512 x 3).

    Args:
        path: PNG, TIFF, EXR, NPY, NPZ, HDF5 or (with transfer="srgb") JPEG file; its content tells which.
        page: page of a TIFF with several, from 0.
        dataset: array in HDF5 or NPZ, ``image`` if not given.
        transfer: tone curve of integer data, ``"srgb"`` or ``"linear"``; not given: linear, with a warning at 8 bits.
        max_pixels: largest H * W, checked before decoding.
        fits: called with channels, rows and columns before decoding; raises to refuse an image that nobody can use.

    Returns:
        The image; ``values`` has shape [C, H, W].

    Raises:
        InputError: a path, format or content that cannot be used as it is.
        DamagedDataError: a truncated or corrupt file.
    """
    path = regular_file(path)
    name = repr(str(path))
    format_, notes = sniff_format(path)
    if page is not None and format_ != "tiff":
        raise InputError(f"{name} is {format_}, which has no pages; leave --page {page} out")
    if dataset is not None and format_ not in ("npz", "hdf5"):
        raise InputError(f"{name} is {format_}, which has no datasets; leave --dataset {dataset} out")
    try:
        if format_ == "png":
            decoded = read_png(path, max_pixels, fits)
        elif format_ == "tiff":
            decoded = read_tiff(path, page, max_pixels, fits)
        elif format_ == "jpeg":
            if transfer != "srgb":
                raise InputError(
                    f"{name} is JPEG, which holds toned 8-bit values; export a 16-bit linear TIFF, "
                    "or give --transfer srgb to take it as it is"
                )
            decoded = read_jpeg(path, max_pixels, fits)
        elif format_ == "exr":
            decoded = read_exr(path, max_pixels, fits)
        else:
            decoded = read_array(path, format_, dataset or "image", lambda s: _check_bare(name, s, max_pixels, fits))
            decoded.array = channel_first(decoded.array, name)
    except OSError as error:
        raise InputError(f"{name} could not be read to its end ({reason(error)}); is it still there?") from error
    array = decoded.array
    if array.dtype.kind != "f" and (array.dtype.kind != "u" or array.dtype.itemsize > 2):
        raise InputError(f"{name} holds {array.dtype}; save uint8, uint16, float32 or float64")
    full_scale = float(np.iinfo(array.dtype).max) if array.dtype.kind == "u" else None
    linear, tone_notes = _linearised(array, transfer, full_scale, name)
    values = checked_values(linear, name)
    wavelengths_m = _recorded_wavelengths_m(decoded, len(values), name)
    count = decoded.description.get("count_W_m2")
    return ImageFile(
        values=values,
        full_scale=full_scale,
        bit_depth=8 * array.dtype.itemsize,
        format=format_,
        warnings=(*notes, *decoded.notes, *tone_notes, *_value_notes(values, array, name)),
        wavelengths_m=wavelengths_m,
        count_W_m2=float(count) if isinstance(count, float) and 0 < count < math.inf else None,
    )


_WRITERS: dict[str, Callable[[Path, Output], None]] = {
    "png": write_png,
    "tiff": write_tiff,
    "exr": write_exr,
    "npy": write_npy,
    "npz": write_npz,
    "hdf5": write_hdf5,
}


def write_image(
    path: PathLike,
    values: npt.ArrayLike,
    *,
    wavelengths_m: Sequence[float] | None = None,
    pixel_size_m: float | tuple[float, float] | None = None,
) -> None:
    """Write an image in the format its suffix names; it appears complete or not at all.

    uint8 and uint16 counts are written as they are (EXR: as float32), floats as
    float32. PNG has no floats: they are divided by maximum / 65535 and rounded,
    and that count_W_m2 is recorded in the file's description (tEXt chunk),
    which :func:`read_image` returns.

    Args:
        path: .png, .tif, .tiff, .exr, .npy, .npz, .h5 or .hdf5.
        values: irradiance [W/m^2] or counts, shape [C, H, W] or [H, W].
        wavelengths_m: wavelength of each channel [m], shape [C]; NPY cannot hold it.
        pixel_size_m: extent of a pixel [m], one number or (x, y).

    Raises:
        InputError: unknown suffix, or values the format cannot hold.
        ResourceError: the disk is full.
    """
    suffix = Path(os.fspath(path)).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"suffix {suffix!r} of {os.fspath(path)!r} is not known; use one of {', '.join(SUFFIXES)}")
    image = checked_output(values, wavelengths_m, pixel_size_m)
    with atomic_path(path) as temporary:
        _WRITERS[SUFFIXES[suffix]](temporary, image)
