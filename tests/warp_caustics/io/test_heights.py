"""Height maps keep metres, precision and orientation; everything else is refused in one line."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io import read_heights, write_heights, write_image

SUFFIXES = [".npy", ".npz", ".tif", ".h5"]


def ridge(n: int = 16) -> np.ndarray:
    """Up to 2 mm, different along rows and columns."""
    row, column = np.mgrid[:n, :n] / n
    return 2e-3 * row**2 * (1 - 0.3 * column) + 1e-5 * np.random.default_rng(3).random((n, n))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_heights_come_back(tmp_path: Path, suffix: str) -> None:
    heights = ridge()
    write_heights(tmp_path / f"h{suffix}", heights)
    back = read_heights(tmp_path / f"h{suffix}")
    assert back.dtype == np.float64
    if suffix == ".tif":
        # float32 steps by 2^-24 relative: below 0.2 nm at 2 mm.
        assert np.abs(back - heights).max() < 2e-10
        np.testing.assert_array_equal(back, heights.astype(np.float32))
    else:
        np.testing.assert_array_equal(back, heights)


def test_other_programs_see_metres_in_row_order(tmp_path: Path) -> None:
    heights = ridge()
    for suffix in SUFFIXES:
        write_heights(tmp_path / f"h{suffix}", heights)
    np.testing.assert_array_equal(np.load(tmp_path / "h.npy"), heights)
    np.testing.assert_array_equal(np.load(tmp_path / "h.npz")["heights_m"], heights)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "h.tif"), heights.astype(np.float32))
    with tifffile.TiffFile(tmp_path / "h.tif") as file:
        assert '"units": "m"' in file.pages[0].description
    with h5py.File(tmp_path / "h.h5") as file:
        np.testing.assert_array_equal(file["heights_m"][()], heights)
        assert file["heights_m"].attrs["units"] == "m"


@pytest.mark.parametrize("dtype", ["<f4", ">f8"])
def test_plain_arrays_of_other_programs(tmp_path: Path, dtype: str) -> None:
    heights = np.asfortranarray(ridge().astype(dtype))
    np.save(tmp_path / "h.npy", heights)
    tifffile.imwrite(tmp_path / "h.tif", heights)
    for name in ("h.npy", "h.tif"):
        np.testing.assert_array_equal(read_heights(tmp_path / name), heights)


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".h5"])
def test_several_maps(tmp_path: Path, suffix: str) -> None:
    maps = np.stack([ridge(), -ridge(), 2 * ridge()])
    write_heights(tmp_path / f"h{suffix}", maps)
    np.testing.assert_array_equal(read_heights(tmp_path / f"h{suffix}", batch=True), maps)
    with pytest.raises(InputError, match="batch=True"):
        read_heights(tmp_path / f"h{suffix}")


def test_dataset_is_chosen(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "h.h5", "w") as file:
        file["plates/a"] = ridge()
    np.testing.assert_array_equal(read_heights(tmp_path / "h.h5", dataset="plates/a"), ridge())
    with pytest.raises(InputError, match="no dataset 'heights_m' but plates"):
        read_heights(tmp_path / "h.h5")


def npy(array: object) -> Callable[[Path], None]:
    return lambda path: np.save(path, np.asarray(array), allow_pickle=True)


def with_bad(value: float) -> np.ndarray:
    heights = ridge()
    heights[2, 5] = value
    return heights


def unit_mm(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["heights_m"] = ridge()
        file["heights_m"].attrs["units"] = "mm"


def cut_short(path: Path) -> None:
    stream = BytesIO()
    np.save(stream, ridge())
    path.write_bytes(stream.getvalue()[:1000])


BAD: dict[str, tuple[str, Callable[[Path], None], type[CausticsError], str]] = {
    "nan": ("h.npy", npy(with_bad(np.nan)), InputError, "first nan at [2, 5]"),
    "inf": ("h.npy", npy(with_bad(-np.inf)), InputError, "first -inf at [2, 5]"),
    "not square": ("h.npy", npy(np.zeros((4, 5))), InputError, "shape (4, 5)"),
    "one axis": ("h.npy", npy(np.zeros(4)), InputError, "shape (4,)"),
    "empty": ("h.npy", npy(np.zeros((0, 0))), InputError, "at least 2 x 2"),
    "one sample": ("h.npy", npy(np.zeros((1, 1))), InputError, "at least 2 x 2"),
    "millimetres": ("h.npy", npy(ridge() * 1e3), InputError, "mm? multiply by 0.001"),
    "micrometres": ("h.npy", npy(ridge() * 1e6), InputError, "um? multiply by 1e-06"),
    "nanometres": ("h.npy", npy(-ridge() * 1e9), InputError, "nm? multiply by 1e-09"),
    "half floats": ("h.npy", npy(ridge().astype(np.float16)), InputError, "step by 2 um"),
    "integers": ("h.npy", npy(np.zeros((4, 4), np.uint16)), InputError, "uint16"),
    "complex": ("h.npy", npy(np.zeros((4, 4), complex)), InputError, "complex128"),
    "bool": ("h.npy", npy(np.zeros((4, 4), bool)), InputError, "bool"),
    "objects": ("h.npy", npy([[None]]), InputError, "object"),
    "other unit": ("h.h5", unit_mm, InputError, "unit 'mm'"),
    "truncated": ("h.npy", cut_short, DamagedDataError, "truncated"),
    "picture": ("h.png", lambda path: write_image(path, np.eye(4)), InputError, "holds pictures"),
    "an image in TIFF": ("h.tif", lambda path: write_image(path, np.eye(4)), InputError, "unit 'W/m^2'"),
    "rgb": ("h.tif", lambda path: write_image(path, np.ones((3, 8, 8))), InputError, "3 channels"),
    "missing": ("h.npy", lambda path: None, InputError, "does not exist"),
    "folder": ("h.npy", lambda path: path.mkdir(), InputError, "a folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_heights_give_one_line(tmp_path: Path, case: str) -> None:
    name, make, error, text = BAD[case]
    make(tmp_path / name)
    with pytest.raises(error) as caught:
        read_heights(tmp_path / name)
    line = str(caught.value)
    assert text in line and name in line and "\n" not in line, line


@pytest.mark.parametrize(
    ("name", "heights", "text"),
    [
        ("h.stl", ridge(), "use one of .npy"),
        ("h.npy", ridge() * 1e3, "mm?"),
        ("h.npy", with_bad(np.nan), "[2, 5]"),
        ("h.npy", np.zeros((4, 4), int), "int64"),
        ("h.npy", np.zeros((4, 5)), "(4, 5)"),
        ("h.tif", np.zeros((2, 4, 4)), "one height map, not 2"),
        ("no/h.npy", ridge(), "does not exist"),
    ],
)
def test_unwritable_heights(tmp_path: Path, name: str, heights: np.ndarray, text: str) -> None:
    with pytest.raises(InputError) as caught:
        write_heights(tmp_path / name, heights)
    assert text in str(caught.value) and "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_failing_writer_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_heights(tmp_path / "h.npy", ridge())

    def fail(path: Path, *_: object, **__: object) -> None:
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", fail)
    with pytest.raises(CausticsError, match="free space") as caught:
        write_heights(tmp_path / "h.npy", 2 * ridge())
    assert caught.value.exit_code == 6
    monkeypatch.undo()
    assert [file.name for file in tmp_path.iterdir()] == ["h.npy"]
    np.testing.assert_array_equal(read_heights(tmp_path / "h.npy"), ridge())
