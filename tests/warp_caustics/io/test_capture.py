"""A model camera records a known irradiance; calibration must give it back within the camera's noise."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from warp_caustics.errors import CausticsError, InputError, MismatchError
from warp_caustics.io import Capture, ImageFile, capture_to_irradiance, estimate_noise_std
from warp_caustics.io.capture import smooth_frame
from warp_caustics.scene import Scene

M = 160
SCENE = Scene(image_pixels=M)
RED_GREEN_BLUE = (610e-9, 530e-9, 430e-9)


def smooth_light() -> np.ndarray:
    row, column = np.mgrid[:M, :M] / M
    return 1 + 0.2 * np.sin(4 * row + 1) * np.cos(5 * column)


def caustic_light() -> np.ndarray:
    """Folds: 1/sqrt(distance) on one side of curved lines, shadow on the other, lit plain elsewhere."""
    row, column = np.mgrid[:M, :M] / M
    light = np.ones((M, M))
    for offset, slope, bend in ((0.2, 0.3, 0.2), (0.5, -0.4, 0.5), (0.8, 0.1, -0.3)):
        distance = (row - offset - slope * (column - 0.5) - bend * (column - 0.5) ** 2) * M
        light += np.where((distance > 0) & (distance < 12), 2 / np.sqrt(np.maximum(distance, 0.5)) - 0.55, 0)
        light -= np.where((distance <= 0) & (distance > -6), 0.8, 0)
    return np.maximum(light, 0.02)


LIGHT = np.stack([caustic_light(), np.roll(caustic_light(), 9, axis=0), caustic_light().T])
LIGHT /= LIGHT.mean(axis=(1, 2), keepdims=True)


@dataclass
class Camera:
    """Linear sensor: counts = offset + gain L v(x, y) + noise; shot noise follows from the electrons per count."""

    gain: tuple[float, ...] = (4000.0, 6000.0, 3000.0)
    offset: float = 200.0
    electrons_per_count: float = 2.5
    read_noise: float = 4.0
    vignetting: float = 0.35
    seed: int = 0

    def response(self) -> np.ndarray:
        row, column = (np.mgrid[:M, :M] + 0.5) / M - 0.5
        return 1 / (1 + self.vignetting * ((row - 0.05) ** 2 + column**2)) ** 2

    def record(self, light: np.ndarray | float, exposure: float = 1.0) -> ImageFile:
        random = np.random.default_rng((self.seed, int(1e6 * exposure), int(np.sum(light))))
        gain = np.array(self.gain)[:, None, None] * exposure
        electrons = random.poisson(gain * light * self.response() * self.electrons_per_count)
        counts = electrons / self.electrons_per_count + self.offset + random.normal(0, self.read_noise, electrons.shape)
        return as_file(np.clip(np.rint(counts), 0, 65535))

    def noise_std(self) -> np.ndarray:
        """Standard deviation [W/m^2] at irradiance 1, averaged over the vignetting (root mean square), shape [3]."""
        signal = np.array(self.gain)[:, None, None] * self.response()
        variance = (signal / self.electrons_per_count + self.read_noise**2 + 1 / 12) / signal**2
        return np.sqrt(variance.mean(axis=(1, 2)))

    def frames(self, light: np.ndarray = LIGHT) -> tuple[ImageFile, ImageFile, ImageFile]:
        return self.record(light), self.record(np.zeros((1, M, M))), self.record(np.ones((1, M, M)))


def as_file(values: np.ndarray, **fields: object) -> ImageFile:
    defaults = {"full_scale": 65535.0, "bit_depth": 16, "format": "tiff"}
    return ImageFile(values=np.asarray(values, np.float32), **(defaults | fields))


def as_floats(values: np.ndarray, **fields: object) -> ImageFile:
    return as_file(values, **({"full_scale": None, "bit_depth": 32} | fields))


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


def test_smoothing_a_flat_field_has_no_bias_at_the_border() -> None:
    """A Gaussian of 4 pixels would be off by 1.2 % there; the cubic part of the vignetting alone leaves 2.5e-4."""
    truth = 5000 * Camera().response()
    smooth, _ = smooth_frame(truth)
    assert np.abs(smooth / truth - 1).max() < 3e-4
    noise = np.random.default_rng(4).normal(0, 50, truth.shape)
    error = smooth_frame(truth + noise)[0] - truth
    assert error[20:-20, 20:-20].std() < 50 / 7
    assert error[:1].std() < 50 / 3


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
    with pytest.raises(InputError, match="wavelength_order, for example '430,530,610'"):
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
    "gray for three": (as_floats(LIGHT[:1]), {}, MismatchError, "1 channels, the scene 3 wavelengths; record all"),
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


@pytest.mark.parametrize("light", [smooth_light(), caustic_light()], ids=["smooth", "caustic"])
@pytest.mark.parametrize("std", [0.003, 0.01, 0.05])
def test_planted_noise_is_found(light: np.ndarray, std: float) -> None:
    found = [
        estimate_noise_std(light + np.random.default_rng(seed).normal(0, std, light.shape), 1.0) for seed in range(4)
    ]
    np.testing.assert_allclose(found, std, rtol=0.15)


@pytest.mark.parametrize("light", [np.stack([smooth_light()] * 3), LIGHT], ids=["smooth", "caustic"])
def test_noise_of_a_calibrated_capture(light: np.ndarray) -> None:
    """Shot and read noise, through dark frame and flat field, at irradiance near 1."""
    camera = Camera(seed=8)
    image, dark, flat = camera.frames(light)
    capture = capture_to_irradiance(image, scene=SCENE, dark=dark, flat=flat)
    np.testing.assert_allclose(capture.noise_std, camera.noise_std(), rtol=0.15)


def test_noise_of_the_shadows_is_not_that_of_the_light() -> None:
    light = np.where(np.arange(M) < 0.8 * M, 0.1, 1.0) * np.ones((M, M))
    noisy = light + np.random.default_rng(1).normal(0, 1, light.shape) * 0.05 * light
    assert estimate_noise_std(noisy, 1.0) == pytest.approx(0.05, rel=0.15)


def test_structure_is_not_noise() -> None:
    """Steep diagonal fringes over nearly half the picture."""
    row, column = np.mgrid[:M, :M]
    light = 1 + np.where(column < 0.45 * M, 0.3 * np.sin((row + column) * 2 * np.pi / 6), 0)
    noisy = light + np.random.default_rng(6).normal(0, 0.01, light.shape)
    assert estimate_noise_std(noisy, 1.0) == pytest.approx(0.01, rel=0.15)


def test_noise_ignores_invalid_pixels() -> None:
    random = np.random.default_rng(2)
    light = smooth_light() + random.normal(0, 0.01, (M, M))
    valid = np.ones((M, M), bool)
    valid[: int(0.8 * M)] = False
    light[~valid] = 1 + random.normal(0, 0.2, (~valid).sum())
    assert estimate_noise_std(light, 1.0, valid) == pytest.approx(0.01, rel=0.15)


def test_noise_of_too_little_is_unknown() -> None:
    assert np.isnan(estimate_noise_std(np.ones((6, 6)), 1.0))
    assert np.isnan(estimate_noise_std(np.ones((M, M)), 1.0, np.zeros((M, M), bool)))
    assert estimate_noise_std(np.ones((M, M)), 1.0) == 0
