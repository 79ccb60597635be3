"""``nsfc capture`` and the capture options that every command shares."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from warp_caustics.capture.read import read_capture
from warp_caustics.capture.settings import capture_settings
from warp_caustics.errors import InputError
from warp_caustics.io.images import read_image, write_image
from warp_caustics.scene import Scene

M = 48
SMALL = ("--config", "small", "--set", f"scene.image_pixels={M}")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Folder with photo.tif, flat.tif and dark.tif: a window of twice as many pixels, upright, in a dark surround."""
    folder = tmp_path_factory.mktemp("frames")
    random = np.random.default_rng(0)
    row, column = np.mgrid[:M, :M] / M
    light = np.stack([1 + 0.5 * np.sin(7 * row + k) * np.cos(6 * column) for k in range(3)])
    np.save(folder / "light.npy", light)
    inside = np.zeros((3, 160, 180))
    lit = inside.copy()
    lit[:, 30:126, 40:136] = 1
    inside[:, 30:126, 40:136] = np.repeat(np.repeat(light, 2, axis=1), 2, axis=2)
    for name, seen in (("photo", inside), ("flat", lit), ("dark", 0 * lit)):
        counts = 8000 * seen + 200 + random.normal(0, 5, lit.shape)
        write_image(folder / f"{name}.tif", np.rint(counts).astype(np.uint16))
    for name, time in (("short", 0.5), ("long", 4.0)):
        counts = np.minimum(8000 * time * inside + 200 + random.normal(0, 5, lit.shape), 65535)
        write_image(folder / f"{name}.tif", np.rint(counts).astype(np.uint16))
    (folder / "corners.csv").write_text(
        "corner,x_px,y_px\n-x-y,39.5,29.5\n+x-y,135.5,29.5\n+x+y,135.5,125.5\n-x+y,39.5,125.5\n"
    )
    return folder


def capture(*arguments):
    return main(["capture", *map(str, arguments), *SMALL])


@pytest.mark.parametrize("corners", ["auto", "corners.csv"])
def test_photo_to_irradiance(full_figures, frames, tmp_path, capsys, monkeypatch, corners):
    monkeypatch.chdir(frames)
    options = "--dark", "dark.tif", "--flat", "flat.tif", "--corners", corners
    out, steps, mask = (tmp_path / name for name in ("out.tif", "steps.png", "mask.png"))
    assert capture("photo.tif", *options, "-o", out, "--stages", steps, "--mask", mask, "--json") == 0
    image = read_image(out)
    light = np.load(frames / "light.npy")
    assert np.sqrt(np.mean((image.values - light) ** 2)) < 0.02
    assert image.wavelengths_m == Scene().wavelengths_m
    assert steps.read_bytes().startswith(b"\x89PNG")
    assert (read_image(mask, transfer="linear").values == 255).mean() > 0.99
    record = json.loads(capsys.readouterr().out)
    assert set(record["inputs"]) == {"image", "dark", "flat"} | ({"corners"} if corners != "auto" else set())
    assert record["figures"]["window"]["scale_min"] == pytest.approx(2, abs=0.01)
    assert max(record["noise_std_W_m2"]) < 0.002


def test_reconstruct_sees_the_same(frames):
    """The command's image is what read_capture hands to a reconstruction."""
    options = {"dark": str(frames / "dark.tif"), "flat": str(frames / "flat.tif"), "corners": "auto"}
    found = read_capture(str(frames / "photo.tif"), Scene(image_pixels=M), capture_settings(options))
    assert found.noise_std.max() < 0.002 and found.mask.mean() > 0.99
    assert [stage.name for stage in found.stages][-1] == "window"


def test_exposures_are_merged(frames, tmp_path):
    """As options, and as a capture file whose paths are relative to its folder."""
    flat = ["--dark", frames / "dark.tif", "--flat", frames / "flat.tif", "--corners", frames / "corners.csv"]
    common = tmp_path / "common.yaml"
    common.write_text("flat_exposure_s: 1.0\n")
    photos = frames / "short.tif", frames / "long.tif"
    arguments = *photos, "--exposure-times", "0.5,4", "--capture", common, *flat
    assert capture(*arguments, "-o", tmp_path / "a.npy") == 0
    plate = frames / "plate.yaml"
    plate.write_text(
        "frames: [{file: short.tif, exposure_s: 0.5}, {file: long.tif, exposure_s: 4}]\n"
        "dark: dark.tif\nflat: flat.tif\nflat_exposure_s: 1\ncorners: corners.csv\n"
    )
    assert capture(plate, "-o", tmp_path / "b.npy") == 0
    light = np.load(frames / "light.npy")
    merged = np.load(tmp_path / "a.npy")
    np.testing.assert_array_equal(merged, np.load(tmp_path / "b.npy"))
    assert np.sqrt(np.mean((merged - light) ** 2)) < 0.02


def test_options_win_over_the_capture_file(frames, tmp_path):
    (tmp_path / "c.yaml").write_text(f"dark: {frames}/dark.tif\ntransfer: srgb\npage: 3\n")
    settings = capture_settings({"capture": str(tmp_path / "c.yaml"), "transfer": "linear"})
    assert (settings.transfer, settings.page, settings.dark) == ("linear", 3, f"{frames}/dark.tif")
    (tmp_path / "plate.yaml").write_text("page: 1\ntransfer: srgb\n")
    settings = capture_settings(
        {"capture": str(tmp_path / "c.yaml"), "transfer": "linear"}, str(tmp_path / "plate.yaml")
    )
    assert (settings.transfer, settings.page) == ("linear", 1)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("darkk: x.tif", "darkk: unknown key"),
        ("transfer: gamma", "transfer"),
        ("distortion: lens.yaml", "distortion needs corners"),
        ("frames: [{file: a.tif, exposure_s: 1}]", "one frame"),
        ("frames: [{file: a.tif, exposure_s: 0}, {file: b.tif, exposure_s: 1}]", "greater than 0"),
        ("flat_exposure_s: 1", "is for frames"),
        ("exposure: .nan", "exposure"),
        ("turned_deg: 45", "turned_deg"),
        ("[1, 2]", "no keys"),
        ("dark: [a", "line|expected"),
    ],
)
def test_bad_capture_files_are_one_line(frames, tmp_path, capsys, text, problem):
    import re

    (tmp_path / "c.yaml").write_text(text)
    assert capture(frames / "photo.tif", "--capture", tmp_path / "c.yaml", "-o", tmp_path / "x.tif") == 3
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line]
    assert line.startswith("error: ") and re.search(problem, line)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.yaml"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["photo.tif", "flat.tif", "-o", "{out}/x.tif"], "give --exposure-times"),
        (["photo.tif", "flat.tif", "--exposure-times", "1", "-o", "{out}/x.tif"], "1 exposure times for 2 photos"),
        (["photo.tif", "-o", "photo.tif"], "is the image"),
        (["photo.tif", "--flat", "flat.tif", "-o", "flat.tif"], "is the flat"),
        (["photo.tif", "-o", "{out}/x.tif", "--mask", "{out}/x.tif"], "is --output"),
        (["photo.tif", "-o", "{out}/x.jpg"], "suffix"),
        (["photo.tif", "-o", "{out}/no/x.tif"], "does not exist"),
        (["photo.tif", "-o", "{out}/x.tif", "--stages", "{out}/x.txt"], "suffix"),
        (["photo.tif", "-o", "{out}/x.tif"], "or give its corners"),
        (["photo.tif", "-o", "{out}/x.tif", "--corners", "none.yaml"], "does not exist"),
        (["dark.tif", "-o", "{out}/x.tif", "--corners", "auto"], "give the four corners"),
    ],
)
def test_wrong_calls_write_nothing(frames, tmp_path, capsys, monkeypatch, arguments, problem):
    monkeypatch.chdir(frames)
    before = {path: path.read_bytes() for path in frames.iterdir()}
    assert capture(*(argument.format(out=tmp_path) for argument in arguments)) in (3, 5)
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1 and problem in errors[0]
    assert list(tmp_path.iterdir()) == []
    assert {path: path.read_bytes() for path in frames.iterdir()} == before


def test_a_capture_file_without_frames(tmp_path):
    (tmp_path / "c.yaml").write_text("page: 1\n")
    with pytest.raises(InputError, match="lists no frames"):
        read_capture(str(tmp_path / "c.yaml"), Scene(), capture_settings({}, str(tmp_path / "c.yaml")))
    assert Path(tmp_path / "c.yaml").exists()
