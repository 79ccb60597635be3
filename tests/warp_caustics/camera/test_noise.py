"""What is drawn has the statistics it says: shot and read noise, steps, saturation, speckle, dust, hot pixels."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import SensorConfig
from warp_caustics.camera.defects import dust, hot_pixels
from warp_caustics.camera.exposure import exposed, read_out
from warp_caustics.camera.speckle import speckle


def rng(seed=0):
    return torch.Generator().manual_seed(seed)


def even(level, size=512, dtype=torch.float64):
    return torch.full((size, size), level, dtype=dtype)


# --------------------------------------------------------------------- electrons


@pytest.mark.parametrize("light", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shot_noise_has_the_variance_of_its_electrons(light, dtype):
    """And the mean; of 262144 pixels the variance is known to 0.3 %."""
    sensor = SensorConfig(exposure=0.1, full_well_electrons=10_000, bits=None)
    electrons = exposed(even(light, dtype=dtype), sensor, 1.0, rng()) * 10_000
    expected = 1000 * light
    assert float(electrons.mean()) == pytest.approx(expected, abs=5 * np.sqrt(expected) / 512)
    assert float(electrons.var()) == pytest.approx(expected, rel=0.015)
    assert torch.equal(electrons.round(), electrons.round().clamp(min=0))


def test_read_noise_adds_to_shot_noise():
    sensor = SensorConfig(
        exposure=0.1, full_well_electrons=10_000, read_noise_electrons=40.0, black_level=0.05, bits=None
    )
    lit = exposed(even(1.0), sensor, 1.0, rng()) * 10_000
    assert float(lit.var()) == pytest.approx(1000 + 1600, rel=0.015)
    dark = exposed(even(0.0), sensor, 1.0, rng(1)) * 10_000
    assert float(dark.mean()) == pytest.approx(500, abs=0.5) and float(dark.std()) == pytest.approx(40, rel=0.01)


def test_the_mean_of_exposures_has_less_noise():
    sensor = SensorConfig(exposure=0.1, full_well_electrons=10_000, read_noise_electrons=10.0, bits=None)
    mean = exposed(even(1.0, 256), sensor, 1.0, rng(), frames=16) * 10_000
    assert float(mean.var()) == pytest.approx((1000 + 100) / 16, rel=0.03)


def test_neighbours_have_noise_of_their_own():
    sensor = SensorConfig(exposure=0.1, full_well_electrons=10_000, bits=None)
    noise = exposed(even(1.0), sensor, 1.0, rng()) - 0.1
    assert abs(float((noise[:, 1:] * noise[:, :-1]).mean() / noise.var())) < 0.01


def test_the_level_is_the_light_that_fills_the_exposure():
    """Twice the radiosity, twice the level: the same photo."""
    sensor = SensorConfig(exposure=0.25)
    assert exposed(even(3.0, 4), sensor, 3.0, rng())[0, 0] == pytest.approx(0.25, abs=1e-5)
    assert exposed(even(6.0, 4), sensor, 3.0, rng())[0, 0] == pytest.approx(0.5, abs=1e-5)


# --------------------------------------------------------------------- converter


@pytest.mark.parametrize("bits", [1, 4, 10])
def test_the_converter_has_its_steps(bits):
    """All of them are reached, nothing lies between, and the error is that of rounding: a step over root 12."""
    ramp = torch.linspace(0, 1, 200_001, dtype=torch.float64)
    values = read_out(ramp, SensorConfig(bits=bits))
    steps = 2**bits - 1
    assert len(values.unique()) == steps + 1
    assert (values * steps - (values * steps).round()).abs().max() < 1e-12
    assert float((values - ramp).std()) == pytest.approx(1 / steps / np.sqrt(12), rel=0.01)


def test_what_is_too_bright_saturates():
    """The share is that of the light above what is left above the black level."""
    sensor = SensorConfig(exposure=1.0 - 0.2, black_level=0.2, full_well_electrons=1e6, bits=12)
    ramp = torch.linspace(0, 4, 40_001, dtype=torch.float64)[None]
    values = exposed(ramp, sensor, 1.0, rng())
    assert float((values >= 1).double().mean()) == pytest.approx(0.75, abs=2e-3)
    assert values.max() == 1.0 and values.min() >= 0.2 - 1e-3
    assert float(values[0, 0]) == pytest.approx(0.2, abs=1e-3)


def test_light_below_zero_is_none():
    """Interpolation between sharp lines may go below; electrons do not."""
    sensor = SensorConfig(exposure=0.5, full_well_electrons=1000)
    assert exposed(even(-0.3, 8), sensor, 1.0, rng()).max() == 0


# --------------------------------------------------------------------- speckle


@pytest.mark.parametrize("contrast", [0.02, 0.05, 0.3])
@pytest.mark.parametrize("width", [0.8, 1.2, 3.0])
def test_speckle_has_its_contrast_and_its_width(contrast, width):
    factors = torch.stack([speckle((512, 512), contrast, width, rng(seed), torch.float64) for seed in range(6)])
    assert factors.min() > 0
    # So many independent grains lie in the images.
    grains = 6 * 512**2 / (4 * np.pi * width**2)
    assert float(factors.mean()) == pytest.approx(1.0, abs=5 * contrast / np.sqrt(grains))
    assert float(factors.std()) == pytest.approx(contrast, rel=5 / np.sqrt(grains) + 0.005)
    g = torch.log(factors)
    g = g - g.mean()
    for distance in (1, 2, 4):
        for axis in (-1, -2):
            along = g.narrow(axis, 0, 512 - distance) * g.narrow(axis, distance, 512 - distance)
            expected = np.exp(-(distance**2) / (4 * width**2))
            assert float(along.mean() / g.square().mean()) == pytest.approx(expected, abs=6 / np.sqrt(grains))


def test_speckle_is_as_strong_at_the_border():
    factors = speckle((4000, 16, 16), 0.1, 2.0, rng(), torch.float32)
    spread = factors.std(dim=0)
    assert (spread / 0.1 - 1).abs().max() < 0.08


def test_channels_have_speckle_of_their_own():
    first, second = speckle((2, 256, 256), 0.1, 1.0, rng(), torch.float64)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.05


# --------------------------------------------------------------------- dust and hot pixels


def test_dust_takes_what_it_says():
    sensor = SensorConfig(dust_radius_px=(3.0, 3.0), dust_depth=(0.4, 0.4))
    passed = dust(sensor, 1, 200, 300, rng(4), torch.float64)
    assert passed.shape == (200, 300) and float(passed.min()) == pytest.approx(0.6)
    # The area of a grain whose edge fades over a pixel.
    assert float((1 - passed).sum() / 0.4) == pytest.approx(np.pi * (9 + 1 / 12), rel=0.02)
    assert float((passed < 0.8).double().sum()) == pytest.approx(np.pi * 9, rel=0.25)


def test_grains_lie_anywhere_and_in_their_ranges():
    sensor = SensorConfig(dust_radius_px=(1.0, 4.0), dust_depth=(0.1, 0.6))
    passed = dust(sensor, 400, 1000, 1000, rng(), torch.float64)
    taken = 1 - passed
    mean_area = np.pi * (np.mean(np.linspace(1, 4, 1001) ** 2) + 1 / 12)
    assert float(taken.sum()) == pytest.approx(400 * 0.35 * mean_area, rel=0.15)
    quarters = [
        taken[rows, columns].sum()
        for rows in (slice(500), slice(500, None))
        for columns in (slice(500), slice(500, None))
    ]
    assert min(quarters) > 0.6 * max(quarters)
    assert torch.equal(dust(sensor, 0, 10, 10, rng(), torch.float64), torch.ones(10, 10, dtype=torch.float64))


def test_hot_pixels_are_as_many_and_as_hot_as_said():
    sensor = SensorConfig(hot_pixels=500, hot_level=(0.1, 0.4))
    hot = hot_pixels(sensor, (3, 100, 100), rng(), torch.float64)
    found = hot[hot > 0]
    assert len(found) == 500 and found.min() >= 0.1 and found.max() <= 0.4
    assert float(found.mean()) == pytest.approx(0.25, abs=0.02)
    assert len(hot_pixels(sensor, (10, 10), rng(), torch.float64).nonzero()) == 100, "no more than there are"
