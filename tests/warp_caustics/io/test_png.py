"""PNG: kinds that hide or lose something are refused, oddities reported."""

import struct
from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import read_image, write_image

from .image_samples import LEVELS, Refused, Warned, check_refused, check_warned, exif, png, smooth_rgb, wrong_crc

pytestmark = pytest.mark.timeout(60)
ONE = b"\0\1\2"


def gray_rows(image: np.ndarray) -> bytes:
    return b"".join(b"\0" + row.astype(">u2").tobytes() for row in image)


def apng() -> bytes:
    return png(1, 1, 16, 0, b"\0\1\2", (b"acTL", struct.pack(">II", 2, 0)))


def test_float_png_records_what_a_count_is(tmp_path: Path) -> None:
    values = smooth_rgb() * 3.7
    write_image(tmp_path / "x.png", values, wavelengths_m=(610e-9, 530e-9, 430e-9), pixel_size_m=(1e-4, 1e-4))
    image = read_image(tmp_path / "x.png")
    assert image.count_W_m2 == pytest.approx(values.max() / 65535)
    assert image.wavelengths_m == (610e-9, 530e-9, 430e-9)
    np.testing.assert_allclose(image.values * image.count_W_m2, values, atol=0.51 * image.count_W_m2)
    with pytest.raises(InputError, match="negative"):
        write_image(tmp_path / "x.png", values - values.min() - 1e-4)


def test_interlaced_png(tmp_path: Path) -> None:
    image = LEVELS[0, 100:109, 7:18] * 3
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    rows = b"".join(gray_rows(image[r::dr, c::dc]) for r, c, dr, dc in passes)
    (tmp_path / "x.png").write_bytes(png(11, 9, 16, 0, rows, interlace=1))
    np.testing.assert_array_equal(read_image(tmp_path / "x.png").values[0], image)


WARNED: dict[str, Warned] = {
    # name: file name, content, part of the warning, value of the first pixel
    "trailing garbage": ("x.png", png(1, 1, 16, 0, b"\0\1\2") + b"junk", "4 bytes after", 258),
    "opaque alpha": ("x.png", png(1, 1, 8, 6, b"\0\5\6\7\xff"), "alpha channel was dropped", 5),
    "tone curve": ("x.png", png(1, 1, 16, 0, b"\0\1\2", (b"sRGB", b"\0")), "tone curve", 258),
    "gamma": ("x.png", png(1, 1, 16, 0, b"\0\1\2", (b"gAMA", struct.pack(">I", 45455))), "tone curve", 258),
}
REFUSED: dict[str, Refused] = {
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
}
for _n in range(2, 9):
    REFUSED[f"png exif {_n}"] = ("x.png", png(1, 1, 16, 0, ONE, (b"eXIf", exif(_n))), InputError, f"orientation {_n}")


@pytest.mark.parametrize("case", WARNED)
def test_oddities_are_read_and_reported(tmp_path: Path, case: str) -> None:
    check_warned(tmp_path, WARNED[case])


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    check_refused(tmp_path, REFUSED[case])
