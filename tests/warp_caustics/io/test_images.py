"""Images keep every level and their orientation in all formats, and wrong arguments give one clear line."""

import subprocess
import sys
from pathlib import Path

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile

from warp_caustics.errors import InputError
from warp_caustics.io import read_image, write_image

from .image_samples import LEVELS, RGB_LEVELS, SUFFIXES, refusal, smooth_rgb

pytestmark = pytest.mark.timeout(60)
FLOAT_SUFFIXES = SUFFIXES[1:]


def letter_f(channels: int) -> np.ndarray:
    """An F in 12 rows and 9 columns, different in each channel: no flip, turn or swap leaves it alone."""
    image = np.zeros((12, 9), np.float32)
    image[1:11, 2] = image[1, 2:8] = image[5, 2:6] = 1
    return image * np.arange(1, channels + 1, dtype=np.float32)[:, None, None]


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


def test_page_and_dataset_choose(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", RGB_LEVELS, photometric="minisblack")
    np.testing.assert_array_equal(read_image(tmp_path / "x.tif", page=2).values, RGB_LEVELS[2:])
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["a/b"] = LEVELS[0]
    np.testing.assert_array_equal(read_image(tmp_path / "x.h5", dataset="a/b").values, LEVELS)


def test_wrong_arguments(tmp_path: Path) -> None:
    write_image(tmp_path / "x.tif", smooth_rgb())
    write_image(tmp_path / "x.npy", smooth_rgb())
    refusal(tmp_path / "x.tif", InputError, "no page 1", page=1)
    refusal(tmp_path / "x.tif", InputError, "no datasets", dataset="image")
    refusal(tmp_path / "x.npy", InputError, "no pages", page=0)
    refusal(tmp_path / "x.npy", InputError, "no sRGB curve", transfer="srgb")
    refusal(tmp_path / "x.npy", InputError, "'gamma'", transfer="gamma")


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


def test_import_loads_no_codec() -> None:
    code = "import sys, warp_caustics.io; print(sorted({'tifffile','imagecodecs','h5py','trimesh','scipy','OpenEXR',"
    code += "'warp','torch'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
