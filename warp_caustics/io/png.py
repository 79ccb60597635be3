"""PNG in and out: 8 or 16 bits, gray or RGB, with every checksum verified."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io.atomic import reason
from warp_caustics.io.decoded import Decoded, check_orientation, own_description, without_alpha
from warp_caustics.io.image_file import FitsCheck, check_image
from warp_caustics.io.image_output import Output
from warp_caustics.io.regular import open_regular, read_regular

_MAX_CHUNKS = 200_000
"""The largest picture in pieces of 8 kB has 48,000."""
_MAX_EXTRA_BYTES = 1 << 24
"""Of chunks other than pixels, and of what pixels grow by that cannot be compressed."""
_COLOURS = {0: 1, 2: 3, 4: 1, 6: 3}
"""Colour type to channels without alpha."""


def _checked_header(path: Path, name: str, max_pixels: int, fits: FitsCheck | None) -> int:
    """Colour type of a PNG whose header and size allow reading it at all."""
    with open_regular(path) as file:
        head = file.read(33)
    if len(head) < 33 or head[12:16] != b"IHDR" or head[8:12] != b"\0\0\0\x0d":
        raise DamagedDataError(f"{name}: PNG has no valid header; export it again")
    if zlib.crc32(head[12:29]) != int.from_bytes(head[29:33], "big"):
        raise DamagedDataError(f"{name}: checksum of PNG chunk b'IHDR' is wrong; export or copy it again")
    width, height, bits, colour = struct.unpack_from(">IIBB", head, 16)
    check_image(name, (_COLOURS.get(colour, 1), height, width), max_pixels, None)
    if colour not in _COLOURS or bits not in (8, 16):
        kind = "a palette" if colour == 3 else f"{bits} bit per value"
        raise InputError(f"{name} is a PNG with {kind}; export gray or RGB with 16 bits")
    if fits is not None:
        fits(_COLOURS[colour], height, width)
    needed = height * (1 + width * bits // 8 * (_COLOURS[colour] + (colour in (4, 6))))
    size = path.stat().st_size
    if size > needed + needed // 100 + _MAX_EXTRA_BYTES:
        raise InputError(f"{name} has {size} bytes, its pixels need {needed}; export it again")
    return int(colour)


def _png_chunks(data: bytes, name: str) -> tuple[dict[bytes, bytes], int]:
    """First chunk of each kind (IDAT left out) and the end of the image; every checksum is verified."""
    chunks: dict[bytes, bytes] = {}
    position, count = 8, 0
    while position + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        end = position + 12 + length
        if end > len(data):
            break
        count += 1
        if count > _MAX_CHUNKS:
            raise InputError(f"{name} has more than {_MAX_CHUNKS} chunks; export it again")
        if zlib.crc32(data[position + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise DamagedDataError(f"{name}: checksum of PNG chunk {kind!r} is wrong; export or copy it again")
        if kind != b"IDAT":
            chunks.setdefault(kind, data[position + 8 : end - 4])
        if kind == b"IEND":
            return chunks, end
        position = end
    raise DamagedDataError(f"{name}: PNG is truncated after {len(data)} bytes; export or copy it again")


def _exif_orientation(exif: bytes) -> int:
    order = "<" if exif[:2] == b"II" else ">"
    try:
        (start,) = struct.unpack_from(f"{order}I", exif, 4)
        (count,) = struct.unpack_from(f"{order}H", exif, start)
        for entry in range(start + 2, start + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, entry)
            if tag == 0x0112:
                return int(value)
    except struct.error:
        pass
    return 1


def _png_text(chunk: bytes | None) -> dict[str, Any]:
    keyword, _, text = (chunk or b"").partition(b"\0")
    return own_description(text.decode("latin-1")) if keyword == b"Description" else {}


def read_png(path: Path, max_pixels: int, fits: FitsCheck | None = None) -> Decoded:
    """A PNG, [C, H, W] in its own type.

    Raises:
        InputError: a kind of PNG that loses or hides something.
        DamagedDataError: truncated or corrupt.
    """
    import imagecodecs

    name = repr(str(path))
    colour = _checked_header(path, name, max_pixels, fits)
    data = read_regular(path, max_bytes=path.stat().st_size)
    chunks, end = _png_chunks(data, name)
    if b"acTL" in chunks:
        raise InputError(f"{name} is an animated PNG; export one frame")
    if b"tRNS" in chunks:
        raise InputError(f"{name} declares a transparent colour; export it without transparency")
    if data.find(b"\x89PNG\r\n\x1a\n", end) >= 0:
        raise InputError(f"{name} holds a second PNG after the first; split the file")
    check_orientation(name, _exif_orientation(chunks.get(b"eXIf", b"")))
    notes = [f"{len(data) - end} bytes after the end of the PNG were ignored"] if end < len(data) else []
    gamma = chunks.get(b"gAMA")
    has_gamma = gamma is not None and int.from_bytes(gamma, "big") != 100_000
    if has_gamma or chunks.keys() & {b"sRGB", b"iCCP", b"cICP"}:
        notes.append(f"{name} declares a tone curve or colour profile, which is not applied; export linear data")
    text = _png_text(chunks.get(b"tEXt"))
    size_chunk = chunks.get(b"pHYs", b"")
    if len(size_chunk) == 9 and not text:
        x, y = struct.unpack_from(">II", size_chunk)
        if abs(x - y) > 0.01 * max(x, y):
            notes.append(f"{name} says its pixels are not square ({x} by {y} per unit); they are taken as they are")
    try:
        array = imagecodecs.png_decode(data)
    except Exception as error:
        raise DamagedDataError(f"{name}: PNG cannot be decoded ({reason(error)}); export it again") from error
    array = array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0)
    if colour in (4, 6):
        array = without_alpha(array, name, notes)
    return Decoded(array, text, notes)


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def write_png(path: Path, image: Output) -> None:
    """Write counts as they are, floats as counts of maximum / 65535.

    Raises:
        InputError: negative values, or neither 1 nor 3 channels.
    """
    import imagecodecs

    array, more = image.array, {}
    if len(array) not in (1, 3):
        raise InputError(f"PNG holds 1 or 3 channels, not {len(array)}; write .tif, .h5 or .exr")
    if array.dtype.kind == "f":
        if array.min() < 0:
            raise InputError(f"PNG holds no negative values, the lowest is {array.min():.4g}; write .tif, .h5 or .exr")
        count = (float(array.max()) or 1.0) / 65535
        array, more = np.rint(array / count).astype(np.uint16), {"count_W_m2": count}
    data = imagecodecs.png_encode(array[0] if len(array) == 1 else np.ascontiguousarray(np.moveaxis(array, 0, -1)))
    extra = _png_chunk(b"tEXt", b"Description\0" + image.description(**more).encode("ascii"))
    if image.pixel_size_m is not None:
        per_metre = [min(round(1 / size), 2**31 - 1) for size in image.pixel_size_m]
        extra += _png_chunk(b"pHYs", struct.pack(">IIB", *per_metre, 1))
    path.write_bytes(data[:33] + extra + data[33:])  # signature 8 bytes, header chunk 25
