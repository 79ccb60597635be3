"""TIFF: kinds that hide or lose something are refused, oddities reported."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import tifffile

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import read_image, write_image

from .image_samples import RGB_LEVELS, Refused, Warned, check_refused, check_warned, smooth_rgb, tiff

pytestmark = pytest.mark.timeout(60)


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


def test_tiff_has_the_physical_resolution(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb(), pixel_size_m=(0.05 / 512, 0.025 / 512))
    with tifffile.TiffFile(tmp_path / "x.tif") as file:
        x, y = (a / b for a, b in (file.pages[0].tags[tag].value for tag in ("XResolution", "YResolution")))
        assert file.pages[0].tags["ResolutionUnit"].value == 3  # centimetres
    assert (x, y) == (pytest.approx(102.4), pytest.approx(204.8))


WARNED: dict[str, Warned] = {
    # name: file name, content, part of the warning, value of the first pixel
    "min is white": ("x.tif", tiff(np.full(64, 535), t262=0), "inverted", 65000),
    "12 bits in 16": ("x.tif", tiff(np.minimum(np.arange(64) * 100 + 7, 4095)), "12-bit", 7),
}
REFUSED: dict[str, Refused] = {
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
}
for _n in range(2, 9):
    REFUSED[f"tiff exif {_n}"] = ("x.tif", tiff(np.arange(64), t274=_n), InputError, f"orientation {_n}")


@pytest.mark.parametrize("case", WARNED)
def test_oddities_are_read_and_reported(tmp_path: Path, case: str) -> None:
    check_warned(tmp_path, WARNED[case])


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    check_refused(tmp_path, REFUSED[case])


def test_clean_file_has_no_warning(tmp_path: Path) -> None:
    (tmp_path / "x.tif").write_bytes(tiff(np.arange(64)))
    assert read_image(tmp_path / "x.tif").warnings == ()
