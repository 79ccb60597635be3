"""A model camera records a known irradiance; calibration must give it back within the camera's noise."""

from dataclasses import replace

import numpy as np
import pytest

from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.capture.shot import Capture
from warp_caustics.errors import CausticsError, InputError, MismatchError
from warp_caustics.io import ImageFile
from warp_caustics.scene import Scene

from .model_camera import LIGHT, SCENE, Camera, M, as_file, as_floats, smooth_light

RED_GREEN_BLUE = (610e-9, 530e-9, 430e-9)


def relative_error(capture: Capture, light: np.ndarray) -> np.ndarray:
    """Root mean square of (measured - true) / its own shot noise scale, where light is near 1, shape [n_w]."""
    return np.array(
        [np.std((c - t)[(t > 0.7) & (t < 1.4)]) for c, t in zip(capture.irradiance, light, strict=True)], np.float64
    )


# ------------------------------------------------------------------ irradiance


def test_irradiance_is_recovered_within_the_noise() -> None:
    camera = Camera()
    image, dark, flat = camera.frames()
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)
    assert capture.irradiance.dtype == np.float32
    assert (relative_error(capture, LIGHT) < 1.12 * camera.noise_std()).all()
    # No part of the picture is off on average: blocks of 40 x 40 pixels have 1/40 of the noise.
    for measured, true, std in zip(capture.irradiance, LIGHT, camera.noise_std(), strict=True):
        blocks = (measured - true).reshape(4, M // 4, 4, M // 4).mean(axis=(1, 3))
        assert np.abs(blocks).max() < 0.25 * std
        border = (measured - true)[:, :3].mean()
        assert abs(border) < 0.5 * std
    assert capture.mask.all() and capture.warnings == ()
    assert len(capture.steps) == 3


def test_radiosity_and_exposure_scale() -> None:
    scene = Scene(image_pixels=M, radiosity_W_m2=(2.0, 0.5, 1.0))
    image, dark, flat = Camera().frames()
    shorter = Camera().record(LIGHT, exposure=0.25)
    capture = capture_to_irradiance(image, scene=scene, dark=dark, flat=flat)
    np.testing.assert_allclose(capture.irradiance.mean(axis=(1, 2)), [2, 0.5, 1], rtol=2e-3)
    capture = capture_to_irradiance(shorter, scene=scene, dark=dark, flat=flat, exposure=0.25)
    np.testing.assert_allclose(capture.irradiance.mean(axis=(1, 2)), [2, 0.5, 1], rtol=2e-3)
    forgotten = capture_to_irradiance(shorter, scene=scene, dark=dark, flat=flat)
    assert "0.25 times" in forgotten.warnings[0]


def test_without_a_flat_field_the_mean_is_assumed() -> None:
    image, dark, _ = Camera(vignetting=0.0).frames()
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark)
    np.testing.assert_allclose(capture.irradiance.mean(axis=(1, 2)), 1, rtol=1e-5)
    assert (relative_error(capture, LIGHT) < 1.12 * Camera(vignetting=0.0).noise_std()).all()
    assert "no flat field" in capture.warnings[0]
    assert any("conserves light" in step for step in capture.steps)


def test_without_a_dark_frame_it_says_so() -> None:
    image, _, flat = Camera().frames()
    capture = capture_to_irradiance(image, scene=SCENE, flat=flat)
    assert any("no dark frame" in line for line in capture.warnings)


def test_known_counts_need_no_flat_field() -> None:
    counts = LIGHT * 5000
    by_file = capture_to_irradiance(as_file(counts, count_W_m2=1 / 5000), scene=SCENE)
    by_hand = capture_to_irradiance(as_file(counts * [[[1]], [[2]], [[3]]]), scene=SCENE, exposure=(5e3, 1e4, 1.5e4))
    for capture in (by_file, by_hand):
        np.testing.assert_allclose(capture.irradiance, LIGHT, rtol=1e-5)
        assert capture.warnings == ()


def test_floats_are_irradiance_already() -> None:
    capture = capture_to_irradiance(as_floats(LIGHT * 0.9), scene=SCENE)
    np.testing.assert_array_equal(capture.irradiance, (LIGHT * 0.9).astype(np.float32))
    assert capture.warnings == ()
    counts = capture_to_irradiance(as_floats(LIGHT * 5000), scene=SCENE)
    assert "5e+03 times" in counts.warnings[0]


def test_hot_and_dead_pixels() -> None:
    image, dark, flat = Camera().frames()
    for frame in (image, dark, flat):
        frame.values[1, 30, 40] += 9000  # hot: the same extra counts in each frame
        frame.values[2, 50, 60] = 200  # dead: never sees light
    flat.values[2, 50, 60] = 0
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)
    assert capture.irradiance[1, 30, 40] == pytest.approx(LIGHT[1, 30, 40], abs=0.1)
    assert not capture.mask[2, 50, 60] and capture.mask.sum() == capture.mask.size - 1
    around = np.delete(capture.irradiance[2, 48:53, 58:63].ravel(), 12)
    assert around.min() <= capture.irradiance[2, 50, 60] <= around.max()
    assert any("shows no light in 1 pixels" in line for line in capture.warnings)


def test_saturated_pixels_are_masked_and_counted() -> None:
    image, dark, flat = Camera().frames()
    image.values[0, :20, :] = 65535
    image.values[1, 3, 4] = 65535
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)
    np.testing.assert_allclose(capture.saturated_fraction, [20 / M, 1 / M**2, 0], rtol=1e-12)
    assert not capture.mask[0, :20].any() and capture.mask[0, 20:].all() and not capture.mask[1, 3, 4]
    warned = [line for line in capture.warnings if "saturated" in line]
    assert len(warned) == 1 and "610 nm: 12.5%" in warned[0]
    flat.values[0, :20] = 65535
    with pytest.raises(InputError, match="flat field is saturated"):
        capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)


# ------------------------------------------------------------------ which channel is which


def permuted(file: ImageFile, order: list[int], **fields: object) -> ImageFile:
    return replace(file, values=file.values[order], **fields)


@pytest.mark.parametrize("order", ["430,610,530", " 430 nm, 610nm,530.4", (430e-9, 610e-9, 530e-9)])
def test_wavelength_order_sorts_channels(order: str | tuple[float, ...]) -> None:
    frames = [permuted(frame, [2, 0, 1]) for frame in Camera().frames()]
    capture = capture_to_irradiance(frames[0], scene=SCENE, dark=frames[1], flat=frames[2], wavelength_order=order)
    assert (relative_error(capture, LIGHT) < 1.12 * Camera().noise_std()).all()


def test_recorded_wavelengths_sort_channels() -> None:
    file = as_floats(LIGHT[[1, 2, 0]], wavelengths_m=(530e-9, 430e-9, 610e-9), format="hdf5")
    np.testing.assert_allclose(capture_to_irradiance(file, scene=SCENE).irradiance, LIGHT, rtol=1e-6)


def test_red_is_the_longest_wavelength() -> None:
    rising = Scene(image_pixels=M, wavelengths_m=RED_GREEN_BLUE[::-1])
    capture = capture_to_irradiance(as_floats(LIGHT), scene=rising)
    np.testing.assert_allclose(capture.irradiance, LIGHT[::-1], rtol=1e-6)
    # An array has no red: nobody can tell.
    with pytest.raises(InputError, match="for example --wavelength-order 430,530,610"):
        capture_to_irradiance(as_floats(LIGHT, format="npy"), scene=rising)


def test_one_channel_for_one_wavelength() -> None:
    scene = Scene(image_pixels=M, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    capture = capture_to_irradiance(as_floats(LIGHT[:1], format="npy"), scene=scene)
    assert capture.irradiance.shape == (1, M, M) and capture.noise_std.shape == (1,)


# ------------------------------------------------------------------ things that do not fit

RGB = as_floats(LIGHT)
COUNTS = as_file(LIGHT * 5000)
TOO_LARGE = as_floats(np.ones((3, 2 * M, 2 * M)))
REFUSED: dict[str, tuple[ImageFile, dict[str, object], type[CausticsError], str]] = {
    "gray for three": (
        as_floats(LIGHT[:1]),
        {},
        MismatchError,
        "--set scene.wavelengths_m=[530nm] --set scene.radiosity_W_m2=[1]",
    ),
    "two for three": (as_floats(LIGHT[:2]), {}, MismatchError, "2 channels"),
    "five for three": (as_floats(np.ones((5, M, M))), {}, MismatchError, "5 channels"),
    "twice as large": (TOO_LARGE, {}, MismatchError, "average blocks of 2 x 2"),
    "not square": (as_floats(LIGHT[:, :, :-9]), {}, MismatchError, "151 x 160 pixels, the scene has 160 x 160; crop"),
    "one pixel short": (as_floats(LIGHT[:, 1:, 1:]), {}, MismatchError, "159 x 159"),
    "order of two": (RGB, {"wavelength_order": "610,530"}, InputError, "names 2 channels"),
    "other order": (RGB, {"wavelength_order": "610,530,450"}, MismatchError, "610, 530, 450 nm, but the scene has"),
    "order twice": (RGB, {"wavelength_order": "610,610,430"}, MismatchError, "610, 610, 430"),
    "order in words": (RGB, {"wavelength_order": "red,green,blue"}, InputError, "610,530,430"),
    "order as nm numbers": (RGB, {"wavelength_order": (610, 530, 430)}, InputError, "metres (610e-9)"),
    "recorded otherwise": (as_floats(LIGHT, wavelengths_m=(7e-7, 5e-7, 4e-7)), {}, MismatchError, "700, 500, 400"),
    "dark shape": (COUNTS, {"dark": as_file(LIGHT[:, :9])}, MismatchError, "dark frame has shape (3, 9, 160)"),
    "flat channels": (COUNTS, {"flat": as_file(LIGHT[:1])}, MismatchError, "flat field has shape (1, 160, 160)"),
    "flat of 8 bits": (
        COUNTS,
        {"flat": as_file(LIGHT, full_scale=255.0, bit_depth=8)},
        MismatchError,
        "flat field has 8 bits, the image 16",
    ),
    "dark too bright": (COUNTS, {"dark": as_file(LIGHT * 9000)}, MismatchError, "610 nm: the dark frame is brighter"),
    "flat without light": (
        COUNTS,
        {"flat": as_file(LIGHT * 100), "dark": as_file(np.full_like(LIGHT, 900))},
        MismatchError,
        "as dark as the dark frame",
    ),
    "black": (as_file(LIGHT * 0), {}, InputError, "black"),
    "exposure 0": (COUNTS, {"exposure": 0.0}, InputError, "exposure 0.0"),
    "two exposures": (COUNTS, {"exposure": (1.0, 2.0)}, InputError, "one per wavelength"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_misfits_give_one_line(case: str) -> None:
    image, options, error, text = REFUSED[case]
    with pytest.raises(error) as caught:
        capture_to_irradiance(image, scene=SCENE, **options)
    assert text in str(caught.value) and "\n" not in str(caught.value), str(caught.value)


def test_warnings_of_the_files_are_passed_on() -> None:
    image, dark, flat = Camera().frames()
    capture = capture_to_irradiance(
        replace(image, warnings=("a",)), scene=SCENE, dark=replace(dark, warnings=("b",)), flat=flat
    )
    assert capture.warnings == ("a", "dark frame: b")


# ------------------------------------------------------------------ noise


@pytest.mark.parametrize("light", [np.stack([smooth_light()] * 3), LIGHT], ids=["smooth", "caustic"])
def test_noise_of_a_calibrated_capture(light: np.ndarray) -> None:
    """Shot and read noise, through dark frame and flat field, at irradiance near 1."""
    camera = Camera(seed=8)
    image, dark, flat = camera.frames(light)
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)
    np.testing.assert_allclose(capture.noise_std, camera.noise_std(), rtol=0.15)
