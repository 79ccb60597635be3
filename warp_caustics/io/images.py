"""Images in and out without losing a bit.

Arrays are [channel, row, column]; row grows with +y and files hold row 0
first, nothing is flipped. Integers keep their counts. The content decides the
format, not the suffix. Each file either gives exactly its numbers or one line
that says why not: ordinary readers turn 16-bit RGB PNG into 8 bits, ignore
rotation tags and read damaged files without a word.

Not handled: tone curves other than sRGB (export linear data), colour profiles
(reported, not applied), and HDF5 files crafted to crash the HDF5 library.
"""

import codecs
import contextlib
import io
import json
import logging
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io.atomic import PathLike, atomic_path, reason, regular_file

Array = npt.NDArray[Any]

MAX_PIXELS = 64_000_000
MAX_CHANNELS = 64
"""The largest number of wavelengths a scene may have."""
MAX_NEGATIVE = 1e-3
"""Dark subtraction leaves small negative noise; below -MAX_NEGATIVE times the maximum something is wrong."""

_SUFFIXES = {
    ".png": "png",
    ".tif": "tiff",
    ".tiff": "tiff",
    ".exr": "exr",
    ".npy": "npy",
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
}
_MAGIC = {
    b"\x89PNG\r\n\x1a\n": "png",
    b"II*\0": "tiff",
    b"MM\0*": "tiff",
    b"II+\0": "tiff",
    b"MM\0+": "tiff",
    b"\x76\x2f\x31\x01": "exr",
    b"\x93NUMPY": "npy",
    b"PK\x03\x04": "npz",
    b"PK\x05\x06": "npz",
    b"\x89HDF\r\n\x1a\n": "hdf5",
}
_REFUSED_MAGIC = {
    b"\xff\xd8\xff": "JPEG, which is lossy, 8-bit and processed by the camera",
    b"GIF8": "GIF, which has a palette of 256 colours",
    b"BM": "BMP, which has 8 bits",
    b"RIFF": "WebP, which is 8-bit and mostly lossy",
    b"\0\0\0\x0cjP": "JPEG 2000, which is mostly lossy",
    b"\xff\x0a": "JPEG XL, which is mostly lossy",
    b"%PDF": "a PDF",
    b"FUJIFILM": "a raw camera file",
}

# tifffile logs what it finds odd; without a handler Python would print that between the lines for the user.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


@dataclass(frozen=True, eq=False)
class ImageFile:
    """One image as its file holds it.

    Attributes:
        values: pixels in the file's own linear unit (counts or W/m^2), float32, shape [C, H, W].
        full_scale: largest value the file's type can hold (255, 65535), None for floats.
        bit_depth: bits per value in the file.
        format: ``png``, ``tiff``, ``exr``, ``npy``, ``npz`` or ``hdf5``.
        warnings: one line for each thing a person should know.
        wavelengths_m: wavelength of each channel [m], shape [C], where the file records it.
        count_W_m2: irradiance of one count [W/m^2], where the file records it (PNG by :func:`write_image`).
    """

    values: npt.NDArray[np.float32]
    full_scale: float | None
    bit_depth: int
    format: str
    warnings: tuple[str, ...] = ()
    wavelengths_m: tuple[float, ...] | None = None
    count_W_m2: float | None = None


@dataclass
class Decoded:
    """What a format's reader hands over: numbers as stored, channel first where the format tells."""

    array: Array
    description: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


# --------------------------------------------------------------------------- which format


def _is_text(head: bytes) -> bool:
    try:
        # Incremental, because the head may end within a character.
        text = codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(character.isprintable() or character.isspace() for character in text)


def sniff_format(path: Path) -> tuple[str, list[str]]:
    """Format by the first bytes of a file, and a note where its suffix claims another.

    Raises:
        InputError: the content is no format that keeps all bits.
    """
    with path.open("rb") as stream:
        head = stream.read(512)
    name = repr(str(path))
    for magic, format_ in _MAGIC.items():
        if head.startswith(magic):
            claimed = _SUFFIXES.get(path.suffix.lower(), format_)
            wrong = f"{name} holds {format_} data in spite of its suffix; read as {format_}, rename it"
            return format_, [] if claimed == format_ else [wrong]
    refused = next((text for magic, text in _REFUSED_MAGIC.items() if head.startswith(magic)), None)
    if head[4:8] == b"ftyp":
        refused = "HEIC, AVIF or a raw camera file"
    if refused is None:
        refused = "text" if _is_text(head) else "in none of the known formats"
    raise InputError(f"{name} is {refused}; export a linear 16-bit TIFF or PNG, or give EXR, NPY, NPZ or HDF5")


def check_pixels(name: str, shape: Sequence[int], max_pixels: int) -> None:
    """Refuse a size from a header before anything is allocated.

    Raises:
        InputError: an axis is empty, or there are more than ``max_pixels`` pixels or MAX_CHANNELS channels.
    """
    if len(shape) not in (2, 3):
        raise InputError(f"{name} has {len(shape)} axes {tuple(shape)}; give [row, column] or [channel, row, column]")
    if min(shape) < 1:
        raise InputError(f"{name} is empty, its shape is {tuple(shape)}; give an image of at least 1 x 1")
    channels = 1 if len(shape) == 2 else min(shape)
    if math.prod(shape) > max_pixels * channels or channels > MAX_CHANNELS:
        size = " x ".join(map(str, shape))
        raise InputError(
            f"{name} claims {size} values; at most {max_pixels:.3g} pixels of {MAX_CHANNELS} channels are read; crop it"
        )


# --------------------------------------------------------------------------- arrays: NPY, NPZ, HDF5


def _npy_header(stream: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise InputError(f"{name} is NPY version {version}, meant for records; save a plain float32 array")
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        return reader(stream)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: NPY header cannot be read ({reason(error)}); save it again") from error


def _npy_array(stream: IO[bytes], name: str, check: Callable[[Sequence[int]], None]) -> Array:
    shape, fortran, dtype = _npy_header(stream, name)
    if dtype.kind not in "uif":
        raise InputError(f"{name} holds {dtype}, not real numbers; save float32")
    check(shape)
    wanted = math.prod(shape) * dtype.itemsize
    try:
        data = stream.read(wanted + 1)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise DamagedDataError(f"{name} is damaged ({reason(error)}); save or copy it again") from error
    if len(data) != wanted:
        state = "truncated" if len(data) < wanted else "followed by foreign bytes"
        raise DamagedDataError(f"{name} is {state}: its header promises {wanted} bytes; save or copy it again")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _npz_arrays(path: Path, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    name = repr(str(path))
    try:
        with zipfile.ZipFile(path) as archive:
            keys = [member.removesuffix(".npy") for member in archive.namelist()]
            if key not in keys:
                raise InputError(
                    f"{name} has no array {key!r} but {', '.join(keys[:8]) or 'nothing'}; name one of them"
                )
            with archive.open(f"{key}.npy") as stream:
                array = _npy_array(stream, f"{name} {key}", check)
            description: dict[str, Any] = {}
            if "wavelengths_m" in keys:
                with archive.open("wavelengths_m.npy") as stream:
                    description["wavelengths_m"] = _npy_array(stream, f"{name} wavelengths_m", _check_short).tolist()
            return Decoded(array, description)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: NPZ cannot be read ({reason(error)}); save or copy it again") from error


def _check_short(shape: Sequence[int]) -> None:
    if len(shape) != 1 or shape[0] > MAX_CHANNELS:
        raise InputError(f"wavelengths_m has shape {tuple(shape)}; give one wavelength per channel")


def _local_dataset(file: Any, key: str, name: str) -> Any:
    """The dataset `key` if its numbers lie in this very file; other files could be missing or anything."""
    import h5py

    node = file
    for part in filter(None, key.split("/")):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            found = ", ".join(list(file)[:8]) or "nothing"
            raise InputError(f"{name} has no dataset {key!r} but {found}; name one of them")
        if not isinstance(link, h5py.HardLink):
            raise InputError(f"{name}: {key!r} is a link to another place; copy the data into the file")
        node = node[part]
    if not isinstance(node, h5py.Dataset):
        raise InputError(f"{name}: {key!r} is a group, not a dataset; name one of {', '.join(list(node)[:8])}")
    if node.is_virtual or node.external:
        raise InputError(f"{name}: {key!r} keeps its numbers in other files; copy the data into the file")
    return node


def _hdf5_array(path: Path, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    import h5py

    name = repr(str(path))
    try:
        with h5py.File(path, "r") as file:
            data = _local_dataset(file, key, name)
            if data.dtype.kind not in "uif":
                raise InputError(f"{name} {key} holds {data.dtype}, not real numbers; save float32")
            check(data.shape or ())
            if data.chunks and math.prod(data.chunks) > 4 * max(math.prod(data.shape), 1 << 20):
                raise InputError(f"{name} {key} has chunks of {data.chunks}, larger than itself; write it again")
            if not data.id.get_create_plist().all_filters_avail():
                raise InputError(f"{name} {key} is compressed by a filter that is not installed; use gzip")
            description = {
                k: data.attrs[k].tolist() if hasattr(data.attrs[k], "tolist") else data.attrs[k]
                for k in ("units", "wavelengths_m")
                if k in data.attrs
            }
            return Decoded(data[()], description)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: HDF5 cannot be read ({reason(error)}); write or copy it again") from error


def read_array(path: Path, format_: str, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    """Array of an NPY, NPZ or HDF5 file with its shape checked before it is read.

    Args:
        path: a regular file.
        format_: ``npy``, ``npz`` or ``hdf5``.
        key: name of the array in NPZ or HDF5.
        check: called with the shape; raises to refuse it.

    Raises:
        InputError: no such array, no real numbers, or data kept in other files.
        DamagedDataError: truncated or corrupt.
    """
    if format_ == "npy":
        with path.open("rb") as stream:
            return Decoded(_npy_array(stream, repr(str(path)), check))
    return _npz_arrays(path, key, check) if format_ == "npz" else _hdf5_array(path, key, check)


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


def _channel_first(array: Array, name: str) -> Array:
    if array.ndim == 2:
        return array[None]
    axis = channel_axis(array.shape)
    if axis < 0:
        raise InputError(f"{name} has shape {array.shape}: no axis looks like channels; save [channel, row, column]")
    return np.moveaxis(array, axis, 0)


# --------------------------------------------------------------------------- PNG


def _png_chunks(data: bytes, name: str) -> tuple[dict[bytes, bytes], int]:
    """First chunk of each kind (IDAT left out) and the end of the image; every checksum is verified."""
    chunks: dict[bytes, bytes] = {}
    position = 8
    while position + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        end = position + 12 + length
        if end > len(data):
            break
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


def _check_orientation(name: str, orientation: int) -> None:
    if orientation != 1:
        raise InputError(
            f"{name} asks viewers to rotate or mirror it (EXIF orientation {orientation}); "
            "export it upright, without that tag"
        )


def _png_text(chunk: bytes | None) -> dict[str, Any]:
    keyword, _, text = (chunk or b"").partition(b"\0")
    return own_description(text.decode("latin-1")) if keyword == b"Description" else {}


def _without_alpha(array: Array, name: str, notes: list[str]) -> Array:
    """Drop an opaque last channel; refuse one that hides something."""
    opaque = np.iinfo(array.dtype).max if array.dtype.kind == "u" else 1
    if np.any(array[-1] != opaque):
        raise InputError(f"{name} is partly transparent; export it without an alpha channel")
    notes.append("an opaque alpha channel was dropped")
    return array[:-1]


def _read_png(path: Path, max_pixels: int) -> Decoded:
    import imagecodecs

    name = repr(str(path))
    size = path.stat().st_size
    if size > max_pixels * 9 + (1 << 24):
        raise InputError(f"{name} has {size} bytes, more than {max_pixels:.3g} pixels need; crop it")
    data = path.read_bytes()
    chunks, end = _png_chunks(data, name)
    if len(chunks.get(b"IHDR", b"")) != 13:
        raise DamagedDataError(f"{name}: PNG has no valid header; export it again")
    width, height, bits, colour = struct.unpack_from(">IIBB", chunks[b"IHDR"])
    check_pixels(name, (height, width), max_pixels)
    if colour == 3 or bits not in (8, 16):
        kind = "a palette" if colour == 3 else f"{bits} bit per value"
        raise InputError(f"{name} is a PNG with {kind}; export gray or RGB with 16 bits")
    if b"acTL" in chunks:
        raise InputError(f"{name} is an animated PNG; export one frame")
    if b"tRNS" in chunks:
        raise InputError(f"{name} declares a transparent colour; export it without transparency")
    if data.find(b"\x89PNG\r\n\x1a\n", end) >= 0:
        raise InputError(f"{name} holds a second PNG after the first; split the file")
    _check_orientation(name, _exif_orientation(chunks.get(b"eXIf", b"")))
    notes = [f"{len(data) - end} bytes after the end of the PNG were ignored"] if end < len(data) else []
    gamma = chunks.get(b"gAMA")
    has_gamma = gamma is not None and int.from_bytes(gamma, "big") != 100_000
    if has_gamma or chunks.keys() & {b"sRGB", b"iCCP", b"cICP"}:
        notes.append(f"{name} declares a tone curve or colour profile, which is not applied; export linear data")
    try:
        array = imagecodecs.png_decode(data)
    except Exception as error:
        raise DamagedDataError(f"{name}: PNG cannot be decoded ({reason(error)}); export it again") from error
    array = array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0)
    if colour in (4, 6):
        array = _without_alpha(array, name, notes)
    return Decoded(array, _png_text(chunks.get(b"tEXt")), notes)


# --------------------------------------------------------------------------- TIFF

_LOSSLESS_TIFF = {1: "none", 5: "LZW", 8: "deflate", 32946: "deflate", 32773: "PackBits", 34925: "LZMA", 50000: "Zstd"}
_TIFF_BITS = ({8}, {16}, {32}, {64})


def own_description(text: str) -> dict[str, Any]:
    """The JSON description this package writes, or an empty one for foreign text."""
    try:
        description = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return description if isinstance(description, dict) and description.get("software") == "nsfc" else {}


def _tiff_page(tiff: Any, page: int | None, name: str) -> Any:
    count = len(tiff.pages)
    if page is None and count > 1:
        raise InputError(f"{name} has {count} pages; choose one with page=0 to {count - 1}, or save one RGB page")
    if page is not None and not 0 <= page < count:
        raise InputError(f"{name} has no page {page}; choose 0 to {count - 1}")
    return tiff.pages[page or 0]


def _check_tiff_kind(page: Any, name: str) -> None:
    bits = page.tags.valueof(258, (page.bitspersample,))
    bits = set(bits) if isinstance(bits, tuple) else {bits}
    if int(page.photometric) not in (0, 1, 2):
        kind = getattr(page.photometric, "name", str(page.photometric))
        raise InputError(f"{name} is a TIFF of kind {kind}; export gray or RGB with 16 bits or float32")
    if 50706 in page.tags:
        raise InputError(f"{name} is a raw camera file (DNG); develop it to a linear 16-bit TIFF")
    if int(page.compression) not in _LOSSLESS_TIFF:
        kind = getattr(page.compression, "name", str(page.compression))
        raise InputError(f"{name} is compressed by {kind}; export without compression, with deflate or LZW")
    if bits not in _TIFF_BITS or page.dtype is None or page.dtype.kind not in "uf":
        raise InputError(f"{name} has {sorted(bits)} bits of {page.dtype}; export unsigned 16 bits or float32")
    _check_orientation(name, int(page.tags.valueof(274, 1)))


def _check_tiff_segments(page: Any, name: str, max_pixels: int) -> None:
    """All strips or tiles must lie inside the file; the decoder fills missing ones with zeros."""
    check_pixels(name, page.shape, max_pixels)
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


def _decode_tiff(page: Any, name: str, max_pixels: int) -> Decoded:
    _check_tiff_kind(page, name)
    _check_tiff_segments(page, name, max_pixels)
    description, notes = own_description(page.description), []
    if 34675 in page.tags:
        notes.append(f"{name} carries a colour profile, which is not applied; export linear data")
    array = page.asarray()
    if page.axes not in ("YX", "YXS", "SYX"):
        raise InputError(f"{name} has axes {page.axes}; export one gray or RGB image")
    array = np.moveaxis(array, -1, 0) if page.axes == "YXS" else array.reshape(-1, *array.shape[-2:])
    if int(page.photometric) == 0:
        if array.dtype.kind != "u":
            raise InputError(f"{name} is a float TIFF in which white is 0; export with black as 0")
        array = np.iinfo(array.dtype).max - array
        notes.append("white was stored as 0 (MinIsWhite); values were inverted")
    if any(int(kind) in (1, 2) for kind in page.extrasamples):
        array = _without_alpha(array, name, notes)
    return Decoded(array, description, notes)


def read_tiff(path: Path, page: int | None, max_pixels: int) -> Decoded:
    """One page of a TIFF, [C, H, W] in its own type.

    Raises:
        InputError: a kind of TIFF that loses or hides something, or several pages and none chosen.
        DamagedDataError: truncated or corrupt.
    """
    import tifffile

    name = repr(str(path))
    try:
        with tifffile.TiffFile(path) as tiff:
            return _decode_tiff(_tiff_page(tiff, page, name), name, max_pixels)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: TIFF cannot be decoded ({reason(error)}); export it again") from error


# --------------------------------------------------------------------------- EXR


def _openexr() -> Any:
    try:
        import OpenEXR
    except ImportError as error:
        raise InputError("EXR needs the OpenEXR package; install it with: pip install 'nsfc[exr]'") from error
    return OpenEXR


def _exr_wavelength_m(channel: str) -> float | None:
    """Wavelength [m] of a channel of the spectral EXR layout, such as S0.610,000000nm."""
    if not (channel.startswith("S0.") and channel.endswith("nm")):
        return None
    try:
        return float(channel[3:-2].replace(",", ".")) * 1e-9
    except ValueError:
        return None


def _exr_channel(wavelength_m: float) -> str:
    return f"S0.{wavelength_m * 1e9:.6f}nm".replace(".", ",").replace(",", ".", 1)


def _exr_order(channels: list[str], description: dict[str, Any], name: str) -> list[str]:
    """Channels in image order: as we recorded it, else R,G,B, else falling wavelength."""
    recorded = description.get("channels")
    if isinstance(recorded, list) and set(map(str, recorded)) == set(channels):
        return [str(channel) for channel in recorded]
    if set(channels) == {"R", "G", "B"}:
        return ["R", "G", "B"]
    if channels == ["Y"]:
        return channels
    wavelengths = {channel: _exr_wavelength_m(channel) for channel in channels}
    if channels and None not in wavelengths.values():
        order = sorted(channels, key=lambda channel: -(wavelengths[channel] or 0.0))
        description["wavelengths_m"] = [wavelengths[channel] for channel in order]
        return order
    raise InputError(f"{name} has channels {', '.join(channels)[:80]}; give R,G,B or Y or S0.<wavelength>nm")


def _check_exr_header(header: dict[str, Any], name: str, max_pixels: int) -> None:
    (x0, y0), (x1, y1) = (corner.tolist() for corner in header["dataWindow"])
    check_pixels(name, (y1 - y0 + 1, x1 - x0 + 1), max_pixels)
    if any(np.any(a != b) for a, b in zip(header["dataWindow"], header["displayWindow"], strict=True)):
        raise InputError(f"{name}: EXR data window differs from its display window; crop it to the image")
    if len(header["channels"]) > MAX_CHANNELS + 1:
        raise InputError(f"{name} has {len(header['channels'])} channels; at most {MAX_CHANNELS} are read")
    if any(channel.xSampling != 1 or channel.ySampling != 1 for channel in header["channels"]):
        raise InputError(f"{name} has subsampled channels; export all channels at full size")


def _read_exr(path: Path, max_pixels: int) -> Decoded:
    openexr = _openexr()
    name = repr(str(path))
    try:
        # The library reports damage on stdout before it raises.
        with contextlib.redirect_stdout(io.StringIO()):
            with openexr.File(str(path), separate_channels=True, header_only=True) as file:
                if len(file.parts) != 1 or file.parts[0].type() not in (openexr.scanlineimage, openexr.tiledimage):
                    raise InputError(f"{name} is a multi-part or deep EXR; export one flat image")
                header = dict(file.header())
                description = own_description(str(header.get("nsfcDescription", "")))
            _check_exr_header(header, name, max_pixels)
            with openexr.File(str(path), separate_channels=True) as file:
                planes = {channel: data.pixels for channel, data in file.channels().items()}
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: EXR cannot be decoded ({reason(error)}); export it again") from error
    notes = []
    lossy = (openexr.B44_COMPRESSION, openexr.B44A_COMPRESSION, openexr.DWAA_COMPRESSION, openexr.DWAB_COMPRESSION)
    if header.get("compression") in (*lossy, openexr.PXR24_COMPRESSION):
        notes.append(f"{name} was compressed with loss; export EXR with ZIP compression")
    alpha = planes.pop("A", None)
    array = np.stack([planes[channel] for channel in _exr_order(sorted(planes), description, name)])
    if array.dtype.kind != "f":
        raise InputError(f"{name} holds {array.dtype}; export half or float channels")
    if alpha is not None:
        array = _without_alpha(np.concatenate([array, alpha[None]]), name, notes)
    return Decoded(array, description, notes)


# --------------------------------------------------------------------------- reading


def _linearised(array: Array, transfer: str | None, full_scale: float | None, name: str) -> tuple[Array, list[str]]:
    if transfer not in (None, "srgb", "linear"):
        raise InputError(f"transfer {transfer!r} is not known; use 'srgb' or 'linear'")
    if transfer == "srgb":
        if full_scale is None:
            raise InputError(f"{name} holds floats, which have no sRGB curve here; leave transfer out")
        x = array.astype(np.float64) / full_scale
        # IEC 61966-2-1
        return full_scale * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4), []
    if transfer is None and full_scale == 255:
        levels = "8 bits leave 256 levels, and the tone curve is unknown: linear was assumed"
        return array, [f"{name}: {levels}; export 16 bits, or say transfer='srgb' or 'linear'"]
    return array, []


def _checked_values(array: Array, name: str) -> npt.NDArray[np.float32]:
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
) -> ImageFile:
    """Read one image with every level it holds.

    Bare arrays (NPY, NPZ, HDF5) may be [H, W], [C, H, W] or [H, W, C]; see
    :func:`channel_axis` for the rule ([3, 512, 3] is three channels of 512 x 3).

    Args:
        path: PNG, TIFF, EXR, NPY, NPZ or HDF5 file; its content tells which.
        page: page of a TIFF with several, from 0.
        dataset: array in HDF5 or NPZ, ``image`` if not given.
        transfer: tone curve of integer data, ``"srgb"`` or ``"linear"``; not given: linear, with a warning at 8 bits.
        max_pixels: largest H * W, checked before decoding.

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
        raise InputError(f"{name} is {format_}, which has no pages; leave page={page} out")
    if dataset is not None and format_ not in ("npz", "hdf5"):
        raise InputError(f"{name} is {format_}, which has no datasets; leave dataset={dataset!r} out")
    try:
        if format_ == "png":
            decoded = _read_png(path, max_pixels)
        elif format_ == "tiff":
            decoded = read_tiff(path, page, max_pixels)
        elif format_ == "exr":
            decoded = _read_exr(path, max_pixels)
        else:
            decoded = read_array(path, format_, dataset or "image", lambda s: check_pixels(name, s, max_pixels))
            decoded.array = _channel_first(decoded.array, name)
    except OSError as error:
        raise InputError(f"{name} could not be read to its end ({reason(error)}); is it still there?") from error
    array = decoded.array
    if array.dtype.kind != "f" and (array.dtype.kind != "u" or array.dtype.itemsize > 2):
        raise InputError(f"{name} holds {array.dtype}; save uint8, uint16, float32 or float64")
    full_scale = float(np.iinfo(array.dtype).max) if array.dtype.kind == "u" else None
    linear, tone_notes = _linearised(array, transfer, full_scale, name)
    values = _checked_values(linear, name)
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


# --------------------------------------------------------------------------- writing


@dataclass(frozen=True)
class _Output:
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


def _write_npy(path: Path, image: _Output) -> None:
    np.save(path, image.array, allow_pickle=False)


def _write_npz(path: Path, image: _Output) -> None:
    extra = {} if image.wavelengths_m is None else {"wavelengths_m": np.array(image.wavelengths_m)}
    np.savez_compressed(path, allow_pickle=False, image=image.array, **extra)


def _write_hdf5(path: Path, image: _Output) -> None:
    import h5py

    # gzip carries a checksum of the values, so damage is found on reading.
    with h5py.File(path, "w") as file:
        data = file.create_dataset("image", data=image.array, compression="gzip", shuffle=True)
        for key, value in json.loads(image.description()).items():
            data.attrs[key] = value


def _write_tiff(path: Path, image: _Output) -> None:
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


def _write_exr(path: Path, image: _Output) -> None:
    openexr = _openexr()
    if image.wavelengths_m is not None:
        channels = [_exr_channel(wavelength) for wavelength in image.wavelengths_m]
    elif len(image.array) in (1, 3):
        channels = ["R", "G", "B"] if len(image.array) == 3 else ["Y"]
    else:
        raise InputError(f"EXR needs a name for each of {len(image.array)} channels; give wavelengths_m")
    header = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "nsfcDescription": image.description(channels=channels),
    }
    planes = np.ascontiguousarray(image.array, dtype=np.float32)
    with openexr.File(header, dict(zip(channels, planes, strict=True))) as file:
        file.write(str(path))


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _write_png(path: Path, image: _Output) -> None:
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


_WRITERS: dict[str, Callable[[Path, _Output], None]] = {
    "png": _write_png,
    "tiff": _write_tiff,
    "exr": _write_exr,
    "npy": _write_npy,
    "npz": _write_npz,
    "hdf5": _write_hdf5,
}


def _checked_output(
    values: npt.ArrayLike, wavelengths_m: Sequence[float] | None, pixel_size_m: float | tuple[float, float] | None
) -> _Output:
    array = np.asarray(values)
    if array.dtype.kind != "f" and array.dtype not in (np.uint8, np.uint16):
        raise InputError(f"images of {array.dtype} are not written; give uint8, uint16 or float32")
    array = array[None] if array.ndim == 2 else array
    if array.ndim != 3 or array.size == 0:
        raise InputError(f"an image of shape {array.shape} is not written; give [channel, row, column]")
    if channel_axis(array.shape) != 0:
        raise InputError(f"shape {array.shape} does not read as [channel, row, column]; move the channels to the front")
    if array.dtype.kind == "f":
        array = _checked_values(array, "the image")
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
    return _Output(array, wavelengths_m, pixel_size_m)


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
    if suffix not in _SUFFIXES:
        raise InputError(f"suffix {suffix!r} of {os.fspath(path)!r} is not known; use one of {', '.join(_SUFFIXES)}")
    image = _checked_output(values, wavelengths_m, pixel_size_m)
    with atomic_path(path) as temporary:
        _WRITERS[_SUFFIXES[suffix]](temporary, image)
