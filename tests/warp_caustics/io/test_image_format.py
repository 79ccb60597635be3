"""The content decides the format, and foreign formats give one clear line."""

from pathlib import Path

import pytest

from warp_caustics.errors import InputError

from .image_samples import Refused, Warned, check_refused, check_warned, png

WARNED: dict[str, Warned] = {
    # name: file name, content, part of the warning, value of the first pixel
    "suffix": ("x.tif", png(1, 1, 16, 0, b"\0\1\2"), "in spite of its suffix", 258),
}
REFUSED: dict[str, Refused] = {
    "zero bytes": ("x.png", b"", InputError, "empty"),
    "text": ("x.png", b"hello,\nworld\n", InputError, "is text"),
    "jpeg": ("x.jpg", b"\xff\xd8\xff\xe0" + bytes(99), InputError, "is JPEG, which holds toned"),
    "gif": ("x.gif", b"GIF89a" + bytes(99), InputError, "palette"),
    "webp": ("x.webp", b"RIFF\0\0\0\0WEBP", InputError, "WebP"),
    "heic": ("x.heic", b"\0\0\0\x18ftypheic", InputError, "HEIC"),
    "noise": ("x.bin", bytes(range(200, 256)), InputError, "none of the known"),
}


@pytest.mark.parametrize("case", WARNED)
def test_oddities_are_read_and_reported(tmp_path: Path, case: str) -> None:
    check_warned(tmp_path, WARNED[case])


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    check_refused(tmp_path, REFUSED[case])
