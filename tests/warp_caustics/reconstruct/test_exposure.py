"""Exposure from the sum of the light: closed forms, noise, masks, and when it is not to be believed."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.exposure import agreed_ratio, at_nominal, exposure_warning, is_exposure, light_ratio
from warp_caustics.reconstruct.pyramid import measurement_at

SCENE = Scene(height_samples=32, image_pixels=64, radiosity_W_m2=(1.0, 2.0, 0.5))
CPU = torch.device("cpu")
RADIOSITY = torch.tensor(SCENE.radiosity_W_m2)[:, None, None]


def bump(height_m, at=0.0):
    x = np.linspace(-1, 1, 32)
    return torch.tensor(height_m * np.exp(-20 * ((x[None] - at) ** 2 + x[:, None] ** 2)), dtype=torch.float32)


def simulated(heights):
    with torch.no_grad():
        return CausticSimulator(SCENE)(heights)


def seen(heights, exposure=(1.0, 1.0, 1.0), noise=0.0, mask=None):
    irradiance = simulated(heights).numpy() * np.asarray(exposure, dtype=np.float32)[:, None, None]
    irradiance = irradiance + noise * np.random.default_rng(0).standard_normal(irradiance.shape).astype(np.float32)
    return CausticImage(irradiance, np.full(3, noise) if noise else None, mask)


def ratio(image, heights=None):
    relative = None if heights is None else simulated(heights) / RADIOSITY
    return light_ratio(measurement_at(image, SCENE, 64, CPU), relative)


@pytest.mark.parametrize("exposure", [(1.0, 1.0, 1.0), (0.95, 0.95, 0.95), (1.3, 1.0, 0.8)])
def test_the_right_relief_tells_it_exactly(exposure):
    np.testing.assert_allclose(ratio(seen(bump(4e-4), exposure), bump(4e-4)), exposure, rtol=1e-6)


def test_a_wrong_relief_tells_it_too():
    """A plate moves light about; 4096 pixels with 2 % of noise tell the sum to 3e-4."""
    found = ratio(seen(bump(4e-4), (0.95, 1.05, 1.0), noise=0.01), bump(3e-4, at=0.1))
    np.testing.assert_allclose(found, (0.95, 1.05, 1.0), atol=1.5e-3)


def test_flat_light_needs_no_simulation():
    np.testing.assert_allclose(ratio(seen(bump(4e-4), (0.9, 0.9, 0.9))), 0.9, rtol=2e-3)


def test_dark_wavelengths_and_single_masked_pixels_do_not_count():
    image = seen(bump(4e-4), (0.95, 0.95, 0.95))
    measurement = measurement_at(image, SCENE, 64, CPU)
    assert measurement.weight.bool().all()
    image.irradiance[1] = 0.0
    np.testing.assert_allclose(ratio(image, bump(4e-4)), [0.95, 1.0, 0.95], rtol=1e-6)
    large = SCENE.model_copy(update={"image_pixels": 256})
    with torch.no_grad():
        irradiance = 0.95 * CausticSimulator(large)(bump(4e-4)).numpy()
    mask = np.ones(irradiance.shape, dtype=bool)
    mask[:, 100, 100:104] = False
    irradiance[~mask] = 100.0
    found = light_ratio(measurement_at(CausticImage(irradiance, mask=mask), large, 256, CPU))
    np.testing.assert_allclose(found, 0.95, rtol=2e-3)


def test_saturated_lines_are_no_lack_of_light():
    """They are masked, and with them more light than a flat plate sends there."""
    image = seen(bump(8e-3))
    bright = image.irradiance < np.quantile(image.irradiance, 0.98, axis=(1, 2), keepdims=True)
    masked = CausticImage(image.irradiance, mask=bright)
    share = image.irradiance[~bright].sum() / image.irradiance.sum()
    assert share > 0.04 and (~bright).mean() < 0.021
    np.testing.assert_array_equal(ratio(masked), 1.0)
    np.testing.assert_array_equal(ratio(masked, bump(6e-3)), 1.0)


def test_nominal_image():
    image, exposure = seen(bump(4e-4), (0.5, 2.0, 1.0), noise=0.01), np.array([0.5, 2.0, 1.0])
    nominal = at_nominal(image, exposure)
    np.testing.assert_allclose(nominal.irradiance * exposure[:, None, None], image.irradiance)
    np.testing.assert_allclose(nominal.noise_std, [0.02, 0.005, 0.01])


@pytest.mark.parametrize(
    ("by_relief", "by_flat", "expected"),
    [
        (0.953, 0.95, 0.953),  # alike: the relief knows what is lost
        (1.30, 1.0, 1.0),  # a relief that loses light which the image has
        (1.0, 0.9, 1.0),  # a plate that loses light
        (1.2, 1.05, 1.05),
        (0.8, 0.95, 0.95),
        (1.1, 0.9, 1.0),
    ],
)
def test_only_what_both_say_is_believed(by_relief, by_flat, expected):
    assert agreed_ratio(np.array([by_relief]), np.array([by_flat])) == pytest.approx([expected])


def test_what_is_no_exposure():
    assert not is_exposure(np.array([1.0, 1.0001, 0.9999]))
    assert is_exposure(np.array([1.0, 1.0003, 1.0]))
    assert not is_exposure(np.array([1.03, 0.97, 1.0]), 0.05)
    assert not is_exposure(np.array([200.0, 180.0, 190.0]))
    assert exposure_warning(np.array([1.0, 1.005, 1.0])) is None
    assert "94.00%, 100.00%, 95.00%" in exposure_warning(np.array([0.94, 1.0, 0.95]))
