"""Scores of reliefs with known errors."""

import numpy as np
import pytest
import scipy.ndimage

from nets.evaluation.fields import Field
from nets.evaluation.scores import SCORES, Scorer, relief_ssim
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene


@pytest.fixture(scope="module")
def scorer():
    return Scorer(Scene(height_samples=32, image_pixels=32), 20_000, "cpu")


@pytest.fixture(scope="module")
def hill():
    x = np.tile(np.linspace(-1, 1, 32), (32, 1))
    return 2e-3 * np.exp(-32 * (x**2 + x.T**2))


def plate(true, image=None, origin="simulated"):
    image = np.ones((3, 32, 32), np.float32) if image is None else image
    return Field("plate", true, CausticImage(image), 0.0, origin)


def test_scores_of_a_shift_and_a_tilt(scorer, hill):
    shifted = scorer(hill + 3e-6, plate(hill))
    assert set(shifted) == set(SCORES)
    assert shifted["rmse_um"] == pytest.approx(3.0)
    assert shifted["quantile95_um"] == pytest.approx(3.0)
    assert shifted["rmse_mean_removed_um"] == pytest.approx(0.0, abs=1e-9)
    assert shifted["slope_error"] == pytest.approx(0.0, abs=1e-12)
    slope = 0.01
    columns = np.arange(32) * scorer.scene.sample_pitch_m[0]
    assert scorer(hill + slope * columns, plate(hill))["slope_error"] == pytest.approx(slope)


def test_image_error_is_that_of_the_clean_image(scorer, hill):
    """0 for the truth, whatever noise its image has; and against a given image, that image counts."""
    assert scorer(hill, plate(hill))["image_error"] == pytest.approx(0.0, abs=1e-6)
    flat = np.zeros((32, 32))
    as_flat = scorer(flat, plate(hill))["image_error"]
    assert as_flat > 0.03
    given = plate(hill, origin="file")
    assert scorer(flat, given)["image_error"] == pytest.approx(0.0, abs=1e-4)
    deviation = np.linalg.norm(scorer._image(hill) - 1) / np.sqrt(3 * 32 * 32)
    assert scorer(hill, given)["image_error"] == pytest.approx(deviation, rel=1e-5)


def test_ssim_follows_its_formula():
    """Wang et al. 2004 with a Gaussian of 1.5 samples cut at 5, population covariance, range of the true heights."""
    rng = np.random.default_rng(1)
    true = rng.normal(size=(24, 24)) * 1e-4 + 5e-4
    found = true + rng.normal(size=true.shape) * 3e-5

    def mean(values):
        return scipy.ndimage.gaussian_filter(values, 1.5, radius=5)

    c1, c2 = (0.01 * np.ptp(true)) ** 2, (0.03 * np.ptp(true)) ** 2
    covariance = mean(true * found) - mean(true) * mean(found)
    variances = mean(true**2) - mean(true) ** 2 + mean(found**2) - mean(found) ** 2
    means = (2 * mean(true) * mean(found) + c1) / (mean(true) ** 2 + mean(found) ** 2 + c1)
    expected = (means * (2 * covariance + c2) / (variances + c2))[5:-5, 5:-5].mean()
    assert relief_ssim(found, true) == pytest.approx(expected, rel=1e-9)
    assert relief_ssim(true, true) == pytest.approx(1.0)


def test_ssim_is_not_defined_for_flat_and_tiny_reliefs():
    assert relief_ssim(np.ones((24, 24)), np.zeros((24, 24))) is None
    assert relief_ssim(np.ones((10, 10)), np.eye(10)) is None
