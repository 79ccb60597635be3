"""Fold fractions of plates whose light map is known."""

import numpy as np
import pytest

from warp_caustics.fold_fraction import crossing_samples, fold_bin, fold_bins, fold_fraction, jacobian_determinants
from warp_caustics.height_field import cell_centres
from warp_caustics.scene import Scene

DISTANCE_M = 0.5


@pytest.fixture(scope="module")
def far_scene():
    """One wavelength, a screen far below: slopes of one percent cross, and optics stays paraxial."""
    return Scene(
        height_samples=64, image_pixels=16, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,), glass=1.5,
        screen_position_m=(0.0, 0.0, -DISTANCE_M),
    )  # fmt: skip


def ripple(scene, strength):
    """A cosine along x whose map x - strength sin(k x) / k folds where cos(k x) > 1 / strength."""
    k = 2 * np.pi / 0.05
    power = 0.5 * DISTANCE_M + (1 - 1 / 1.5) * scene.base_thickness_m
    x = cell_centres(scene.height_samples, scene.plate_size_m[0])
    return np.tile(strength / (power * k**2) * np.cos(k * x), (scene.height_samples, 1))


@pytest.mark.parametrize("strength", [0.8, 1.5, 3.0])
def test_folds_of_a_ripple(far_scene, strength):
    """det = 1 - strength cos(k x): negative on arccos(1 / strength) / pi of the plate."""
    expected = np.arccos(1 / strength) / np.pi if strength > 1 else 0.0
    assert fold_fraction(ripple(far_scene, strength), far_scene) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("strength", [0.8, 2.0])
def test_samples_at_which_paths_cross(far_scene, strength):
    """Where det = 1 - strength cos(k x) is negative, and samples that this begins in."""
    found = crossing_samples(ripple(far_scene, strength), far_scene)
    x = cell_centres(far_scene.height_samples, far_scene.plate_size_m[0])
    crossing = strength * np.cos(2 * np.pi / 0.05 * x) > 1
    assert found.shape == (64, 64) and found.dtype == bool and (found == found[0]).all()
    inside = slice(2, -2)
    assert found[0, inside][crossing[inside]].all() and found.sum() <= 64 * (crossing.sum() + 4)


def test_determinant_of_a_ripple(far_scene):
    """Point by point, away from the edges, where the spline goes on without a slope."""
    found = jacobian_determinants(ripple(far_scene, 2.0), far_scene)
    x = cell_centres(found.shape[1], far_scene.plate_size_m[0])
    inner = np.abs(x) < 0.02
    expected = 1 - 2.0 * np.cos(2 * np.pi / 0.05 * x[inner])
    np.testing.assert_allclose(found[:, inner], np.broadcast_to(expected, (len(found), inner.sum())), atol=0.02)


def test_both_axes_agree(far_scene):
    heights = ripple(far_scene, 2.0)
    np.testing.assert_allclose(
        jacobian_determinants(heights.T, far_scene), jacobian_determinants(heights, far_scene).T, atol=1e-12
    )


def test_flat_plate_maps_light_straight_down(tiny_scene):
    np.testing.assert_allclose(jacobian_determinants(np.full((16, 16), 1e-3), tiny_scene), 1.0, atol=1e-12)


def test_reflected_light_does_not_count(tiny_scene):
    """A steep plane sends all light into total reflection at the bottom face."""
    x = cell_centres(16, tiny_scene.plate_size_m[0])
    steep = np.tile(40.0 * x + 1.0, (16, 1))
    inner = jacobian_determinants(steep, tiny_scene)[8:-8, 8:-8]
    assert np.isnan(inner).all()
    assert fold_fraction(steep, tiny_scene) < 0.5


def test_bins_are_in_order():
    assert [fold_bin(fraction) for fraction in (0.0, 0.05, 0.5)] == list(fold_bins())
    assert len(set(fold_bins())) == 3
