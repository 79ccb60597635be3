"""A blur of known width, divided out: of a caustic, of nothing, next to masked pixels, and what it does to noise."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from warp_caustics import CausticSimulator, Scene
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.capture.sharpening import sharpen, wiener
from warp_caustics.capture.stage import Work
from warp_caustics.io.image_file import ImageFile
from warp_caustics.prints.line import Line, line_relief

SCENE = Scene(height_samples=32, image_pixels=128)
FINE = 4


def work(signal, mask=None):
    mask = np.ones(signal.shape, bool) if mask is None else mask
    return Work(signal=signal, mask=mask, level=np.ones(len(signal)), labels=["a", "b", "c"][: len(signal)])


@pytest.fixture(scope="module")
def caustic():
    """At four times the pixels, so that it can be blurred before pixels take their means."""
    lines = [Line((-0.015, -0.01), (0.018, 0.012), 4e-3, 4e-4), Line((-0.01, 0.015), (0.005, -0.018), 3e-3, 3e-4)]
    relief = torch.tensor(line_relief(lines, 32, SCENE.plate_size_m), dtype=torch.float32)
    fine = SCENE.model_copy(update={"image_pixels": FINE * 128})
    return CausticSimulator(fine, n_photons=1024**2)(relief).double().numpy()


def seen(caustic, blur_px):
    blurred = [ndimage.gaussian_filter(channel, FINE * blur_px, mode="nearest") for channel in caustic]
    return np.stack(blurred).reshape(3, 128, FINE, 128, FINE).mean(axis=(2, 4))


@pytest.mark.parametrize("blur_px", [0.5, 0.75, 1.0])
def test_a_caustic_is_as_sharp_as_before(caustic, blur_px):
    sharp, blurred = seen(caustic, 0.0), seen(caustic, blur_px)
    state = work(blurred.copy())
    sharpen(state, blur_px)
    left, before = np.abs(state.signal - sharp).mean(), np.abs(blurred - sharp).mean()
    assert left < (0.2 if blur_px < 1 else 0.35) * before
    np.testing.assert_allclose(state.signal.mean(), blurred.mean(), rtol=2e-3)
    assert state.mask.all() and "blur of" in state.steps[0]


def test_flat_light_stays_flat():
    state = work(np.full((3, 40, 40), 0.7))
    sharpen(state, 1.0)
    np.testing.assert_allclose(state.signal, 0.7, rtol=1e-12)


def test_noise_grows_as_told():
    noise = 0.01 * np.random.default_rng(0).standard_normal((1, 256, 256))
    state = work(1 + noise)
    factor = sharpen(state, 0.6)
    assert 1.2 < factor == pytest.approx(100 * float(state.signal.std()), rel=0.02)


def test_light_is_not_negative():
    """A point that was never blurred rings."""
    point = np.zeros((1, 32, 32))
    point[0, 16, 16] = 1
    state = work(point)
    sharpen(state, 1.0)
    assert state.signal.min() == 0 and state.signal.max() > 1


def test_the_filter_is_one_at_frequency_zero_and_never_beyond_its_limit():
    filtered = wiener((64, 64), 1.5)
    assert filtered[0, 0] == pytest.approx(1) and filtered.max() < 6 and filtered.min() > 0


def test_what_comes_from_masked_pixels_is_masked():
    mask = np.ones((1, 32, 32), bool)
    mask[0, 10, 20] = False
    state = work(np.ones((1, 32, 32)), mask)
    sharpen(state, 0.5)
    assert (~state.mask).sum() == 9 and not state.mask[0, 9:12, 19:22].any()


def test_a_capture_is_sharpened_last(caustic):
    blurred = seen(caustic, 0.75).astype(np.float32)
    plain, sharp = (
        capture_to_irradiance(ImageFile(blurred, None, 32, "npy"), scene=SCENE, blur_px=blur_px)
        for blur_px in (None, 0.75)
    )
    assert sharp.steps[-1].startswith("blur of 0.75 pixels") and len(sharp.steps) == len(plain.steps) + 1
    expected = seen(caustic, 0.0)
    assert np.abs(sharp.irradiance - expected).mean() < 0.3 * np.abs(plain.irradiance - expected).mean()
    assert (sharp.noise_std > 1.3 * plain.noise_std).all()
