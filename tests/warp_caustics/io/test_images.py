"""Images keep every level and their orientation, and each bad file gives one clear line."""

import os
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io import atomic_path, read_image, write_image
from warp_caustics.io.images import channel_axis

pytestmark = pytest.mark.timeout(60)

LEVELS = np.arange(65536, dtype=np.uint16).reshape(1, 256, 256)
RGB_LEVELS = np.concatenate([LEVELS, LEVELS[:, ::-1], LEVELS.transpose(0, 2, 1)])
SUFFIXES = [".png", ".tif", ".npy", ".npz", ".h5", ".exr"]
FLOAT_SUFFIXES = SUFFIXES[1:]


@pytest.fixture(autouse=True)
def _exr(request: pytest.FixtureRequest) -> None:
    parameters = getattr(request.node, "callspec", None)
    if parameters is not None and ".exr" in str(parameters.params.get("suffix", parameters.params.get("name", ""))):
        pytest.importorskip("OpenEXR")


def letter_f(channels: int) -> np.ndarray:
    """An F in 12 rows and 9 columns, different in each channel: no flip, turn or swap leaves it alone."""
    image = np.zeros((12, 9), np.float32)
    image[1:11, 2] = image[1, 2:8] = image[5, 2:6] = 1
    return image * np.arange(1, channels + 1, dtype=np.float32)[:, None, None]


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


def gray_rows(image: np.ndarray) -> bytes:
    return b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)


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


# ------------------------------------------------------------------ numbers arrive as they are


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("ramp", [LEVELS, RGB_LEVELS], ids=["gray", "rgb"])
def test_all_65536_levels_survive(tmp_path: Path, suffix: str, ramp: np.ndarray) -> None:
    write_image(tmp_path / f"ramp{suffix}", ramp)
    image = read_image(tmp_path / f"ramp{suffix}")
    np.testing.assert_array_equal(image.values, ramp.astype(np.float32))
    assert len(np.unique(image.values[0])) == 65536
    assert image.values.dtype == np.float32
    if suffix != ".exr":
        assert (image.full_scale, image.bit_depth, image.warnings) == (65535, 16, ())


def test_foreign_16_bit_files_keep_all_levels(tmp_path: Path) -> None:
    """Interleaved, planar, big-endian, tiled and BigTIFF files of other programs, and PNG by another encoder."""
    rows_last = np.ascontiguousarray(np.moveaxis(RGB_LEVELS, 0, -1))
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(rows_last))
    tifffile.imwrite(tmp_path / "b.tif", rows_last, photometric="rgb", compression="lzw", predictor=True)
    tifffile.imwrite(tmp_path / "c.tif", rows_last, photometric="rgb", byteorder=">", bigtiff=True, tile=(64, 64))
    tifffile.imwrite(tmp_path / "d.tif", RGB_LEVELS, photometric="rgb", planarconfig="separate")
    for file in sorted(tmp_path.iterdir()):
        np.testing.assert_array_equal(read_image(file).values, RGB_LEVELS, err_msg=file.name)


@pytest.mark.parametrize("suffix", FLOAT_SUFFIXES)
@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_floats_and_wavelengths_are_exact(tmp_path: Path, suffix: str, channels: int) -> None:
    values = np.random.default_rng(1).lognormal(0, 8, (channels, 20, 30)).astype(np.float32)
    values[0, 0, :3] = 0, 1e30, 1e-40  # denormals too
    wavelengths = (610e-9, 430.25e-9, 530e-9, 700e-9, 400e-9)[:channels]
    write_image(tmp_path / f"x{suffix}", values, wavelengths_m=wavelengths, pixel_size_m=1e-4)
    image = read_image(tmp_path / f"x{suffix}")
    np.testing.assert_array_equal(image.values, values)
    assert image.full_scale is None
    assert image.wavelengths_m == (None if suffix == ".npy" else wavelengths)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_nothing_is_flipped(tmp_path: Path, suffix: str, channels: int) -> None:
    """Row 0 is first in the file as other programs see it, and comes back as row 0."""
    path, f = tmp_path / f"f{suffix}", letter_f(channels)
    write_image(path, f)
    image = read_image(path)
    np.testing.assert_allclose(image.values * (image.count_W_m2 or 1.0), f, rtol=1e-4)

    def foreign() -> np.ndarray:
        if suffix == ".png":
            return np.atleast_3d(imagecodecs.png_decode(path.read_bytes())).transpose(2, 0, 1)
        if suffix == ".tif":
            return tifffile.imread(path).reshape(f.shape)
        if suffix == ".h5":
            with h5py.File(path) as file:
                return file["image"][()]
        if suffix == ".exr":
            import OpenEXR

            with OpenEXR.File(str(path), separate_channels=True) as file:
                return np.stack([file.channels()[name].pixels for name in ("RGB" if channels == 3 else "Y")])
        loaded = np.load(path)
        return loaded["image"] if suffix == ".npz" else loaded

    seen = foreign().astype(np.float32)
    np.testing.assert_allclose(seen / seen.max() * channels, f, rtol=1e-4)


def test_float_png_records_what_a_count_is(tmp_path: Path) -> None:
    values = smooth_rgb() * 3.7
    write_image(tmp_path / "x.png", values, wavelengths_m=(610e-9, 530e-9, 430e-9), pixel_size_m=(1e-4, 1e-4))
    image = read_image(tmp_path / "x.png")
    assert image.count_W_m2 == pytest.approx(values.max() / 65535)
    assert image.wavelengths_m == (610e-9, 530e-9, 430e-9)
    np.testing.assert_allclose(image.values * image.count_W_m2, values, atol=0.51 * image.count_W_m2)
    with pytest.raises(InputError, match="negative"):
        write_image(tmp_path / "x.png", values - values.min() - 1e-4)


def test_tiff_has_the_physical_resolution(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb(), pixel_size_m=(0.05 / 512, 0.025 / 512))
    with tifffile.TiffFile(tmp_path / "x.tif") as file:
        x, y = (a / b for a, b in (file.pages[0].tags[tag].value for tag in ("XResolution", "YResolution")))
        assert file.pages[0].tags["ResolutionUnit"].value == 3  # centimetres
    assert (x, y) == (pytest.approx(102.4), pytest.approx(204.8))


def test_interlaced_png(tmp_path: Path) -> None:
    image = LEVELS[0, 100:109, 7:18] * 3
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    rows = b"".join(gray_rows(image[r::dr, c::dc]) for r, c, dr, dc in passes)
    (tmp_path / "x.png").write_bytes(png(11, 9, 16, 0, rows, interlace=1))
    np.testing.assert_array_equal(read_image(tmp_path / "x.png").values[0], image)


def test_srgb_is_undone(tmp_path: Path) -> None:
    linear = np.linspace(0, 1, 4096).reshape(64, 64)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    write_image(tmp_path / "x.tif", np.rint(encoded * 65535).astype(np.uint16))
    image = read_image(tmp_path / "x.tif", transfer="srgb")
    # A code is 1/65535; the curve is at most 2.3 times steeper the other way.
    assert np.abs(image.values[0] / image.full_scale - linear).max() < 1.2 / 65535
    (tmp_path / "8.png").write_bytes(imagecodecs.png_encode(np.array([[0, 188, 255]], np.uint8)))
    eight = read_image(tmp_path / "8.png", transfer="srgb")
    np.testing.assert_allclose(eight.values[0, 0] / 255, [0, 0.50289, 1], atol=1e-4)
    assert eight.warnings == ()
    assert "256 levels" in read_image(tmp_path / "8.png").warnings[0]
    np.testing.assert_array_equal(read_image(tmp_path / "8.png", transfer="linear").values[0, 0], [0, 188, 255])


@pytest.mark.parametrize(
    ("shape", "axis"),
    [((3, 64, 64), 0), ((64, 64, 3), 2), ((3, 512, 3), 0), ((8, 64, 64), 0), ((64, 64, 8), 2), ((60, 60, 60), -1)],
)
def test_which_axis_is_the_channel(tmp_path: Path, shape: tuple[int, int, int], axis: int) -> None:
    assert channel_axis(shape) == axis
    array = np.random.default_rng(2).random(shape, dtype=np.float32)
    np.save(tmp_path / "x.npy", array)
    if axis < 0:
        with pytest.raises(InputError, match="no axis"):
            read_image(tmp_path / "x.npy")
    else:
        np.testing.assert_array_equal(read_image(tmp_path / "x.npy").values, np.moveaxis(array, axis, 0))


@pytest.mark.parametrize("array", [LEVELS[0].astype(">u2"), np.asfortranarray(RGB_LEVELS), LEVELS[0].astype(float)])
def test_npy_variants(tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "x.npy", array)
    np.testing.assert_array_equal(read_image(tmp_path / "x.npy").values, array.reshape(-1, 256, 256))


def test_page_and_dataset_choose(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", RGB_LEVELS, photometric="minisblack")
    np.testing.assert_array_equal(read_image(tmp_path / "x.tif", page=2).values, RGB_LEVELS[2:])
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["a/b"] = LEVELS[0]
    np.testing.assert_array_equal(read_image(tmp_path / "x.h5", dataset="a/b").values, LEVELS)


WARNED: dict[str, tuple[str, bytes, str, float]] = {
    # name: file name, content, part of the warning, value of the first pixel
    "suffix": ("x.tif", png(1, 1, 16, 0, b"\0\1\2"), "in spite of its suffix", 258),
    "trailing garbage": ("x.png", png(1, 1, 16, 0, b"\0\1\2") + b"junk", "4 bytes after", 258),
    "opaque alpha": ("x.png", png(1, 1, 8, 6, b"\0\5\6\7\xff"), "alpha channel was dropped", 5),
    "tone curve": ("x.png", png(1, 1, 16, 0, b"\0\1\2", (b"sRGB", b"\0")), "tone curve", 258),
    "gamma": ("x.png", png(1, 1, 16, 0, b"\0\1\2", (b"gAMA", struct.pack(">I", 45455))), "tone curve", 258),
    "min is white": ("x.tif", tiff(np.full(64, 535), t262=0), "inverted", 65000),
    "12 bits in 16": ("x.tif", tiff(np.minimum(np.arange(64) * 100 + 7, 4095)), "12-bit", 7),
    "half": ("x.npy", npy(np.array([[2, 3]], np.float16)), "16-bit floats", 2),
    "constant": ("x.npy", npy(np.full((4, 4), 7, np.uint16)), "all pixels are 7", 7),
}


@pytest.mark.parametrize("case", WARNED)
def test_oddities_are_read_and_reported(tmp_path: Path, case: str) -> None:
    name, content, text, first = WARNED[case]
    (tmp_path / name).write_bytes(content)
    image = read_image(tmp_path / name)
    assert image.values[0, 0, 0] == first
    assert any(text in line for line in image.warnings), image.warnings
    assert all("\n" not in line for line in image.warnings)


def test_clean_file_has_no_warning(tmp_path: Path) -> None:
    (tmp_path / "x.tif").write_bytes(tiff(np.arange(64)))
    assert read_image(tmp_path / "x.tif").warnings == ()


# ------------------------------------------------------------------ bad files


def apng() -> bytes:
    return png(1, 1, 16, 0, b"\0\1\2", (b"acTL", struct.pack(">II", 2, 0)))


def wrong_crc() -> bytes:
    data = bytearray(png(1, 1, 16, 0, b"\0\1\2"))
    data[-20] ^= 1
    return bytes(data)


def tiff_pages(**options: object) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, RGB_LEVELS, **options)
    return stream.getvalue()


def tiff_values(*values: float) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, np.array([values], np.float32))
    return stream.getvalue()


def jpeg_tiff() -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, np.zeros((16, 16), np.uint8), compression="jpeg")
    return stream.getvalue()


RGBA_CLEAR = np.concatenate([RGB_LEVELS[:, :4, :4], np.full((1, 4, 4), 9, np.uint16)])
ONE = b"\0\1\2"
REFUSED: dict[str, tuple[str, bytes | Callable[[], bytes], type[CausticsError], str]] = {
    "zero bytes": ("x.png", b"", InputError, "empty"),
    "text": ("x.png", b"hello,\nworld\n", InputError, "is text"),
    "jpeg": ("x.jpg", b"\xff\xd8\xff\xe0" + bytes(99), InputError, "JPEG, which is lossy"),
    "gif": ("x.gif", b"GIF89a" + bytes(99), InputError, "palette"),
    "webp": ("x.webp", b"RIFF\0\0\0\0WEBP", InputError, "WebP"),
    "heic": ("x.heic", b"\0\0\0\x18ftypheic", InputError, "HEIC"),
    "noise": ("x.bin", bytes(range(200, 256)), InputError, "none of the known"),
    "png 0x0": ("x.png", png(0, 0, 16, 0, b""), InputError, "is empty"),
    "png palette": ("x.png", png(1, 1, 8, 3, b"\0\0", (b"PLTE", b"abc")), InputError, "palette"),
    "png bilevel": ("x.png", png(1, 1, 1, 0, b"\0\0"), InputError, "1 bit"),
    "png alpha": ("x.png", png(1, 1, 8, 6, b"\0\5\6\7\xfe"), InputError, "transparent"),
    "png gray alpha": ("x.png", png(1, 1, 8, 4, b"\0\5\0"), InputError, "transparent"),
    "png transparent colour": ("x.png", png(1, 1, 16, 0, ONE, (b"tRNS", b"\0\1")), InputError, "transparent"),
    "png animated": ("x.png", apng, InputError, "animated"),
    "png crc": ("x.png", wrong_crc, DamagedDataError, "checksum"),
    "png short data": ("x.png", png(9, 9, 16, 0, ONE), DamagedDataError, "cannot be decoded"),
    "png twice": ("x.png", png(1, 1, 16, 0, ONE) * 2, InputError, "second PNG"),
    "tiff cmyk": ("x.tif", tiff(bytes(16), (2, 2), t258=8, t262=5, t277=4), InputError, "SEPARATED"),
    "tiff palette": ("x.tif", tiff(bytes(64), t258=8, t262=3), InputError, "PALETTE"),
    "tiff ycbcr": ("x.tif", tiff(bytes(12), (2, 2), t258=8, t262=6, t277=3), InputError, "YCBCR"),
    "tiff lab": ("x.tif", tiff(bytes(12), (2, 2), t258=8, t262=8, t277=3), InputError, "CIELAB"),
    "tiff bilevel": ("x.tif", tiff(bytes(8), t258=1), InputError, "bits"),
    "tiff packed 12 bits": ("x.tif", tiff(bytes(96), t258=12), InputError, "12"),
    "tiff signed": ("x.tif", tiff(np.arange(64), t339=2), InputError, "int16"),
    "tiff complex": ("x.tif", tiff(bytes(512), t258=64, t339=6), InputError, "complex64"),
    "tiff uint32": ("x.tif", tiff(bytes(256), t258=32), InputError, "uint32"),
    "tiff jpeg inside": ("x.tif", jpeg_tiff, InputError, "by JPEG"),
    "tiff pages": ("x.tif", lambda: tiff_pages(photometric="minisblack"), InputError, "3 pages"),
    "tiff strip outside": ("x.tif", tiff(np.arange(64), t273=100000), DamagedDataError, "truncated"),
    "tiff strip missing": ("x.tif", tiff(np.arange(64), t273=0, t279=0), DamagedDataError, "truncated"),
    "tiff nan": ("x.tif", tiff_values(1, np.nan), InputError, "NaN or infinite, first at [0, 0, 1]"),
    "tiff inf": ("x.tif", tiff_values(1, 2, -np.inf), InputError, "[0, 0, 2]"),
    "tiff negative": ("x.tif", tiff_values(1, -0.01), InputError, "cannot be negative"),
    "npy object": ("x.npy", lambda: npy(np.array([[None]]), allow_pickle=True), InputError, "object"),
    "npy complex": ("x.npy", lambda: npy(np.ones((2, 2), complex)), InputError, "complex128"),
    "npy bool": ("x.npy", lambda: npy(np.ones((2, 2), bool)), InputError, "bool"),
    "npy int64": ("x.npy", lambda: npy(np.ones((2, 2), int)), InputError, "int64"),
    "npy 0-d": ("x.npy", lambda: npy(np.array(1.0)), InputError, "0 axes"),
    "npy 1-d": ("x.npy", lambda: npy(np.ones(4)), InputError, "1 axes"),
    "npy 5-d": ("x.npy", lambda: npy(np.ones((1, 1, 1, 2, 2))), InputError, "5 axes"),
    "npy no pixels": ("x.npy", lambda: npy(np.ones((0, 4))), InputError, "is empty"),
    "npy float64 beyond float32": ("x.npy", lambda: npy(np.array([[1, 1e300]])), InputError, "infinite"),
    "npy negative size": (
        "x.npy",
        npy_header("{'descr':'<f4','fortran_order':False,'shape':(-4,4)}"),
        InputError,
        "is empty",
    ),
    "npy bad header": ("x.npy", npy_header("{'descr':"), DamagedDataError, "header"),
    "npy records": ("x.npy", b"\x93NUMPY\x03\0" + bytes(64), InputError, "version (3, 0)"),
    "npy longer": ("x.npy", lambda: npy(np.ones((2, 2))) + b"x", DamagedDataError, "foreign bytes"),
    "npz other key": ("x.npz", lambda: zipped("picture"), InputError, "'image' but picture"),
    "exr nonsense": ("x.exr", b"\x76\x2f\x31\x01" + bytes(99), DamagedDataError, "EXR"),
    "hdf5 nonsense": ("x.h5", b"\x89HDF\r\n\x1a\n" + bytes(99), DamagedDataError, "HDF5"),
}
for _n in range(2, 9):
    REFUSED[f"png exif {_n}"] = ("x.png", png(1, 1, 16, 0, ONE, (b"eXIf", exif(_n))), InputError, f"orientation {_n}")
    REFUSED[f"tiff exif {_n}"] = ("x.tif", tiff(np.arange(64), t274=_n), InputError, f"orientation {_n}")


def zipped(key: str) -> bytes:
    stream = BytesIO()
    np.savez(stream, **{key: np.ones((4, 4), np.float32)})
    return stream.getvalue()


def refusal(path: Path, error: type[CausticsError], text: str, **options: object) -> str:
    with pytest.raises(error) as caught:
        read_image(path, **options)
    line = str(caught.value)
    assert type(caught.value) is error
    assert text in line, line
    assert "\n" not in line and len(line) < 500, line
    return line


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    name, content, error, text = REFUSED[case]
    if name.endswith(".exr"):
        pytest.importorskip("OpenEXR")
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content())
    line = refusal(tmp_path / name, error, text)
    assert repr(str(tmp_path / name)) in line


@pytest.mark.parametrize("percent", [10, 50, 99])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_truncated_files_are_damaged(tmp_path: Path, suffix: str, percent: int) -> None:
    path = tmp_path / f"x{suffix}"
    write_image(path, smooth_rgb())
    data = path.read_bytes()
    read_image(path)
    path.write_bytes(data[: len(data) * percent // 100])
    refusal(path, DamagedDataError, repr(str(path)))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npz", ".h5"])
def test_flipped_bits_never_pass(tmp_path: Path, suffix: str) -> None:
    """As we write them these carry checksums over the pixels; NPY and EXR have none."""
    path = tmp_path / f"x{suffix}"
    # Incompressible, so that no compressor's checks help by chance.
    write_image(path, np.random.default_rng(9).integers(0, 65536, (3, 32, 32), dtype=np.uint16))
    good = read_image(path).values
    data = path.read_bytes()
    caught = 0
    for position in range(len(data) // 3, len(data), len(data) // 12):
        path.write_bytes(data[:position] + bytes([data[position] ^ 4]) + data[position + 1 :])
        try:
            np.testing.assert_array_equal(read_image(path).values, good)
        except CausticsError:
            caught += 1
    assert caught >= 4


def bomb_png() -> bytes:
    return png(30000, 30000, 16, 2, bytes(1000))


def bomb_npz() -> bytes:
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        text = "{'descr':'<f8','fortran_order':False,'shape':(30000,30000)}"
        archive.writestr("image.npy", npy_header(text) + bytes(1000))
    return stream.getvalue()


def bomb_hdf5() -> bytes:
    stream = BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("image", (30000, 30000), "f8", chunks=(100, 100))
    return stream.getvalue()


def bomb_exr() -> bytes:
    openexr = pytest.importorskip("OpenEXR")
    with tempfile.TemporaryDirectory() as folder:
        header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
        with openexr.File(header, {"Y": np.ones((4, 4), np.float32)}) as file:
            file.write(f"{folder}/x.exr")
        data = bytearray(Path(f"{folder}/x.exr").read_bytes())
    for key in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        start = data.find(key) + len(key) + 4
        data[start : start + 16] = struct.pack("<4i", 0, 0, 29999, 29999)
    return bytes(data)


BOMBS: dict[str, Callable[[], bytes]] = {
    "x.png": bomb_png,
    "x.tif": lambda: tiff(bytes(1000), (100_000, 100_000), t259=8),
    "x.npy": lambda: npy_header("{'descr':'<f8','fortran_order':False,'shape':(30000,30000)}") + bytes(9),
    "x.npz": bomb_npz,
    "x.h5": bomb_hdf5,
    "x.exr": bomb_exr,
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_by_their_header(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(BOMBS[name]())
    write_image(tmp_path / f"ok{Path(name).suffix}", np.ones((4, 4), np.float32))
    read_image(tmp_path / f"ok{Path(name).suffix}")  # the codec's own import is not what is timed
    start = time.perf_counter()
    refusal(tmp_path / name, InputError, "at most 6.4e+07 pixels")
    assert time.perf_counter() - start < 1


def test_size_limit_can_be_chosen(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb(64))
    read_image(tmp_path / "x.tif", max_pixels=64 * 64)
    refusal(tmp_path / "x.tif", InputError, "3 x 64 x 64", max_pixels=64 * 64 - 1)


def test_wrong_paths_give_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "file").write_bytes(b"x")
    start = time.perf_counter()
    for path, text in {
        tmp_path: "a folder",
        tmp_path / "pipe": "a pipe",
        tmp_path / "zero": "a device",
        tmp_path / "loop": "points at itself",
        tmp_path / "none.png": "does not exist",
        tmp_path / "file" / "x.png": "does not exist",
        tmp_path / ("a" * 300): "too long",
        Path("a\0b"): "null",
    }.items():
        refusal(path, InputError, text)
    with pytest.raises(InputError, match="web address"):
        read_image("https://example.org/x.png")
    assert time.perf_counter() - start < 1


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable_file(tmp_path: Path) -> None:
    write_image(tmp_path / "x.npy", smooth_rgb())
    (tmp_path / "x.npy").chmod(0)
    refusal(tmp_path / "x.npy", InputError, "permissions")


@pytest.mark.parametrize("name", ["a b.png", "a\nb.png", b"\xff\xfe.png".decode("utf-8", "surrogateescape")])
def test_odd_file_names_work(tmp_path: Path, name: str) -> None:
    write_image(tmp_path / name, LEVELS)
    np.testing.assert_array_equal(read_image(tmp_path / name).values, LEVELS)
    (tmp_path / name).write_bytes(wrong_crc())
    refusal(tmp_path / name, DamagedDataError, "checksum")


def test_hdf5_that_points_elsewhere(tmp_path: Path) -> None:
    write_image(tmp_path / "other.h5", LEVELS)
    layout = h5py.VirtualLayout((256, 256), "u2")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "image", (1, 256, 256))[0]
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["link"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/image")
        file["group"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/")
        file["soft"] = h5py.SoftLink("/link")
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (4, 4), "f4", external=[(str(tmp_path / "raw.bin"), 0, 64)])
        file.create_group("image")
    for dataset, text in {
        "link": "link to another",
        "group/image": "link to another",
        "soft": "link to another",
        "virtual": "other files",
        "raw": "other files",
        "image": "is a group",
        "nothing": "no dataset",
    }.items():
        refusal(tmp_path / "x.h5", InputError, text, dataset=dataset)


def test_wrong_arguments(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb())
    write_image(tmp_path / "x.npy", smooth_rgb())
    refusal(tmp_path / "x.tif", InputError, "no page 1", page=1)
    refusal(tmp_path / "x.tif", InputError, "no datasets", dataset="image")
    refusal(tmp_path / "x.npy", InputError, "no pages", page=0)
    refusal(tmp_path / "x.npy", InputError, "no sRGB curve", transfer="srgb")
    refusal(tmp_path / "x.npy", InputError, "'gamma'", transfer="gamma")


def test_exr_channels(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)

    def write(channels: dict[str, np.ndarray], **header: object) -> Path:
        base = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
        with openexr.File(base | header, channels) as file:
            file.write(str(tmp_path / "x.exr"))
        return tmp_path / "x.exr"

    spectral = {"S0.430,000000nm": plane, "S0.610,000000nm": plane + 1}
    image = read_image(write(spectral))
    assert image.wavelengths_m == pytest.approx((610e-9, 430e-9))
    np.testing.assert_array_equal(image.values, [plane + 1, plane])
    ones = np.ones_like(plane)
    np.testing.assert_array_equal(read_image(write({"Y": plane, "A": ones})).values, plane[None])
    half = read_image(write({"Y": plane.astype(np.float16)}))
    assert half.bit_depth == 16 and "3 digits" in half.warnings[0]
    infinite = np.where(plane == 3, np.inf, plane).astype(np.float16)
    refusal(write({"Y": infinite}), InputError, "[0, 0, 3]")
    refusal(write({"Y": plane, "A": plane}), InputError, "transparent")
    refusal(write({"X": plane, "Z": plane}), InputError, "channels X, Z")
    refusal(write({"Y": plane.astype(np.uint32)}), InputError, "uint32")
    window = (np.array([0, 0], np.int32), np.array([7, 7], np.int32))
    refusal(write({"Y": plane}, displayWindow=window), InputError, "display window")


def test_exr_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "x.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(99))
    refusal(tmp_path / "x.exr", InputError, "nsfc[exr]")
    with pytest.raises(InputError, match=r"nsfc\[exr\]"):
        write_image(tmp_path / "y.exr", smooth_rgb())
    assert [file.name for file in tmp_path.iterdir()] == ["x.exr"]


# ------------------------------------------------------------------ writing


@pytest.mark.parametrize(
    ("name", "values", "options", "text"),
    [
        ("x.jpg", np.ones((4, 4)), {}, "use one of .png"),
        ("x", np.ones((4, 4)), {}, "suffix ''"),
        ("x.tif", np.ones((4, 4), complex), {}, "complex128"),
        ("x.tif", np.ones((4, 4), bool), {}, "bool"),
        ("x.tif", np.ones(4), {}, "shape (4,)"),
        ("x.tif", np.ones((64, 64, 3)), {}, "to the front"),
        ("x.tif", np.array([[1, np.nan]]), {}, "NaN"),
        ("x.png", np.ones((2, 4, 4)), {}, "1 or 3 channels"),
        ("x.exr", np.ones((5, 9, 9)), {}, "give wavelengths_m"),
        ("x.tif", np.ones((2, 4, 4)), {"wavelengths_m": [530e-9]}, "one each"),
        ("x.tif", np.ones((1, 4, 4)), {"wavelengths_m": [530]}, "not metres"),
        ("x.tif", np.ones((1, 4, 4)), {"pixel_size_m": 97.6}, "give metres"),
        ("no/x.tif", np.ones((1, 4, 4)), {}, "does not exist"),
    ],
)
def test_unwritable_images(tmp_path: Path, name: str, values: np.ndarray, options: dict, text: str) -> None:
    if name.endswith("exr"):
        pytest.importorskip("OpenEXR")
    with pytest.raises(InputError) as caught:
        write_image(tmp_path / name, values, **options)
    assert text in str(caught.value) and "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_failing_writer_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(tmp_path / "x.tif", LEVELS)
    before = (tmp_path / "x.tif").read_bytes()

    def fail(path: Path, *_: object, **__: object) -> None:
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(tifffile, "imwrite", fail)
    for name in ("x.tif", "y.tif"):
        with pytest.raises(KeyboardInterrupt):
            write_image(tmp_path / name, LEVELS)
    assert [file.name for file in tmp_path.iterdir()] == ["x.tif"]
    assert (tmp_path / "x.tif").read_bytes() == before


def test_atomic_path_replaces_only_files(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, text in (("folder", "a folder"), ("pipe", "a pipe")):
        with pytest.raises(InputError, match=text), atomic_path(tmp_path / name):
            pytest.fail("the block must not run")
    (tmp_path / "target.npy").write_bytes(b"old")
    (tmp_path / "link.npy").symlink_to("target.npy")
    with atomic_path(tmp_path / "link.npy") as temporary:
        assert temporary.parent == tmp_path and temporary.suffix == ".npy"
        temporary.write_bytes(b"new")
        assert (tmp_path / "target.npy").read_bytes() == b"old"
    assert (tmp_path / "target.npy").read_bytes() == b"new" and (tmp_path / "link.npy").is_symlink()


def test_import_loads_no_codec() -> None:
    code = "import sys, warp_caustics.io; print(sorted({'tifffile','imagecodecs','h5py','trimesh','scipy','OpenEXR',"
    code += "'warp','torch'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
