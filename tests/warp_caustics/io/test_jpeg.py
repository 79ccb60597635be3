"""Photos of phones: JPEG only where the tone curve is named, upright, and reported; raw files refused with the way out."""

import struct
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import images as images_module
from warp_caustics.io import read_image

from .image_samples import png, refusal, tiff

pytestmark = pytest.mark.timeout(60)


def letter_f() -> np.ndarray:
    """An F in 48 rows and 36 columns, in blocks that JPEG keeps."""
    image = np.full((48, 36), 20, np.uint8)
    image[4:44, 8:14] = image[4:10, 8:30] = image[22:28, 8:24] = 220
    return image


def jpeg(array: np.ndarray, mode: str | None = None, **options: object) -> bytes:
    stream = BytesIO()
    picture = Image.fromarray(array)
    (picture.convert(mode) if mode else picture).save(stream, "jpeg", quality=98, **options)
    return stream.getvalue()


def mpo() -> bytes:
    stream = BytesIO()
    first, second = Image.fromarray(letter_f()), Image.fromarray(letter_f()[::-1].copy())
    first.save(stream, "mpo", save_all=True, append_images=[second], quality=98)
    return stream.getvalue()


def linear(image: np.ndarray) -> np.ndarray:
    x = image / 255
    return 255 * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_jpeg_needs_its_tone_curve(tmp_path: Path, mode: str) -> None:
    path = tmp_path / "x.jpg"
    path.write_bytes(jpeg(letter_f(), mode))
    for transfer in (None, "linear"):
        refusal(path, InputError, "--transfer srgb", transfer=transfer)
    image = read_image(path, transfer="srgb")
    assert (image.format, image.bit_depth, image.full_scale, len(image.values)) == ("jpeg", 8, 255, len(mode))
    assert np.median(np.abs(image.values - linear(letter_f()))) < 2
    assert any("lossy" in line for line in image.warnings)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_comes_upright(tmp_path: Path, orientation: int) -> None:
    """EXIF: the value tells where row 0 and column 0 of the stored picture lie when it is shown."""
    shown = letter_f()
    stored = {
        1: shown, 2: shown[:, ::-1], 3: shown[::-1, ::-1], 4: shown[::-1], 5: shown.T, 6: np.rot90(shown),
        7: shown[::-1, ::-1].T, 8: np.rot90(shown, -1),
    }[orientation]  # fmt: skip
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "x.jpg"
    path.write_bytes(jpeg(np.ascontiguousarray(stored), exif=exif))
    image = read_image(path, transfer="srgb")
    assert image.values.shape == (1, 48, 36)
    assert np.median(np.abs(image.values[0] - linear(shown))) < 2
    assert any(f"orientation {orientation}" in line for line in image.warnings) == (orientation != 1)


def test_the_first_picture_of_several_is_read(tmp_path: Path) -> None:
    (tmp_path / "x.jpg").write_bytes(mpo())
    image = read_image(tmp_path / "x.jpg", transfer="srgb")
    assert np.median(np.abs(image.values[0] - linear(letter_f()))) < 2
    assert any("2 pictures" in line for line in image.warnings)


def test_a_colour_profile_is_reported(tmp_path: Path) -> None:
    (tmp_path / "x.jpg").write_bytes(jpeg(letter_f(), icc_profile=b"Display P3" + bytes(120)))
    assert any("profile" in line for line in read_image(tmp_path / "x.jpg", transfer="srgb").warnings)


def cfa_inside() -> bytes:
    """A thumbnail whose sub-image is the mosaic of a sensor, as cameras write it."""
    stream = BytesIO()
    with tifffile.TiffWriter(stream) as writer:
        writer.write(np.zeros((8, 8, 3), np.uint8), photometric="rgb", subifds=1, metadata=None)
        writer.write(np.zeros((32, 32), np.uint16), photometric="cfa", metadata=None,
                     extratags=[(33421, 3, 2, (2, 2), True), (33422, 1, 4, b"\0\1\1\2", True)])  # fmt: skip
    return stream.getvalue()


REFUSED = {
    "cmyk": ("x.jpg", lambda: jpeg(letter_f(), "CMYK"), InputError, "CMYK; export gray or RGB"),
    "truncated 50 %": ("x.jpg", lambda: jpeg(letter_f())[: len(jpeg(letter_f())) // 2], DamagedDataError, "cannot"),
    "header only": ("x.jpg", b"\xff\xd8\xff\xe0" + bytes(99), DamagedDataError, "cannot be decoded"),
    "65000 x 65000": (
        "x.jpg",
        lambda: jpeg(letter_f()).replace(struct.pack(">HH", 48, 36), struct.pack(">HH", 65000, 65000), 1),
        InputError,
        "pixels",
    ),
    "png 100k x 100k": ("x.png", png(100_000, 100_000, 16, 2, bytes(1000)), InputError, "at most 6.4e+07 pixels"),
    "dng": ("x.dng", tiff(np.arange(64), t262=32803, t50706=0x0401), InputError, "16-bit linear TIFF"),
    "dng with preview": ("x.dng", tiff(np.arange(64), t50706=0x0401), InputError, "raw camera file"),
    "mosaic inside": ("x.nef", cfa_inside, InputError, "raw camera file"),
    "cr2": ("x.cr2", b"II*\0\x10\0\0\0CR\2\0" + bytes(64), InputError, "raw camera file (CR2)"),
    "raf": ("x.raf", b"FUJIFILMCCD-RAW " + bytes(64), InputError, "raw camera file"),
    "cr3": ("x.cr3", b"\0\0\0\x18ftypcrx " + bytes(64), InputError, "raw camera file"),
    "animated webp": ("x.webp", b"RIFF\x40\0\0\0WEBPVP8X" + bytes(64), InputError, "WebP"),
    "bmp": ("x.bmp", b"BM" + bytes(64), InputError, "BMP"),
    "jpeg 2000": ("x.jp2", b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(64), InputError, "JPEG 2000"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_photos_give_one_line_at_once(tmp_path: Path, case: str) -> None:
    name, content, error, text = REFUSED[case]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content())
    start = time.process_time()  # whatever else the machine does
    refusal(tmp_path / name, error, text, transfer="srgb")
    assert time.process_time() - start < 1


def test_pixels_that_are_not_square_are_reported(tmp_path: Path) -> None:
    wide = png(1, 1, 16, 0, b"\0\1\2", (b"pHYs", struct.pack(">IIB", 2000, 1000, 1)))
    (tmp_path / "x.png").write_bytes(wide)
    assert any("not square" in line for line in read_image(tmp_path / "x.png").warnings)


def test_a_file_that_vanishes_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.png"
    path.write_bytes(png(1, 1, 16, 0, b"\0\1\2"))
    sniff = images_module.sniff_format

    def sniff_and_remove(name: Path) -> tuple[str, list[str]]:
        found = sniff(name)
        path.unlink()
        return found

    monkeypatch.setattr(images_module, "sniff_format", sniff_and_remove)
    refusal(path, InputError, "still there")
