"""Limits, smoothness, strength, distance and figures of a design, each against a closed form."""

import math

import numpy as np
import pytest
import torch

from warp_caustics.design.descent import EARLY_SMOOTHNESS, level_smoothness
from warp_caustics.design.distance import FARTHEST_M, NEAREST_M, USED_SHARE, at_distance, least_distance
from warp_caustics.design.judgement import finest_period_m, picture_figures, relief_figures
from warp_caustics.design.limits import MARGIN, bounded
from warp_caustics.design.smoothness import bending_energy, focusing_strength_m
from warp_caustics.design.start import carry_even_light, relief_of
from warp_caustics.height_field import cell_centres
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

CPU = torch.device("cpu")
SCENE = at_distance(Scene(height_samples=32, image_pixels=64), 0.1)


def blob(m, row, column, width, floor=0.3):
    """Smooth spot of light, mean 1."""
    i, j = np.mgrid[:m, :m]
    spot = np.exp(-((i - row) ** 2 + (j - column) ** 2) / (2 * width**2))
    return floor + (1 - floor) * spot / spot.mean()


def test_bounded_heights_keep_the_limit_whatever_comes():
    heights = bounded(torch.linspace(-1, 1, 1001, dtype=torch.float64), 1e-3)
    assert heights.min() == 0
    assert heights.max() == 1e-3
    assert (heights.diff() >= 0).all()


def test_bounded_heights_are_unchanged_inside_and_smooth_at_the_margin():
    inside = torch.linspace(MARGIN * 1e-3, (1 - MARGIN) * 1e-3, 100, dtype=torch.float64)
    torch.testing.assert_close(bounded(inside, 1e-3), inside)
    for edge in (MARGIN, 1 - MARGIN):
        around = torch.tensor([edge * 1e-3 - 1e-9, edge * 1e-3 + 1e-9], dtype=torch.float64, requires_grad=True)
        bounded(around, 1e-3).sum().backward()
        torch.testing.assert_close(around.grad, torch.ones(2, dtype=torch.float64), rtol=1e-4, atol=0)


def test_smoothness_falls_to_what_was_asked():
    weights = level_smoothness(1e-3, 4)
    assert weights[0] == pytest.approx(EARLY_SMOOTHNESS)
    assert weights[-1] == 1e-3
    np.testing.assert_allclose(np.diff(np.log(weights)), np.log(weights[1] / weights[0]))
    assert level_smoothness(0.0, 3)[-1] == 0
    assert level_smoothness(0.5, 2) == [0.5, 0.5]
    assert level_smoothness(1e-3, 1) == [1e-3]


def test_bending_energy_of_a_quadratic_surface():
    x, y = np.meshgrid(cell_centres(40, 0.05), cell_centres(40, 0.04))
    heights = torch.tensor(0.5 * 3 * x**2 - 0.5 * 2 * y**2 + 1.5 * x * y)
    energy = bending_energy(heights, (0.05 / 40, 0.04 / 40), 0.1)
    assert float(energy) == pytest.approx(0.1**2 * (3**2 + 2**2 + 2 * 1.5**2), rel=1e-9)


@pytest.mark.parametrize("distance_m", [1e-6, 0.05, 0.3])
def test_weak_relief_focuses_by_its_strength(distance_m):
    """E - 1 = -strength Laplacian(h): the simulator's contrast of a weak cosine."""
    scene = at_distance(
        Scene(height_samples=64, image_pixels=64, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,)), distance_m
    )
    strength = focusing_strength_m(LightPath.of_scene(scene))
    wave = 2 * math.pi * 4 / 0.05
    amplitude = 0.01 / (strength * wave**2)
    relief = amplitude * np.cos(wave * cell_centres(64, 0.05))[None, :] * np.ones((64, 1))
    image = CausticSimulator(scene, dtype=torch.float64)(torch.tensor(relief)).numpy()[0]
    contrast = 2 * ((image - 1) * np.cos(wave * cell_centres(64, 0.05)))[:, 8:-8].mean()
    assert contrast == pytest.approx(0.01, rel=0.03)


def test_twice_as_far_needs_half_the_relief():
    transport = carry_even_light(blob(64, 20, 40, 12), 16, CPU, 5, None)
    ranges = []
    for distance_m in (0.2, 0.4, 0.8):
        scene = at_distance(SCENE, distance_m)
        ranges.append(np.ptp(relief_of(transport, scene)[0]))
    assert ranges[0] / ranges[1] == pytest.approx(2, rel=0.03)
    assert ranges[1] / ranges[2] == pytest.approx(2, rel=0.03)


def test_chosen_distance_is_the_least_that_fits():
    transport = carry_even_light(blob(64, 28, 36, 12), 16, CPU, 5, None)
    limit_m = 5e-4
    distance_m = least_distance(transport, SCENE, limit_m)
    assert NEAREST_M < distance_m < FARTHEST_M
    assert distance_m == pytest.approx(round(distance_m, 2), abs=1e-12)
    at, nearer = (np.ptp(relief_of(transport, at_distance(SCENE, d))[0]) for d in (distance_m, distance_m - 0.02))
    assert at <= (1 - 2 * MARGIN) * limit_m, "nothing is compressed"
    assert nearer > USED_SHARE * limit_m


def test_even_picture_asks_for_the_nearest_distance_and_no_relief():
    transport = carry_even_light(np.ones((64, 64)), 32, CPU, 10, None)
    assert least_distance(transport, SCENE, 1e-3) == NEAREST_M
    assert np.ptp(relief_of(transport, SCENE)[0]) < 1e-9


def test_figures_of_the_target_itself():
    target = blob(64, 20, 40, 8)
    found = picture_figures(np.stack([target * r for r in SCENE.radiosity_W_m2]), target, SCENE)
    assert found["psnr_dB"] > 150
    assert found["ssim"] == pytest.approx(1)
    assert found["contrast_ratio"] == pytest.approx(1)
    assert found["light_in_bright"] == pytest.approx(found["target_light_in_bright"])
    assert found["target_light_in_bright"] > found["bright_area"]
    assert found["light_in_window"] == pytest.approx(1)


def test_figures_in_units_of_the_radiosity():
    """Twice the light on a dark channel and a bright one is the same picture."""
    scene = SCENE.model_copy(update={"radiosity_W_m2": (2.0, 0.0, 0.5)})
    target = blob(64, 20, 40, 8)
    image = target + np.zeros((3, 1, 1))
    found = picture_figures(image * np.array([2.0, 0.0, 0.5])[:, None, None], target, scene)
    assert found["psnr_dB"] > 150


def test_psnr_of_a_known_error():
    target = blob(64, 20, 40, 8)
    image = np.stack([target + 0.1] * 3)
    found = picture_figures(image, target, SCENE)
    assert found["psnr_dB"] == pytest.approx(20 * math.log10(target.max() / 0.1))


def test_relief_figures_of_a_sphere_like_bowl():
    """h = r^2 / (2 R): slope r / R, radius of curvature R."""
    radius = 0.2
    x, y = np.meshgrid(cell_centres(32, 0.05), cell_centres(32, 0.05))
    found = relief_figures((x**2 + y**2) / (2 * radius), SCENE)
    assert found["height_range_m"] == pytest.approx(2 * (0.025 * 31 / 32) ** 2 / (2 * radius), rel=0.01)
    assert found["max_slope"] == pytest.approx(math.hypot(0.025, 0.025) / radius, rel=0.05)
    assert found["smallest_radius_m"] == pytest.approx(radius, rel=0.1)
    assert 0 < found["total_reflection_share"] < 0.2


def test_total_reflection_is_reached_where_the_light_path_ends():
    """The share crosses 1 at the slope from which no light leaves the plate."""
    from warp_caustics.design.judgement import _sideways

    path = LightPath.of_scene(SCENE)
    for slope in (1.0, 5.0, 10.0, 20.0, 30.0, 50.0):
        landing = path.landing(np.zeros((2, 1)), np.zeros(1), np.array([[slope], [0.0]]))
        assert np.isfinite(landing).all() == (_sideways(slope, path) < path.outside), slope


def test_finest_period_is_that_of_the_wave():
    x = cell_centres(64, 0.05)
    relief = 1e-4 * np.cos(2 * math.pi * 5 * (x / 0.05 + 0.5))[None, :] * np.ones((64, 1))
    assert finest_period_m(relief, (0.05, 0.05)) == pytest.approx(0.01)
    assert finest_period_m(np.zeros((64, 64)), (0.05, 0.05)) is None
