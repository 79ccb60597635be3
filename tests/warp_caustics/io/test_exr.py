"""EXR: channels by name, and a clear line where the optional package is missing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import read_image, write_image

from .image_samples import Refused, check_refused, refusal, smooth_rgb

pytestmark = pytest.mark.timeout(60)
REFUSED: dict[str, Refused] = {
    "exr nonsense": ("x.exr", b"\x76\x2f\x31\x01" + bytes(99), DamagedDataError, "EXR"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    check_refused(tmp_path, REFUSED[case])


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


def test_damage_is_told_in_the_error_alone(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The library's own lines, past Python, would stand beside the one line of the program."""
    pytest.importorskip("OpenEXR")
    write_image(tmp_path / "whole.exr", smooth_rgb())
    content = (tmp_path / "whole.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(content[: len(content) // 2])
    refusal(tmp_path / "cut.exr", DamagedDataError, "chunk")
    assert capfd.readouterr() == ("", "")


def test_exr_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "x.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(99))
    refusal(tmp_path / "x.exr", InputError, "nsfc[exr]")
    with pytest.raises(InputError, match=r"nsfc\[exr\]"):
        write_image(tmp_path / "y.exr", smooth_rgb())
    assert [file.name for file in tmp_path.iterdir()] == ["x.exr"]
