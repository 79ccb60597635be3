"""Photo to irradiance: what a tilted camera records comes back as the irradiance in the window."""

import numpy as np
import pytest
from scipy import ndimage

from warp_caustics.capture.corners import located_window
from warp_caustics.capture.distortion import Distortion
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.capture.read import _brightness
from warp_caustics.capture.registration import CORNER_SIGNS, fitted_registration
from warp_caustics.capture.resample import planned, to_window
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene

from .conftest import M, View
from .pinhole_camera import BARREL, PERSPECTIVE, TILTED, PinholeCamera, caustic

SIZE = (0.05, 0.05)
PLATE = CORNER_SIGNS * 0.025


def registered(view: View):
    return fitted_registration(PLATE, view.camera.project(PLATE), SIZE, distortion=view.lens)


def fine_per_camera_px(camera: PinholeCamera, fine_pixels: int) -> float:
    """Fine pixels of the light per camera pixel, in the mean over the window."""
    x, y = camera.project(PLATE).T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    return float(fine_pixels / np.sqrt(area))


def through_lens(camera: PinholeCamera, fine: np.ndarray, pixels: int) -> np.ndarray:
    """Irradiance blurred by the lens alone, in the scene's pixels, shape [3, pixels, pixels].

    The camera's pixels blur too, but the spline undoes that: it goes by means over pixels.
    """
    finer = fine.shape[-1] // pixels
    sigma = camera.blur_px * fine_per_camera_px(camera, fine.shape[-1])
    soft = ndimage.gaussian_filter(fine, (0, sigma, sigma), mode="nearest")
    return soft.reshape(3, pixels, finer, pixels, finer).mean(axis=(2, 4))


def calibrated(view: View, **options):
    return capture_to_irradiance(
        view.photo, scene=view.scene, dark=view.dark, registration=registered(view), **{"flat": view.flat, **options}
    )


def test_irradiance_comes_back(view):
    """Beside what lens and pixels blur, a few percent of the contrast of a caustic with filaments are off."""
    capture = calibrated(view, hot_pixels=True)
    assert capture.irradiance.shape == (3, M, M) and capture.mask.mean() > 0.995
    error = capture.irradiance - through_lens(view.camera, view.fine, M)
    assert np.sqrt(np.mean(error[capture.mask] ** 2)) < 0.06 * view.direct.std()
    np.testing.assert_allclose(capture.irradiance.mean(axis=(1, 2)), view.direct.mean(axis=(1, 2)), rtol=3e-3)
    # A pixel of shift would be far worse: the test can tell.
    assert (
        np.sqrt(np.mean((np.roll(capture.irradiance, 1, axis=2) - through_lens(view.camera, view.fine, M)) ** 2))
        > 0.3 * view.direct.std()
    )


def test_the_border_is_not_darker(view):
    """With a flat field, light of 1 W/m^2 is 1 W/m^2 up to the last pixel."""
    flat_again = view.camera.record(view.lit, seed=7)
    capture = capture_to_irradiance(
        flat_again, scene=view.scene, dark=view.dark, flat=view.flat, registration=registered(view), hot_pixels=True
    )
    edge = np.ones((M, M), bool)
    edge[1:-1, 1:-1] = False
    for channel, mask in zip(capture.irradiance, capture.mask, strict=True):
        assert channel[edge & mask].mean() == pytest.approx(1.0, abs=0.01)
        assert np.abs(channel[mask] - 1).max() < 0.15
    assert capture.mask[:, edge].mean() > 0.98


def test_without_a_flat_field_the_rest_is_said(tilted):
    capture = calibrated(tilted, flat=None)
    np.testing.assert_allclose(capture.irradiance.mean(axis=(1, 2)), 1, rtol=0.02)
    assert any("no flat field" in warning for warning in capture.warnings)


@pytest.mark.parametrize("fill", [0.25, 0.35, 0.6, 0.9])
def test_noise_is_estimated_after_resampling(light, fill):
    """From 0.8 to 2.8 camera pixels per pixel of the scene, within 20 % of what repeated photos show."""
    camera = PinholeCamera(width=340, height=300, finer=2, fill=fill, gain=(2500.0, 3500.0, 2000.0), hot=0, **TILTED)
    view = View(camera, *light)
    captures = [
        capture_to_irradiance(
            camera.record(view.seen, seed=20 + i),
            scene=view.scene,
            dark=view.dark,
            flat=view.flat,
            registration=registered(view),
        )
        for i in range(4)
    ]
    stack = np.stack([capture.irradiance for capture in captures]).astype(np.float64)
    near = (stack.mean(axis=0) > 0.7) & (stack.mean(axis=0) < 1.4)
    for channel in range(3):
        true = np.sqrt(stack.var(axis=0, ddof=1)[channel][near[channel]].mean())
        estimated = np.mean([capture.noise_std[channel] for capture in captures])
        assert estimated == pytest.approx(true, rel=0.2)
    assert any("come closer" in line for line in captures[0].warnings) == (fill < 0.3)


def test_a_frame_of_exactly_the_window_is_resampled_to_itself():
    """White noise, the hardest case: the spline's means over the pixels are the pixels."""
    noise = np.random.default_rng(0).normal(1, 0.1, (1, 64, 64))
    corners = (CORNER_SIGNS + 1) * 32 - 0.5
    plan = planned(fitted_registration(PLATE, corners, SIZE), 64, (64, 64))
    values, mask = to_window(noise, np.ones(noise.shape, bool), plan)
    assert np.abs(values - noise).max() < 0.1 * 0.15 and mask.all()


def test_light_is_conserved():
    """The sum over the window is the integral over the photo, also where the photo is four times finer."""
    row, column = np.mgrid[:300, :300].astype(float)
    photo = 1 + 5 * np.exp(-((row - 140) ** 2 + (column - 160) ** 2) / 8)
    corners = np.array([[30.0, 35], [250, 35], [250, 255], [30, 255]])
    plan = planned(fitted_registration(PLATE, corners, SIZE), 55, (300, 300))
    values, _ = to_window(photo[None], np.ones((1, 300, 300), bool), plan)
    bump = (values[0] - 1).sum() * (220 / 55) ** 2
    assert bump == pytest.approx(5 * 8 * np.pi, rel=2e-3)


def test_missing_pixels_are_masked_and_do_not_spread():
    """A saturated patch is masked; pixels beside it keep their values."""
    photo = np.ones((1, 120, 120))
    photo[0, 50:60, 50:60] = 1e6
    valid = photo < 10
    plan = planned(fitted_registration(PLATE, (CORNER_SIGNS + 1) * 50 + 9.5, SIZE), 50, (120, 120))
    values, mask = to_window(photo, valid, plan)
    assert (~mask).sum() == 25 and not mask[0, 20:25, 20:25].any()
    np.testing.assert_allclose(values, 1, atol=1e-9)


def test_a_window_outside_the_photo_is_refused(tilted):
    shifted = fitted_registration(PLATE, tilted.camera.project(PLATE) + np.array([150.0, 0.0]), SIZE)
    with pytest.raises(MismatchError, match="outside the photo"):
        capture_to_irradiance(tilted.photo, scene=tilted.scene, registration=shifted)


def test_stages_tell_what_was_done(tilted):
    capture = calibrated(tilted, hot_pixels=True)
    assert [stage.name for stage in capture.stages] == [
        "location", "channels", "dark frame", "hot pixels", "flat field", "window",
    ]  # fmt: skip
    assert [stage.text for stage in capture.stages] == capture.steps
    window = capture.stages[-1]
    assert window.after.shape == (3, M, M) and window.marks_px.shape == (4, 2)
    assert 1.5 < window.figures["scale_min"] <= window.figures["scale_max"] < 3


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", ["tilt", "perspective", "lens"])
def test_accuracy_at_512(name):
    """Prints what docs/capture.md reports: pytest -m slow -s tests/warp_caustics/capture -k 512."""
    pixels, finer = 512, 3
    direct, fine = caustic(pixels, finer)
    keywords = {"tilt": TILTED, "perspective": PERSPECTIVE, "lens": {**PERSPECTIVE, "lens": BARREL}}[name]
    # The brightest line is 46 times as bright as the flat plate and must not saturate.
    camera = PinholeCamera(width=1500, height=1300, hot=400, finer=2, gain=(1200.0, 1300.0, 1100.0), **keywords)
    lens = Distortion(**camera.intrinsics()) if any(camera.lens) else None
    scene = Scene(image_pixels=pixels)
    photo, flat, dark = (
        camera.record(camera.expected(fine)),
        camera.record(camera.expected(1.0), seed=1),
        camera.record(0.0),
    )
    soft = through_lens(camera, fine, pixels)
    clicks = camera.project(PLATE) + np.random.default_rng(5).normal(0, 0.3, (4, 2))
    ways = {
        "exact": fitted_registration(PLATE, camera.project(PLATE), SIZE, distortion=lens),
        "clicks": fitted_registration(PLATE, clicks, SIZE, distortion=lens),
        "border": located_window(None, _brightness(flat, dark), scene, distortion=lens),
    }
    print(f"\n{name}: perspective {camera.perspective():.3f}, contrast {direct.std():.3f} W/m^2")
    for way, found in ways.items():
        capture = capture_to_irradiance(photo, scene=scene, dark=dark, flat=flat, registration=found, hot_pixels=True)
        error = [float(np.sqrt(np.mean((capture.irradiance - truth)[capture.mask] ** 2))) for truth in (direct, soft)]
        shift = camera.window_error_px(found, pixels)
        print(f"  {way:8s} {shift:.3f} px; image error {error[0]:.4f} W/m^2, {error[1]:.4f} beside the lens's blur")
        assert shift < 1
        assert error[1] < 0.12 * direct.std()
