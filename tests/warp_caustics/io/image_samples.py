"""Small images and hand-made files for the tests, and what a good refusal looks like."""

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import CausticsError
from warp_caustics.io import read_image

Refused = tuple[str, bytes | Callable[[], bytes], type[CausticsError], str]
"""File name, content, error, part of its line."""
Warned = tuple[str, bytes, str, float]
"""File name, content, part of the warning, value of the first pixel."""

LEVELS = np.arange(65536, dtype=np.uint16).reshape(1, 256, 256)
RGB_LEVELS = np.concatenate([LEVELS, LEVELS[:, ::-1], LEVELS.transpose(0, 2, 1)])
SUFFIXES = [".png", ".tif", ".npy", ".npz", ".h5", ".exr"]


def smooth_rgb(size: int = 64) -> np.ndarray:
    noise = np.random.default_rng(5).random((3, size, size), dtype=np.float32)
    return 0.5 + noise


def png(
    width: int, height: int, bits: int, colour: int, rows: bytes, *extra: tuple[bytes, bytes], interlace: int = 0
) -> bytes:
    """A PNG from filtered rows, with chunks `extra` in front of the data."""
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlace)
    chunks = [(b"IHDR", header), *extra, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    packed = (struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def exif(orientation: int) -> bytes:
    return b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)


def tiff(data: np.ndarray | bytes, size: tuple[int, int] = (8, 8), **tags: int) -> bytes:
    """A one-strip TIFF written by hand: 16-bit gray unless tags say otherwise."""
    body = data if isinstance(data, bytes) else data.astype("<u2").tobytes()
    values = {256: size[1], 257: size[0], 258: 16, 259: 1, 262: 1, 273: 8, 277: 1, 278: size[0], 279: len(body)}
    values |= {int(key[1:]): value for key, value in tags.items()}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(values.items()))
    return b"II*\0" + struct.pack("<I", 8 + len(body)) + body + struct.pack("<H", len(values)) + entries + bytes(4)


def npy(array: np.ndarray, **options: bool) -> bytes:
    stream = BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def npy_header(text: str) -> bytes:
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode()


def wrong_crc() -> bytes:
    data = bytearray(png(1, 1, 16, 0, b"\0\1\2"))
    data[-20] ^= 1
    return bytes(data)


def refusal(path: Path, error: type[CausticsError], text: str, **options: object) -> str:
    with pytest.raises(error) as caught:
        read_image(path, **options)
    line = str(caught.value)
    assert type(caught.value) is error
    assert text in line, line
    assert "\n" not in line and len(line) < 500, line
    return line


def check_refused(folder: Path, case: Refused) -> None:
    name, content, error, text = case
    if name.endswith(".exr"):
        pytest.importorskip("OpenEXR")
    (folder / name).write_bytes(content if isinstance(content, bytes) else content())
    line = refusal(folder / name, error, text)
    assert repr(str(folder / name)) in line


def check_warned(folder: Path, case: Warned) -> None:
    name, content, text, first = case
    (folder / name).write_bytes(content)
    image = read_image(folder / name)
    assert image.values[0, 0, 0] == first
    assert any(text in line for line in image.warnings), image.warnings
    assert all("\n" not in line for line in image.warnings)
