"""TIFF in and out: unsigned integers or floats, gray or RGB, compressed without loss."""

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io.atomic import reason
from warp_caustics.io.decoded import Decoded, check_orientation, own_description, without_alpha
from warp_caustics.io.image_file import FitsCheck, check_image, check_pixels
from warp_caustics.io.image_output import Output

# tifffile logs what it finds odd; without a handler Python would print that between the lines for the user.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

_LOSSLESS_TIFF = {1: "none", 5: "LZW", 8: "deflate", 32946: "deflate", 32773: "PackBits", 34925: "LZMA", 50000: "Zstd"}
_RAW_KINDS = (32803, 34892)
"""Photometric interpretations CFA and LinearRaw."""
_TIFF_BITS = ({8}, {16}, {32}, {64})


def _tiff_page(tiff: Any, page: int | None, name: str) -> Any:
    count = len(tiff.pages)
    if page is None and count > 1:
        raise InputError(f"{name} has {count} pages; choose one with --page 0 to {count - 1}, or save one RGB page")
    if page is not None and not 0 <= page < count:
        raise InputError(f"{name} has no page {page}; choose 0 to {count - 1}")
    return tiff.pages[page or 0]


def _holds_raw(page: Any) -> bool:
    """Whether page, or one within it, holds the mosaic of a sensor; the page itself is then but a thumbnail."""
    inner = list(page.pages or ()) if 330 in page.tags else []
    return any(int(getattr(part, "photometric", 0) or 0) in _RAW_KINDS for part in (page, *inner))


def _check_tiff_kind(page: Any, name: str) -> None:
    if 50706 in page.tags or _holds_raw(page):
        raise InputError(f"{name} is a raw camera file (DNG or alike); export a 16-bit linear TIFF")
    bits = page.tags.valueof(258, (page.bitspersample,))
    bits = set(bits) if isinstance(bits, tuple) else {bits}
    if int(page.photometric) not in (0, 1, 2):
        kind = getattr(page.photometric, "name", str(page.photometric))
        raise InputError(f"{name} is a TIFF of kind {kind}; export gray or RGB with 16 bits or float32")
    if int(page.compression) not in _LOSSLESS_TIFF:
        kind = getattr(page.compression, "name", str(page.compression))
        raise InputError(f"{name} is compressed by {kind}; export without compression, with deflate or LZW")
    if bits not in _TIFF_BITS or page.dtype is None or page.dtype.kind not in "uf":
        raise InputError(f"{name} has {sorted(bits)} bits of {page.dtype}; export unsigned 16 bits or float32")
    check_orientation(name, int(page.tags.valueof(274, 1)))


def _check_tiff_segments(page: Any, name: str) -> None:
    """All strips or tiles must lie inside the file; the decoder fills missing ones with zeros."""
    tile = page.tilewidth * page.tilelength
    if page.is_tiled and tile > max(4 * page.imagewidth * page.imagelength, 1 << 22):
        raise InputError(
            f"{name} has tiles of {page.tilewidth} x {page.tilelength}, larger than itself; export it again"
        )
    offsets, counts = page.dataoffsets, page.databytecounts
    end = page.parent.filehandle.size
    inside = all(o > 0 and c > 0 and o + c <= end for o, c in zip(offsets, counts, strict=True))
    if not inside or len(offsets) != math.prod(page.chunked):
        raise DamagedDataError(f"{name}: TIFF is truncated, parts of the image lie outside it; export or copy it again")


def _check_tiff_shape(page: Any, name: str, max_pixels: int, fits: FitsCheck | None) -> bool:
    """Refuse sizes that nobody can use; tells whether the last sample is alpha."""
    check_pixels(name, page.shape, max_pixels)
    if page.axes not in ("YX", "YXS", "SYX"):
        raise InputError(f"{name} has axes {page.axes}; export one gray or RGB image")
    has_alpha = any(int(kind) in (1, 2) for kind in page.extrasamples)
    samples = {"YX": 1, "YXS": page.shape[-1], "SYX": page.shape[0]}[page.axes]
    rows, columns = page.shape[1:] if page.axes == "SYX" else page.shape[:2]
    check_image(name, (max(1, samples - has_alpha), rows, columns), max_pixels, fits)
    return has_alpha


def _decode_tiff(page: Any, name: str, max_pixels: int, fits: FitsCheck | None) -> Decoded:
    _check_tiff_kind(page, name)
    has_alpha = _check_tiff_shape(page, name, max_pixels, fits)
    _check_tiff_segments(page, name)
    description, notes = own_description(page.description), []
    if 34675 in page.tags:
        notes.append(f"{name} carries a colour profile, which is not applied; export linear data")
    array = page.asarray()
    array = np.moveaxis(array, -1, 0) if page.axes == "YXS" else array.reshape(-1, *array.shape[-2:])
    if int(page.photometric) == 0:
        if array.dtype.kind != "u":
            raise InputError(f"{name} is a float TIFF in which white is 0; export with black as 0")
        array = np.iinfo(array.dtype).max - array
        notes.append("white was stored as 0 (MinIsWhite); values were inverted")
    if has_alpha:
        array = without_alpha(array, name, notes)
    return Decoded(array, description, notes)


def read_tiff(path: Path, page: int | None, max_pixels: int, fits: FitsCheck | None = None) -> Decoded:
    """One page of a TIFF, [C, H, W] in its own type.

    Raises:
        InputError: a kind of TIFF that loses or hides something, or several pages and none chosen.
        DamagedDataError: truncated or corrupt.
    """
    import tifffile

    name = repr(str(path))
    try:
        with tifffile.TiffFile(path) as tiff:
            return _decode_tiff(_tiff_page(tiff, page, name), name, max_pixels, fits)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: TIFF cannot be decoded ({reason(error)}); export it again") from error


def write_tiff(path: Path, image: Output) -> None:
    """Write one page, channels as separate planes."""
    import tifffile

    channels = len(image.array)
    size = image.pixel_size_m
    tifffile.imwrite(
        path,
        image.array if channels > 1 else image.array[0],
        photometric="rgb" if channels == 3 else "minisblack",
        planarconfig="separate" if channels > 1 else None,
        compression="zlib",
        metadata=None,
        description=image.description(),
        software="nsfc",
        resolution=None if size is None else (0.01 / size[0], 0.01 / size[1]),
        resolutionunit=None if size is None else "CENTIMETER",
    )
