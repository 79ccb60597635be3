"""Damaged files, files of absurd size and wrong paths give one clear line, in all formats."""

import os
import struct
import tempfile
import time
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io import read_image, write_image

from .image_samples import LEVELS, SUFFIXES, npy_header, png, refusal, smooth_rgb, tiff, wrong_crc

pytestmark = pytest.mark.timeout(60)


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
    start = time.process_time()  # decoding would take many seconds of it; how busy the machine is does not count
    refusal(tmp_path / name, InputError, "at most 6.4e+07 pixels")
    assert time.process_time() - start < 1


def test_size_limit_can_be_chosen(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb(64))
    read_image(tmp_path / "x.tif", max_pixels=64 * 64)
    refusal(tmp_path / "x.tif", InputError, "3 x 64 x 64", max_pixels=64 * 64 - 1)


def test_wrong_paths_give_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "file").write_bytes(b"x")
    start = time.process_time()
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
    assert time.process_time() - start < 1


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
