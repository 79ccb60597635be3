"""Planted noise is found, and smoothing a calibration frame leaves its shape."""

import numpy as np
import pytest

from warp_caustics.io import estimate_noise_std
from warp_caustics.io.noise import smooth_frame

from .model_camera import Camera, M, caustic_light, smooth_light


@pytest.mark.parametrize("light", [smooth_light(), caustic_light()], ids=["smooth", "caustic"])
@pytest.mark.parametrize("std", [0.003, 0.01, 0.05])
def test_planted_noise_is_found(light: np.ndarray, std: float) -> None:
    found = [
        estimate_noise_std(light + np.random.default_rng(seed).normal(0, std, light.shape), 1.0) for seed in range(4)
    ]
    np.testing.assert_allclose(found, std, rtol=0.15)


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


def test_smoothing_a_flat_field_has_no_bias_at_the_border() -> None:
    """A Gaussian of 4 pixels would be off by 1.2 % there; the cubic part of the vignetting alone leaves 2.5e-4."""
    truth = 5000 * Camera().response()
    smooth, _ = smooth_frame(truth)
    assert np.abs(smooth / truth - 1).max() < 3e-4
    noise = np.random.default_rng(4).normal(0, 50, truth.shape)
    error = smooth_frame(truth + noise)[0] - truth
    assert error[20:-20, 20:-20].std() < 50 / 7
    assert error[:1].std() < 50 / 3
