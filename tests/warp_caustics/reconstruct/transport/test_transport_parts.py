"""What turns a map of light into heights: refraction backwards, integration, the bare plate, the light itself."""

import numpy as np
import pytest
import scipy.fft
import torch

from warp_caustics import Scene
from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.oracle import screen_position, spline_coefficients, surface_height
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.transport.integrate_normals import heights_of, integrate_slopes, plate_bend
from warp_caustics.reconstruct.transport.light import light_of
from warp_caustics.reconstruct.transport.ray_inversion import MAX_SLOPE, LightPath
from warp_caustics.reconstruct.transport.transport import relief_on_grid

SCENES = {
    "contact": Scene(height_samples=8, image_pixels=8),
    "far, air": Scene(height_samples=8, image_pixels=8, screen_position_m=(0, 0, -0.05)),
    "far, glass": Scene(height_samples=8, image_pixels=8, screen_position_m=(0, 0, -0.02), exit_medium="glass"),
    "point source": Scene(
        height_samples=8, image_pixels=8, emission_half_angle_rad=0.3, light_position_m=(0.01, -0.02, 0.2),
        screen_position_m=(0, 0, -0.01), exit_medium=1.33,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_slopes_are_the_inverse_of_the_oracle_trace(name):
    """Points of a rough relief: the landing of the oracle, and from it the slope back, to 1e-9."""
    scene, channel = SCENES[name], 1
    random = np.random.default_rng(3)
    coefficients = spline_coefficients(torch.from_numpy(random.uniform(0, 2e-3, (8, 8))))
    points = torch.from_numpy(random.uniform(-0.02, 0.02, (50, 2)))
    height = torch.vmap(lambda p: surface_height(p, coefficients, scene))(points).numpy()
    slope = torch.vmap(torch.func.jacfwd(lambda p: surface_height(p, coefficients, scene)))(points).numpy().T
    landing = torch.vmap(lambda p: screen_position(p, coefficients, scene, channel))(points).numpy().T
    light = None if scene.is_collimated else scene.light_position_m
    indices = scene.glass_indices[channel], scene.exit_indices[channel]
    path = LightPath(*indices, scene.base_thickness_m, -scene.screen_position_m[2], light)
    assert np.abs(slope).max() > 0.1
    np.testing.assert_allclose(path.landing(points.numpy().T, height, slope), landing, atol=1e-15)
    found, limited = path.slopes_towards(points.numpy().T, height, landing)
    np.testing.assert_allclose(found, slope, atol=1e-9)
    assert limited == 0


def test_light_that_cannot_go_so_far_meets_the_limit():
    """3 mm of glass refract light by at most 46.8 degrees; 1 cm sideways is out of reach."""
    path = LightPath.of_scene(Scene())
    slopes, limited = path.slopes_towards(np.zeros((2, 2)), np.zeros(2), np.array([[0.01, 1e-4], [0.0, 0.0]]))
    assert limited == 0.5
    np.testing.assert_allclose(slopes[0, 0], MAX_SLOPE)
    assert 0 < slopes[0, 1] < 0.2


def test_mean_index_of_the_wavelengths_that_shine():
    scene = Scene(radiosity_W_m2=(1.0, 0.0, 1.0))
    expected = np.mean([scene.glass_indices[0], scene.glass_indices[2]])
    assert LightPath.of_scene(scene).glass == pytest.approx(expected, rel=1e-15)
    single = LightPath.of_scene(scene, single_refraction=True)
    assert single.outside == single.glass != LightPath.of_scene(scene).outside


def test_integration_is_exact_for_cosines():
    """Heights of a few cosine modes on a plate that is no square, from their exact slopes, to rounding."""
    count, size = 48, (0.05, 0.03)
    x, y = np.meshgrid(*(cell_centres(count, length) + length / 2 for length in size))
    heights, slopes = np.zeros((count, count)), np.zeros((2, count, count))
    for a, b, amplitude in ((1, 0, 1e-3), (0, 4, 2e-4), (7, 3, 5e-4), (20, 11, 1e-5)):
        k, q = a * np.pi / size[0], b * np.pi / size[1]
        heights += amplitude * np.cos(k * x) * np.cos(q * y)
        slopes[0] -= amplitude * k * np.sin(k * x) * np.cos(q * y)
        slopes[1] -= amplitude * q * np.cos(k * x) * np.sin(q * y)
    spectrum = integrate_slopes(slopes, size)
    np.testing.assert_allclose(heights_of(spectrum, count), heights, atol=1e-15)
    # Coarser and finer samples of the same cosines.
    fine = heights_of(spectrum, 96)
    np.testing.assert_allclose(heights_of(scipy.fft.dctn(fine, norm="ortho"), count), heights, atol=1e-15)


def test_a_quadratic_lens_from_its_map():
    """A map that shrinks the plate by 0.5 % belongs to a lens; for so weak a one its height is a parabola.

    x -> x (1 - m) needs the slope -m x / ((1 - 1/n) d) for small slopes.
    """
    scene, shrink, count = Scene(), 5e-3, 256
    path = LightPath.of_scene(scene)
    points = np.stack(np.meshgrid(*[cell_centres(count, 0.05)] * 2))
    slopes, _ = path.slopes_towards(points, np.zeros((count, count)), (1 - shrink) * points)
    strength = (1 - 1 / path.glass) * scene.base_thickness_m
    np.testing.assert_allclose(slopes, -shrink * points / strength, rtol=0.02, atol=1e-12)
    heights = heights_of(integrate_slopes(slopes, (0.05, 0.05)), count)
    parabola = -shrink * (points**2).sum(0) / (2 * strength)
    inner = slice(count // 8, -count // 8)
    error = (heights - parabola)[inner, inner]
    assert np.ptp(error) < 0.02 * np.ptp(parabola[inner, inner])


def test_no_slopes_no_heights():
    assert not integrate_slopes(np.zeros((2, 16, 16)), (0.05, 0.05)).any()


def test_spline_on_a_grid_is_the_oracles():
    scene = Scene(height_samples=8, image_pixels=8)
    heights = np.random.default_rng(1).uniform(0, 1e-3, (8, 8))
    value, slopes = relief_on_grid(heights, 12, scene.plate_size_m)
    coefficients = spline_coefficients(torch.from_numpy(heights))
    centres = cell_centres(12, 0.05)
    for row, column in ((0, 0), (5, 2), (11, 7)):
        point = torch.tensor([centres[column], centres[row]])
        assert value[row, column] == pytest.approx(float(surface_height(point, coefficients, scene)), abs=1e-13)
        slope = torch.func.jacfwd(surface_height)(point, coefficients, scene)
        np.testing.assert_allclose(slopes[:, row, column], slope.numpy(), atol=1e-11)


def test_bend_of_a_plate_with_lines_is_found():
    """30 um of bend under 0.3 mm lines: found to 1 um, as it is where the plate is bare."""
    n, size = 128, (0.05, 0.05)
    lines = [Line((-0.02, -0.01), (0.02, 0.015), 3e-3, 3e-4), Line((-0.01, 0.02), (0.015, -0.02), 3e-3, 2e-4)]
    relief = line_relief(lines, n, size)
    x, y = np.meshgrid(*[cell_centres(n, 0.05)] * 2)
    bend = 20e-6 * np.cos(np.pi * (x / 0.05 + 0.5)) + 10e-6 * np.cos(2 * np.pi * (y / 0.05 + 0.5)) - 1e-4
    found = plate_bend(relief + bend, size, 0.95e-3)
    assert np.abs(found - bend).max() < 1e-6


def test_a_wide_relief_does_not_bend_its_plate():
    """The foot of a bump 6 mm wide is no bend: where slow modes see none, fast ones may not either."""
    x, y = np.meshgrid(*[cell_centres(128, 0.05)] * 2)
    found = plate_bend(3e-4 * np.exp(-(x**2 + y**2) / (2 * 3e-3**2)), (0.05, 0.05), 0.95e-3)
    assert np.abs(found).max() < 3e-6


def test_a_bend_is_found_by_one_thread(monkeypatch):
    """Its sixty systems are small: where others work, two threads wait for each other most of the time."""
    threads, solve = set(), torch.linalg.solve

    def counted(*arguments):
        threads.add(torch.get_num_threads())
        return solve(*arguments)

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        monkeypatch.setattr(torch.linalg, "solve", counted)
        plate_bend(np.random.default_rng(1).uniform(0, 1e-4, (32, 32)), (0.05, 0.05), 0.95e-3)
        assert threads == {1} and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


SMALL = Scene(height_samples=16, image_pixels=32)


def test_light_is_the_mean_over_what_is_valid():
    """Dim channels count like bright ones; masked pixels take the other channels, then the nearest pixel."""
    scene = SMALL.model_copy(update={"radiosity_W_m2": (1.0, 0.1, 2.0)})
    irradiance = np.array(scene.radiosity_W_m2)[:, None, None] * np.full((3, 32, 32), 1.0)
    mask = np.ones(irradiance.shape, bool)
    mask[0, 10, 10] = False
    mask[:, 20, 20] = False
    irradiance[0, 10, 10] = irradiance[1, 20, 20] = 77.0
    light = light_of(CausticImage(irradiance, None, mask), scene, 16)
    np.testing.assert_allclose(light.density, 1.0, rtol=1e-12)
    assert light.balance == pytest.approx(1) and light.warnings == ()


def test_border_is_not_believed():
    """The outermost ring is that of its inner neighbours."""
    irradiance = np.ones((3, 32, 32))
    irradiance[:, 0], irradiance[:, :, -1] = 0.3, 5.0
    np.testing.assert_allclose(light_of(CausticImage(irradiance), SMALL, 32).density, 1.0, rtol=1e-12)


def test_dark_channel_is_left_out_with_a_warning():
    irradiance = np.ones((3, 32, 32))
    irradiance[2] = 1e-4
    light = light_of(CausticImage(irradiance), SMALL, 32)
    assert light.scene.wavelengths_m == SMALL.wavelengths_m[:2]
    assert light.balance == pytest.approx(1)
    assert "430 nm" in light.warnings[0] and len(light.warnings) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: image.__setitem__((slice(None), slice(4)), -0.5), "negative"),
        (lambda image: image.__imul__(0.5), "exposure"),
    ],
)
def test_odd_light_is_warned_of(change, words):
    irradiance = np.ones((3, 32, 32))
    change(irradiance)
    light = light_of(CausticImage(irradiance), SMALL, 32)
    assert any(words in warning for warning in light.warnings)
    assert light.density.min() >= 0


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (CausticImage(np.full((3, 32, 32), 1e-5)), "less than 0.01"),
        (CausticImage(np.zeros((3, 32, 32))), "nothing to see"),
        (CausticImage(np.ones((3, 32, 32)), None, np.zeros((3, 32, 32), bool)), "masked"),
    ],
)
def test_no_light_is_refused(image, words):
    with pytest.raises(InputError, match=words):
        light_of(image, SMALL, 32)
