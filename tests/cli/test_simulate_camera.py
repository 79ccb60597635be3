"""``nsfc simulate --camera``: files of a photo, and the way back through ``nsfc capture``."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from cli.main import main
from cli.photo_job import camera_config
from cli.shipped_files import shipped_cameras
from warp_caustics import CameraConfig, Scene
from warp_caustics.camera.operator import Camera
from warp_caustics.io.images import read_image

NOISE = {"careful": 0.007, "ordinary": np.hypot(0.015, 0.02), "poor": np.hypot(0.03, 0.05)}
"""Of flat light: electrons, as each file says, and speckle."""


def simulate(inputs, output, *options):
    heights = str(inputs / "heights.npy")
    return main(["simulate", heights, "-o", str(output), "--config", "small", "--device", "cpu", *options])


def capture(photo, output, *options):
    known = str(photo.with_name(f"{photo.stem}_capture.yaml"))
    return main(["capture", str(photo), "--capture", known, "-o", str(output), "--config", "small", *options])


def write(folder, **camera):
    path = folder / "camera.yaml"
    path.write_text(yaml.safe_dump(camera), encoding="utf-8")
    return str(path)


def seen_by(camera, inputs):
    """What capture should give: irradiance behind the lens, relative to that of a flat plate; shape [3, 128, 128]."""
    scene = Scene(image_pixels=128, height_samples=32)
    image = torch.from_numpy(read_image(inputs / "image.tif").values).double()
    model = Camera(camera, scene, dtype=torch.float64)
    return (model(image) / model(torch.ones_like(image))).numpy()


@pytest.mark.parametrize("name", NOISE)
def test_each_shipped_camera_and_back(inputs, tmp_path, capsys, name):
    """Irradiance behind the lens comes back to within the noise that the camera's file states."""
    photo = tmp_path / "photo.tif"
    assert simulate(inputs, photo, "--camera", name, "--n-photons", "1e5") == 0
    told = capsys.readouterr()
    words = [line.split()[0] for line in told.out.splitlines()]
    assert words[:4] == ["photo", "dark", "flat", "capture"] and "3 x 128 x 128, 16 bits" in told.out
    image = read_image(photo)
    assert image.bit_depth == 16 and image.values.max() > 0.04 * 65535
    assert capture(photo, tmp_path / "light.npy") == 0
    found = np.load(tmp_path / "light.npy")
    error = (found - seen_by(camera_config(name), inputs))[:, 4:-4, 4:-4]
    # By the median: fresh dust and hot pixels are in a few.
    assert np.median(np.abs(error)) / 0.6745 == pytest.approx(NOISE[name], rel=0.25)
    assert abs(np.median(error)) < 0.2 * NOISE[name]
    assert (np.abs(error) < 6 * NOISE[name]).mean() > 0.98


def test_a_photo_from_the_side_and_back(inputs, tmp_path):
    """The window lies somewhere in a larger frame; capture is told where."""
    corners = [[30, 20], [170, 24], [166, 168], [26, 160]]
    sensor = {"exposure": 0.1, "full_well_electrons": 1e5, "black_level": 0.02, "photo_frames": 16}
    camera = write(tmp_path, psf_px=0.4, frame_px=[200, 190], corners_px=corners, sensor=sensor)
    photo = tmp_path / "photo.tif"
    assert simulate(inputs, photo, "--camera", camera, "--n-photons", "1e5") == 0
    assert read_image(photo).values.shape == (3, 190, 200)
    assert capture(photo, tmp_path / "light.npy") == 0
    found, truth = np.load(tmp_path / "light.npy"), read_image(inputs / "image.tif").values
    error = (found - truth)[:, 3:-3, 3:-3]
    assert np.sqrt(np.mean(error**2)) < 0.1 * truth.std()
    assert np.median(np.abs(error)) < 0.01


def test_the_record_tells_the_camera(inputs, tmp_path, capsys):
    camera = write(tmp_path, ambient=0.02, sensor={"exposure": 0.5})
    assert simulate(inputs, tmp_path / "photo.tif", "--camera", camera, "--json") == 0
    told = capsys.readouterr()
    record = json.loads(told.out)
    assert record["camera"]["ambient"] == 0.02 and record["camera"]["sensor"]["exposure"] == 0.5
    assert set(record["files"]) == {"photo", "dark", "flat", "capture"}
    saturated = np.array(record["saturated_fraction"])
    photo = read_image(tmp_path / "photo.tif").values
    np.testing.assert_allclose(saturated, (photo == 65535).mean(axis=(1, 2)))
    assert "lower sensor.exposure from 0.5" in told.err if saturated.max() > 0.01 else not told.err


def test_the_seed_selects_the_noise(inputs, tmp_path):
    photos = []
    for seed in ("1", "1", "2"):
        assert simulate(inputs, tmp_path / "photo.tif", "--camera", "careful", "--seed", seed, "--force") == 0
        photos.append(read_image(tmp_path / "photo.tif").values)
    assert np.median(np.abs(photos[0] - photos[1])) == 0 and np.median(np.abs(photos[0] - photos[2])) > 0


@pytest.mark.parametrize(
    ("camera", "options", "reason"),
    [
        ({"psf_px": 100.0}, [], "give at most 16"),
        ({"shift_px": [300.0, 0.0]}, [], "sees nothing of the window"),
        ({"sensor": {"exposure": 1e-7}}, [], "sees nothing"),
        ({"sensor": {"exposure": 1.0}, "gain": 5.0}, [], "saturates"),
        ({"sensor": {"dust_radius_px": [4, 1]}}, [], "write [1, 4]"),
        ({"psf": 1.0}, [], "psf: unknown key"),
        ({"mixing": [[1.0, 0.0]]}, [], "one column each"),
        ({}, ["--noise", "0.01"], "exclude each other"),
    ],
)
def test_bad_cameras_end_in_one_line_and_no_file(inputs, tmp_path, capsys, camera, options, reason):
    photo = tmp_path / "out" / "photo.tif"
    photo.parent.mkdir()
    assert simulate(inputs, photo, "--camera", write(tmp_path, **camera), *options) == 3
    told = capsys.readouterr().err.strip()
    assert reason in told and len(told.splitlines()) == 1
    assert not list(photo.parent.iterdir())


def test_bad_names_end_in_one_line(inputs, tmp_path, capsys):
    for output, options, reason in (
        ("photo.tif", ["--camera", "pour"], "did you mean 'poor'"),
        ("photo.tif", ["--camera", "./none.yaml"], "none.yaml"),
        ("photo.npy", ["--camera", "poor"], "use .tif"),
        ("none/photo.tif", ["--camera", "poor"], "create it first"),
    ):
        assert simulate(inputs, tmp_path / output, *options) == 3
        assert reason in capsys.readouterr().err
    (tmp_path / "photo_flat.tif").write_bytes(b"")
    assert simulate(inputs, tmp_path / "photo.tif", "--camera", "poor") == 3
    assert "flat file" in capsys.readouterr().err
    assert simulate(inputs, tmp_path / "photo.tif", "--camera", "poor", "--force") == 0


def test_shipped_cameras_are_three_benches():
    assert set(shipped_cameras()) == {"careful", "ordinary", "poor"}
    psf = [np.mean(camera_config(name).psf_px) for name in ("careful", "ordinary", "poor")]
    assert psf == sorted(psf)


def test_the_camera_of_the_page_is_one():
    """docs/camera.md tells a reader to write it; what it says is what is simulated."""
    page = (Path(__file__).parents[2] / "docs" / "camera.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(# my_camera.yaml\n.*?)^```$", page, re.M | re.S)
    config = CameraConfig.model_validate(yaml.safe_load(text))
    assert config.sensor.exposure == 0.04 and config.frame_px == (900, 820)
    np.testing.assert_allclose(Camera(config, Scene()).corners_px(), config.corners_px, atol=1e-9)
