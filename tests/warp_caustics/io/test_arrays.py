"""NPY, NPZ and HDF5: only real numbers that lie in the file itself are read."""

from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import read_image, write_image

from .image_samples import LEVELS, RGB_LEVELS, Refused, Warned, check_refused, check_warned, npy, npy_header, refusal

pytestmark = pytest.mark.timeout(60)


def zipped(key: str) -> bytes:
    stream = BytesIO()
    np.savez(stream, **{key: np.ones((4, 4), np.float32)})
    return stream.getvalue()


@pytest.mark.parametrize("array", [LEVELS[0].astype(">u2"), np.asfortranarray(RGB_LEVELS), LEVELS[0].astype(float)])
def test_npy_variants(tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "x.npy", array)
    np.testing.assert_array_equal(read_image(tmp_path / "x.npy").values, array.reshape(-1, 256, 256))


WARNED: dict[str, Warned] = {
    # name: file name, content, part of the warning, value of the first pixel
    "half": ("x.npy", npy(np.array([[2, 3]], np.float16)), "16-bit floats", 2),
    "constant": ("x.npy", npy(np.full((4, 4), 7, np.uint16)), "all pixels are 7", 7),
}
REFUSED: dict[str, Refused] = {
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
    "hdf5 nonsense": ("x.h5", b"\x89HDF\r\n\x1a\n" + bytes(99), DamagedDataError, "HDF5"),
}


@pytest.mark.parametrize("case", WARNED)
def test_oddities_are_read_and_reported(tmp_path: Path, case: str) -> None:
    check_warned(tmp_path, WARNED[case])


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_give_one_line(tmp_path: Path, case: str) -> None:
    check_refused(tmp_path, REFUSED[case])


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
