"""Noise of measurements, grain and all."""

import numpy as np
import pytest
import torch

from tests.warp_caustics.io.test_grain import picture
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.image_noise import NoiseOfLight, estimated_grain, estimated_noise, with_grain
from warp_caustics.reconstruct.pyramid import measurement_at
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=256)
CPU = torch.device("cpu")


def taken(grain):
    image = CausticImage(np.stack([picture(seed, 0.015, grain) for seed in range(3)]).astype(np.float32))
    return CausticImage(image.irradiance, estimated_noise(image, SCENE))


def test_bright_light_is_as_uncertain_as_its_grain():
    """On all pixels, and on means over four by four, of which grain leaves half."""
    image = taken(0.03)
    grain = estimated_grain(image, SCENE)
    assert grain == pytest.approx(0.03, rel=0.15)
    for pixels, share in ((256, 1.0), (128, 1.0), (64, 0.5)):
        plain = measurement_at(image, SCENE, pixels, CPU)
        found = with_grain(plain, image, SCENE)
        own = torch.tensor(share * grain)[:, None, None] * plain.irradiance
        torch.testing.assert_close(found.noise.square(), plain.noise.square() + own.double().square())
        assert found.weight is plain.weight


def test_white_noise_and_noise_that_is_not_known_stay_as_they_are():
    image = taken(0.0)
    plain = measurement_at(image, SCENE, 256, CPU)
    assert with_grain(plain, image, SCENE) is plain
    unknown = CausticImage(image.irradiance)
    blank = measurement_at(unknown, SCENE, 256, CPU)
    assert with_grain(blank, unknown, SCENE) is blank and not estimated_grain(unknown, SCENE).any()


def test_a_channel_without_light_has_no_grain():
    dark = SCENE.model_copy(update={"radiosity_W_m2": (1.0, 0.0, 1.0)})
    grain = estimated_grain(taken(0.03), dark)
    assert grain[1] == 0 and grain[0] > 0.02 and grain[2] > 0.02


def test_noise_by_the_light_is_that_of_a_measurement_but_for_its_own_noise():
    image = taken(0.03)
    plain = measurement_at(image, SCENE, 256, CPU)
    told = NoiseOfLight.of(image, SCENE, CPU)
    torch.testing.assert_close(told(plain.irradiance.double()), with_grain(plain, image, SCENE).noise)
    even = told(torch.ones(3, 256, 256, dtype=torch.float64))
    assert float(even.std()) < 1e-12 + float(told.grain.std()) + float(told.own.std())
    np.testing.assert_allclose(
        even[:, 0, 0], np.hypot(image.noise_std / np.asarray(SCENE.radiosity_W_m2), 0.03), rtol=0.15
    )
