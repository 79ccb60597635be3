"""Photos with their dark and flat frames, and the way back: what capture makes of them is what the camera was shown."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, InputError, Scene
from warp_caustics.camera.config import CameraConfig, SensorConfig
from warp_caustics.camera.files import photograph_files, write_photographs
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import photographs
from warp_caustics.capture.read import read_capture
from warp_caustics.capture.settings import capture_settings
from warp_caustics.io.images import read_image
from warp_caustics.prints.line import Line, line_relief

M = 96
SCENE = Scene(image_pixels=M, height_samples=48)
LINES = [
    Line((-0.021, -0.017), (0.019, -0.006), 4e-3, 3.5e-4),
    Line((-0.019, 0.014), (0.021, 0.003), 5e-3, 4e-4),
    Line((-0.006, -0.022), (-0.011, 0.021), 4e-3, 2.5e-4),
]
CLEAN = SensorConfig(exposure=0.1, calibration_frames=1)
NOISY = SensorConfig(
    exposure=0.1, full_well_electrons=20_000, read_noise_electrons=5, black_level=0.02, bits=14, calibration_frames=64
)
BENT = CameraConfig(
    psf_px=0.5,
    frame_px=(190, 180),
    corners_px=((25, 20), (160, 24), (156, 158), (22, 150)),
    light=(0.05, 0.03, -0.05, 0.0, -0.04),
    sensor=CLEAN,
)


@pytest.fixture(scope="module")
def caustic():
    """Irradiance of three lines, up to five times as bright as flat light, float64, shape [3, M, M]."""
    relief = torch.tensor(line_relief(LINES, 48, SCENE.plate_size_m))
    return CausticSimulator(SCENE)(relief.float()).double()


FLAT = torch.ones(3, M, M, dtype=torch.float64)


def taken(config, image, seed=0, scene=SCENE):
    camera = Camera(config, scene, dtype=torch.float64)
    return camera, photographs(camera, image, FLAT, seed)


def captured(folder, camera, frames, scene=SCENE, **more):
    files = photograph_files(folder / "photo.tif", camera)
    write_photographs(files, frames, camera)
    settings = capture_settings({"capture": str(files["capture"]), **more}, str(files["photo"]))
    return read_capture(files["photo"], scene, settings)


# --------------------------------------------------------------------- frames


def test_a_perfect_camera_counts_light(caustic):
    _, frames = taken(CameraConfig(sensor=CLEAN), caustic)
    assert all(frame.dtype == np.uint16 and frame.shape == (3, M, M) for frame in frames[:3])
    assert (frames.flat == round(0.1 * 65535)).all() and not frames.dark.any()
    np.testing.assert_allclose(frames.photo, np.minimum(0.1 * caustic.numpy(), 1) * 65535, atol=0.51)


def test_the_same_seed_takes_the_same_photo(caustic):
    config = CameraConfig(sensor=NOISY.model_copy(update={"speckle_contrast": 0.05, "dust_grains": 5, "hot_pixels": 9}))
    first, again, other = (taken(config, caustic, seed)[1] for seed in (1, 1, 2))
    for kind in ("photo", "dark", "flat"):
        assert (getattr(first, kind) == getattr(again, kind)).all()
        assert (getattr(first, kind) != getattr(other, kind)).any()


def test_one_effect_off_leaves_the_others_as_they_were(caustic):
    sensor = CLEAN.model_copy(update={"dust_grains": 5, "speckle_contrast": 0.1, "hot_pixels": 9})
    with_all = taken(CameraConfig(sensor=sensor), caustic)[1]
    without = taken(CameraConfig(sensor=sensor.model_copy(update={"speckle_contrast": 0.0})), caustic)[1]
    assert (with_all.dark == without.dark).all(), "hot pixels"
    quiet = taken(CameraConfig(sensor=sensor.model_copy(update={"dust_grains": 0})), caustic)[1]
    ratio = with_all.photo / np.maximum(quiet.photo, 1)
    still = taken(CameraConfig(sensor=CLEAN.model_copy(update={"dust_grains": 5, "hot_pixels": 9})), caustic)[1]
    alone = still.photo / np.maximum(
        taken(CameraConfig(sensor=CLEAN.model_copy(update={"hot_pixels": 9})), caustic)[1].photo, 1
    )
    cold = quiet.dark == 0
    np.testing.assert_allclose(ratio[cold], alone[cold], atol=0.02)


def test_dust_and_hot_pixels_are_the_cameras_own(caustic):
    """They are in photo and flat frame at the same places; fresh dust is in the photo alone."""
    sensor = CLEAN.model_copy(update={"dust_grains": 8, "hot_pixels": 20, "hot_level": (0.2, 0.3)})
    frames = taken(CameraConfig(sensor=sensor), FLAT)[1]
    assert (frames.photo == frames.flat).all()
    hot = frames.dark > 0
    assert hot.sum() == 20 and (frames.photo[hot] > 0.2 * 65535).all()
    fresh = taken(CameraConfig(sensor=CLEAN.model_copy(update={"fresh_dust_grains": 8})), FLAT)[1]
    assert (fresh.flat == fresh.flat[0, 0, 0]).all() and fresh.photo.min() < 0.95 * fresh.flat.min()


def test_ambient_light_is_the_lamps_or_the_rooms():
    lamp, room = (
        taken(CameraConfig(ambient=0.1, ambient_in_dark=stays, sensor=CLEAN), FLAT)[1] for stays in (False, True)
    )
    assert not lamp.dark.any() and (room.dark == round(0.01 * 65535)).all()
    assert (lamp.flat == room.flat).all() and lamp.flat[0, 0, 0] == round(0.11 * 65535)


def test_the_brightest_wavelength_sets_the_exposure():
    scene = SCENE.model_copy(update={"radiosity_W_m2": (1.0, 4.0, 2.0)})
    image = torch.tensor([1.0, 4.0, 2.0], dtype=torch.float64)[:, None, None] * FLAT
    camera = Camera(CameraConfig(sensor=CLEAN), scene, dtype=torch.float64)
    frames = photographs(camera, image, image, 0)
    np.testing.assert_allclose(frames.flat.mean(axis=(1, 2)), np.array([0.025, 0.1, 0.05]) * 65535, atol=0.6)


def test_noise_of_a_mosaic_is_that_of_its_pixels():
    """Where a filter lies the noise is whole; in between it is the mean of two or four neighbours'."""
    frames = taken(CameraConfig(mosaic="rggb", sensor=NOISY), FLAT)[1]
    red = frames.photo[0].astype(float)
    own, diagonal = red[2:-2:2, 2:-2:2], red[3:-2:2, 3:-2:2]
    electrons = 2000 + 25
    assert (own / 65535 * 20_000).var() == pytest.approx(electrons, rel=0.1)
    assert (diagonal / 65535 * 20_000).var() == pytest.approx(electrons / 4, rel=0.15)


def test_saturated_pixels_are_told(caustic):
    config = CameraConfig(sensor=CLEAN.model_copy(update={"exposure": 0.5}))
    frames = taken(config, caustic)[1]
    expected = (caustic >= 2 * (1 - 0.5 / 65535)).double().mean(dim=(1, 2))
    np.testing.assert_allclose(frames.saturated, expected, atol=1e-12)
    assert min(frames.saturated) > 0


# --------------------------------------------------------------------- and back


def test_a_photo_of_the_window_comes_back_to_half_a_count(tmp_path, caustic):
    camera, frames = taken(CameraConfig(sensor=CLEAN), caustic)
    found = captured(tmp_path, camera, frames)
    assert found.mask.all()
    # The flat frame is rounded, too, from 6553.5 counts.
    assert np.abs(found.irradiance - caustic.numpy() * 6553.5 / 6554).max() < 0.6 / 6554


@pytest.mark.parametrize(
    "lens",
    [
        {},
        {"psf_px": 0.7, "light": (0.05, -0.04, -0.06, 0.02, -0.03), "colour_shift_px": ((0.2, 0.1), (0, 0), (-0.2, 0))},
        {"gain": (0.5, 1.0, 0.8), "colour_scale": (0.001, 0.0, -0.001)},
    ],
)
def test_noise_comes_back_as_large_as_its_electrons_say(tmp_path, caustic, lens):
    """Irradiance is that behind lens and filters, to within shot, read and flat-field noise: its square means 1."""
    camera, frames = taken(CameraConfig(**lens, sensor=NOISY), caustic, seed=3)
    found = captured(tmp_path, camera, frames)
    seen, flat = camera(caustic), camera(FLAT)
    truth = (seen / flat).numpy()
    per_light = NOISY.exposure * NOISY.full_well_electrons * flat.numpy()  # electrons of L_i
    quantisation = (NOISY.full_well_electrons / (2**NOISY.bits - 1)) ** 2 / 12
    variance = (per_light * truth + NOISY.read_noise_electrons**2 + quantisation) / per_light**2
    # The dark frame is smoothed; the flat field's noise is that of 64 exposures, smoothed too.
    chi2 = ((found.irradiance - truth) ** 2 / variance)[found.mask]
    assert chi2.mean() == pytest.approx(1.0, abs=0.06)
    bias = ((found.irradiance - truth) / np.sqrt(variance))[found.mask].mean()
    assert abs(bias) < 0.15


def test_a_photo_from_the_side_comes_back_to_the_window(tmp_path, caustic):
    """Corners are in the file beside; what is left is the blur, and light is conserved."""
    camera, frames = taken(BENT, caustic)
    found = captured(tmp_path, camera, frames)
    # 0.5 camera pixels are 0.35 of the window's.
    blurred = Camera(CameraConfig(psf_px=0.5 * 96 / 135), SCENE, dtype=torch.float64)(caustic).numpy()
    inner = (slice(None), slice(2, -2), slice(2, -2))
    error, contrast = (found.irradiance - blurred)[inner], (blurred - 1)[inner]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(contrast**2))
    np.testing.assert_allclose(found.irradiance.mean(axis=(1, 2)), 1.0, atol=5e-3)


def test_the_window_is_found_by_its_border(tmp_path, caustic):
    camera, frames = taken(BENT, caustic)
    known = captured(tmp_path, camera, frames)
    found = captured(tmp_path, camera, frames, corners="auto")
    location = next(stage for stage in found.stages if stage.name == "location")
    rows = np.abs(location.marks_px - camera.corners_px())
    assert rows.max() < 0.1
    assert np.sqrt(np.mean((found.irradiance - known.irradiance) ** 2)) < 0.02


def test_fewer_wavelengths_than_channels_are_unmixed(tmp_path):
    """A camera of three channels before a lamp of two: the matrix goes along."""
    scene = Scene(image_pixels=M, height_samples=48, wavelengths_m=(610e-9, 450e-9), radiosity_W_m2=(1.0, 1.0))
    image = torch.stack((1.5 * FLAT[0], 0.5 * FLAT[0]))
    config = CameraConfig(mixing=((0.9, 0.1), (0.3, 0.4), (0.05, 0.8)), sensor=CLEAN)
    camera = Camera(config, scene, dtype=torch.float64)
    frames = photographs(camera, image, torch.ones_like(image), 0)
    found = captured(tmp_path, camera, frames, scene)
    np.testing.assert_allclose(found.irradiance, image.numpy(), atol=2e-3)


def test_files_say_what_a_person_would_know(tmp_path, caustic):
    camera, frames = taken(BENT, caustic)
    files = photograph_files(tmp_path / "a.b.tif", camera)
    write_photographs(files, frames, camera)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in files.values())
    assert files["dark"].name == "a.b_dark.tif" and set(files) == {"photo", "dark", "flat", "capture", "corners"}
    photo = read_image(files["photo"])
    assert photo.bit_depth == 16 and photo.wavelengths_m == SCENE.wavelengths_m
    assert (photo.values == frames.photo).all()


# --------------------------------------------------------------------- refusals


def refusal(config, image=FLAT, scene=SCENE):
    with pytest.raises(InputError) as caught:
        camera = Camera(config, scene, dtype=torch.float64)
        photographs(camera, image, torch.ones_like(image), 0)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_cameras_that_make_no_photo_are_refused(caustic):
    assert "give at most 12" in refusal(CameraConfig(psf_px=40.0))
    assert "box_px 90" in refusal(CameraConfig(box_px=90.0))
    told = refusal(CameraConfig(sensor=SensorConfig(exposure=1e-5, bits=8)))
    assert "sees nothing" in told and "raise" in told
    assert "saturates" in refusal(CameraConfig(gain=30.0, sensor=SensorConfig(exposure=0.1)))
    assert "lower sensor.exposure from 0.9" in refusal(CameraConfig(sensor=SensorConfig(exposure=0.9)), 2 * FLAT)
    assert "nothing of the window" in refusal(CameraConfig(shift_px=(500.0, 0.0)))
    assert "no convex quadrilateral" in refusal(
        CameraConfig(frame_px=(190, 180), corners_px=((25, 20), (160, 24), (22, 150), (156, 158)))
    )
    assert "horizon" in refusal(CameraConfig(homography=((1, 0, 0), (0, 1, 0), (0.9, 0.9, 1))))
    assert "px of the window wide" in refusal(
        CameraConfig(frame_px=(96, 96), corners_px=((30, 30), (60, 30), (60, 60), (30, 60)))
    )
    assert "so uneven" in refusal(CameraConfig(light=(0.9, 0.9, 0.0, 0.0, 0.0)))
    assert "3 camera channels" in refusal(CameraConfig(mosaic="rggb", mixing=((1, 0, 0), (0, 1, 0))))
    assert "2 entries for 3 wavelengths" in refusal(CameraConfig(psf_px=(0.1, 0.2)))
    assert "columns" in refusal(CameraConfig(mixing=((1.0, 0.0),)))


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"dust_radius_px": (4.0, 1.0)}, "write [1, 4]"),
        ({"dust_depth": (0.5, 0.2)}, "runs backwards"),
        ({"hot_level": (0.5, 0.2)}, "runs backwards"),
        ({"read_noise_electrons": 5.0}, "full_well_electrons, for example 30000"),
        ({"exposure": 0.9, "black_level": 0.2}, "expose at most 0.8"),
        ({"exposure": 0.0}, "greater than 0"),
        ({"bits": 20}, "less than or equal to 16"),
    ],
)
def test_sensors_that_are_none_are_refused(values, reason):
    with pytest.raises(ValueError, match="(?s)" + reason.replace("[", r"\[").replace("]", r"\]")):
        SensorConfig(**values)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"corners_px": ((0, 0), (9, 0), (9, 9), (0, 9))}, "give frame_px"),
        ({"frame_px": (20, 20), "corners_px": ((0, 0), (9, 0), (9, 9), (0, 9)), "turn_rad": 0.1}, "leave out"),
        ({"mixing": ((1.0, 0.0), (1.0,))}, "all alike"),
        ({"mixing": ((1.0, 0.0), (0.0, 0.0))}, "row of zeros"),
        ({"psf_px": -1.0}, "greater than or equal to 0"),
        ({"magnification": 0.1}, "greater than or equal to 0.5"),
        ({"psf": 1.0}, "Extra inputs"),
    ],
)
def test_cameras_that_contradict_themselves_are_refused(values, reason):
    with pytest.raises(ValueError, match=reason):
        CameraConfig(**values)
