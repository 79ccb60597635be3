"""Closed forms, symmetry and energy: what must hold whatever the implementation."""

import math

import numpy as np
import pytest
import torch

from data_gen.config import ReliefConfig
from data_gen.patterns import draw_strokes, padded
from data_gen.reliefs import print_strokes
from warp_caustics import CausticSimulator, Scene
from warp_caustics.energy import energy_budget
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.optics import footprint_sigma_m

CONTACT = Scene(height_samples=32, image_pixels=64, exit_medium="glass")


def double(scene, preset="lattice", **kwargs):
    return CausticSimulator(scene, preset, dtype=torch.float64, **kwargs)


def grid(scene):
    x = cell_centres(scene.height_samples, scene.plate_size_m[0])
    return np.meshgrid(x, x)


def paths(simulator, heights):
    """Landing points [m] [n_w, N] of all photons, and their starting points."""
    engine, scene = simulator.engine, simulator.scene
    ((chunk, positions),) = engine.chunks(1)
    landings, _, _, fates = engine.land(engine.maps(engine.coefficients(heights[None]), chunk, positions), positions)
    corner = np.array(scene.screen_position_m[:2]) - np.array(scene.plate_size_m) / 2
    metres = landings[0].numpy() * np.array(scene.pixel_size_m)[:, None] + corner[:, None]
    return metres[:, 0], metres[:, 1], positions.numpy(), fates[0].numpy()


@pytest.mark.parametrize("radiosity", [(1.0, 1.0, 1.0), (2.0, 0.5, 0.0)])
def test_flat_plate_transmits_the_radiosity(radiosity):
    """L_i everywhere, whatever the height of the flat plate."""
    scene = CONTACT.model_copy(update={"radiosity_W_m2": radiosity})
    image = double(scene)(torch.full((32, 32), 1e-3, dtype=torch.float64))
    expected = torch.tensor(radiosity, dtype=torch.float64)[:, None, None].expand_as(image)
    torch.testing.assert_close(image[:, 1:-1, 1:-1], expected[:, 1:-1, 1:-1], atol=1e-7, rtol=0)
    # The least footprint of 0.02 px reaches over the border.
    torch.testing.assert_close(image, expected, atol=5e-5, rtol=0)


def test_random_photons_scatter_about_the_radiosity():
    """Footprints of 4 pi sigma^2 = A s^2 / (2 n_l) average s^2 / 2 = 128 photons: noise of 1/sqrt(128) = 8.8 %."""
    scene = Scene(height_samples=32, image_pixels=256)
    image = double(scene, "paper", n_photons=60000)(torch.zeros(32, 32, dtype=torch.float64))
    inside = image[:, 40:-40, 40:-40]
    assert float(inside.mean()) == pytest.approx(1.0, abs=0.02)
    assert float(inside.std()) == pytest.approx(1 / math.sqrt(128), rel=0.15)


@pytest.mark.parametrize("slope", [0.01, 0.3, 3.0])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("sign", [1, -1])
def test_wedge_deviates_by_snell(slope, axis, sign):
    """A plane wedge shifts every path uphill by (d + h) tan(theta - asin(sin(theta)/n)), at each wavelength."""
    x, y = grid(CONTACT)
    heights = torch.from_numpy(sign * slope * (x if axis == "x" else y) * 1e-2)
    simulator = double(CONTACT, n_photons=1024)
    landed_x, landed_y, positions, _ = paths(simulator, heights)
    along, across = (landed_x, landed_y) if axis == "x" else (landed_y, landed_x)
    start, start_across = positions[:, 0], positions[:, 1]
    if axis == "y":
        start, start_across = start_across, start
    # Edge extension bends the spline of the wedge within 13 samples of its ends.
    middle = np.abs(start) < 1e-3
    theta = math.atan(slope * 1e-2)
    for channel, index in enumerate(CONTACT.glass_indices):
        thickness = CONTACT.base_thickness_m + 1e-6 + sign * slope * 1e-2 * start
        shift = sign * thickness * math.tan(theta - math.asin(math.sin(theta) / index))
        np.testing.assert_allclose((along[channel] - start)[middle], shift[middle], atol=1e-10)
        np.testing.assert_allclose((across[channel] - start_across)[middle], 0, atol=1e-15)


def test_air_gap_refracts_once_more():
    """Behind an air gap g a wedge shifts by a further g tan(asin(n sin(theta'))) for theta' inside the glass."""
    gap = 0.02
    scene = CONTACT.model_copy(update={"exit_medium": "air", "screen_position_m": (0.0, 0.0, -gap)})
    slope = 0.05
    heights = torch.from_numpy(slope * grid(scene)[0])
    landed_x, _, positions, _ = paths(double(scene, n_photons=1024), heights)
    middle = np.abs(positions[:, 0]) < 1e-3
    theta = math.atan(slope)
    for channel, index in enumerate(scene.glass_indices):
        inside = theta - math.asin(math.sin(theta) / index)
        outside = math.asin(index * math.sin(inside))
        thickness = scene.base_thickness_m + slope * positions[:, 0]
        shift = thickness * math.tan(inside) + gap * math.tan(outside)
        np.testing.assert_allclose((landed_x[channel] - positions[:, 0])[middle], shift[middle], atol=1e-8)


def test_spherical_cap_focuses_to_the_closed_form_irradiance():
    """Radial lens: E = r / (r' dr'/dr) with r' = r - (d + h - z_s) tan(delta(r)), to 0.1 %."""
    scene = Scene(height_samples=128, image_pixels=64, plate_size_m=(0.02, 0.02), exit_medium="glass")
    x, y = np.meshgrid(cell_centres(128, 0.02), cell_centres(128, 0.02))
    sigma, peak = 3e-3, 0.3e-3
    heights = peak * np.exp(-(x**2 + y**2) / (2 * sigma**2))
    image = double(scene, n_photons=512**2)(torch.from_numpy(heights))

    def landing(r, index):
        h = peak * np.exp(-(r**2) / (2 * sigma**2))
        theta = np.arctan(h * r / sigma**2)
        delta = theta - np.arcsin(np.sin(theta) / index)
        return r - (scene.base_thickness_m + h - scene.screen_position_m[2]) * np.tan(delta)

    centres = cell_centres(64, 0.02)
    r_screen = np.hypot(*np.meshgrid(centres, centres))
    inside = r_screen < 8e-3
    for channel, index in enumerate(scene.glass_indices):
        r = np.linspace(1e-5, 9e-3, 20001)
        mapped = landing(r, index)
        density = r / (mapped * np.gradient(mapped, r))
        expected = np.interp(r_screen[inside], mapped, density)
        np.testing.assert_allclose(image[channel].numpy()[inside], expected, rtol=1e-3)


def test_dispersion_orders_the_shifts():
    """Blue is bent most, red least."""
    heights = torch.from_numpy(0.2 * grid(CONTACT)[0])
    landed_x, _, positions, _ = paths(double(CONTACT, n_photons=1024), heights)
    red, green, blue = (np.median((landed_x - positions[:, 0])[k]) for k in range(3))
    assert 0 < red < green < blue


def f_shaped():
    """Heights like a mirrored-at-no-axis letter F, so that every flip shows."""
    heights = torch.zeros(32, 32, dtype=torch.float64)
    heights[6:26, 8:11] = 4e-4
    heights[22:26, 8:22] = 4e-4
    heights[14:17, 8:17] = 4e-4
    return heights


@pytest.mark.parametrize(
    "transform",
    [
        lambda a: torch.flip(a, [-1]),
        lambda a: torch.flip(a, [-2]),
        lambda a: a.transpose(-1, -2),
        lambda a: torch.rot90(a, 1, [-2, -1]),
    ],
    ids=["flip columns", "flip rows", "transpose", "quarter turn"],
)
def test_image_follows_the_symmetries_of_the_square(transform):
    """Turned relief, turned image; also shows that rows and columns are not swapped anywhere."""
    simulator, heights = double(CONTACT), f_shaped()
    image = simulator(heights)
    turned = simulator(transform(heights).contiguous())
    # Footprints with tilt are integrated exactly along rows only: a quarter turn changes them slightly.
    assert float((turned - transform(image)).norm()) < 2e-3 * float(image.norm())
    assert float((turned - image).norm()) > 0.05 * float(image.norm())


def test_swapping_x_and_y_changes_little():
    """Rows are integrated exactly, columns by the row's profile: 1.3 % of a printed relief's image, unblurred."""
    scene = Scene()
    strokes = torch.from_numpy(padded([draw_strokes(ReliefConfig(), np.random.default_rng(0))]))
    heights = print_strokes(strokes, scene, ReliefConfig())[0].float()
    simulator = CausticSimulator(scene)
    image = simulator(heights)
    swapped = simulator(heights.mT.contiguous()).mT
    assert 0.005 < float((swapped - image).norm() / image.norm()) < 0.02
    a, b = (torch.nn.functional.avg_pool2d(x[None], 4)[0] for x in (image, swapped))
    assert float((b - a).norm() / a.norm()) < 0.003


def test_image_is_linear_in_the_radiosity():
    """Twice the light, twice the image."""
    heights = f_shaped()
    single = double(CONTACT)(heights)
    twice = double(CONTACT.model_copy(update={"radiosity_W_m2": (2.0, 2.0, 2.0)}))(heights)
    torch.testing.assert_close(twice, 2 * single, rtol=1e-12, atol=0)


def test_distant_point_light_is_collimated_light():
    """A point source 1 km away shines like the sun: same image to 1e-4."""
    far = CONTACT.model_copy(update={"light_position_m": (0.0, 0.0, 1e3), "emission_half_angle_rad": 0.1})
    heights = f_shaped()
    torch.testing.assert_close(double(far)(heights), double(CONTACT)(heights), rtol=1e-3, atol=1e-3)


def test_point_light_falls_off_with_the_cosine_cubed():
    """On a flat plate right above the screen: E = (cos theta)^3 L_i, shadow outside the cone."""
    distance = 0.02
    scene = CONTACT.model_copy(
        update={
            "base_thickness_m": 1e-6,
            "light_position_m": (0.0, 0.0, distance),
            "emission_half_angle_rad": 0.8,
        }
    )
    image = double(scene)(torch.zeros(32, 32, dtype=torch.float64))[0].numpy()
    centres = cell_centres(64, 0.05)
    r = np.hypot(*np.meshgrid(centres, centres))
    lit = r < distance * math.tan(0.8) - 2e-3
    dark = r > distance * math.tan(0.8) + 2e-3
    expected = (distance / np.hypot(distance, r)) ** 3
    np.testing.assert_allclose(image[lit], expected[lit], rtol=2e-3)
    np.testing.assert_allclose(image[dark], 0, atol=1e-12)


LENS = Scene(height_samples=32, image_pixels=256, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,), exit_medium="glass")


@pytest.mark.parametrize("sigma_px", [0.0, 0.3, 1.0, 5.0, 15.0])
@pytest.mark.parametrize("profile", ["gaussian", "spline"])
def test_landed_energy_is_in_the_image_for_every_footprint(sigma_px, profile):
    """A cone of light on the middle of a wavy plate keeps all footprints inside: image sum is the landed energy."""
    update = {"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.0, 0.1)}
    scene = LENS.model_copy(update=update | {"screen_position_m": (0.0, 0.0, -5e-3)})
    x, y = grid(scene)
    heights = torch.from_numpy(5e-4 * np.sin(900 * x) * np.sin(700 * y))
    n_photons = 10000
    smoothing = sigma_px * scene.pixel_size_m[0] / footprint_sigma_m(scene, 1.0, n_photons)
    simulator = double(scene, placement="stratified", n_photons=n_photons, smoothing=smoothing, profile=profile)
    budget = energy_budget(simulator, heights)
    image_W = float(simulator(heights).sum()) * scene.pixel_size_m[0] ** 2
    assert budget["landed"][0] == pytest.approx(1.0, abs=1e-12)
    assert image_W == pytest.approx(budget["landed"][0] * budget["emitted_W"][0], rel=1e-6)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.25, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("profile", ["gaussian", "spline"])
def test_footprint_keeps_energy_centre_and_covariance(sigma, profile):
    """One tilted footprint from 0 to 20 px: energy to 1e-12, centre and covariance (plus the pixel's) to 1 %."""
    scene = LENS
    simulator = double(scene, n_photons=1, profile=profile)
    covariance = np.array([[1.0, 0.5], [0.5, 0.7]]) * sigma**2
    record = torch.tensor([127.3, 128.6, covariance[0, 0], covariance[0, 1], covariance[1, 1], 3.0])
    image = torch.zeros(1, 1, 256, 256, dtype=torch.float64)
    simulator.engine.splat(record.double().view(1, 1, 6, 1), image)
    weights = image[0, 0].numpy()
    assert weights.min() >= 0
    assert weights.sum() == pytest.approx(3.0, rel=1e-12)
    if sigma >= 1:  # smaller ones see the pixel they are in
        position = np.arange(256) + 0.5
        mean_x, mean_y = (weights.sum(axis) @ position / 3 for axis in (0, 1))
        assert mean_x == pytest.approx(127.3, abs=0.05)
        assert mean_y == pytest.approx(128.6, abs=0.05)
        var_x = weights.sum(0) @ (position - mean_x) ** 2 / 3
        var_y = weights.sum(1) @ (position - mean_y) ** 2 / 3
        cov = (position - mean_y) @ weights @ (position - mean_x) / 3
        assert var_x == pytest.approx(covariance[0, 0] + 1 / 12, rel=1e-2)
        assert var_y == pytest.approx(covariance[1, 1] + 1 / 12, rel=1e-2)
        assert cov == pytest.approx(covariance[0, 1], rel=1e-2)


@pytest.mark.parametrize("tilt", [0.0, 0.6, -0.9])
@pytest.mark.parametrize("sigma", [0.15, 0.5, 2.0])
def test_pixels_hold_the_integral_of_the_gaussian(sigma, tilt):
    """Against quadrature of the two-dimensional Gaussian over each pixel: without tilt exact but for its ends, 5 % of the peak with."""
    simulator = double(LENS, n_photons=1, profile="gaussian")
    centre = np.array([127.3, 128.6])
    covariance = sigma**2 * np.array([[1.0, tilt * 0.8], [tilt * 0.8, 0.64]])
    record = torch.tensor([*centre, covariance[0, 0], covariance[0, 1], covariance[1, 1], 1.0], dtype=torch.float64)
    image = torch.zeros(1, 1, 256, 256, dtype=torch.float64)
    simulator.engine.splat(record.view(1, 1, 6, 1), image)
    window = slice(110, 146)
    sub = 40
    fine = (np.arange(36 * sub) + 0.5) / sub + 110
    offset = np.stack(np.meshgrid(fine - centre[0], fine - centre[1]), axis=-1)
    exponent = np.einsum("yxi,ij,yxj->yx", offset, np.linalg.inv(covariance), offset)
    density = np.exp(-exponent / 2) / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    expected = density.reshape(36, sub, 36, sub).mean(axis=(1, 3))
    tolerance = 1e-3 if tilt == 0 else 0.05
    found = image[0, 0, window, window].numpy()
    assert np.abs(found - expected).max() < tolerance * expected.max()


@pytest.mark.parametrize("exit_medium", ["glass", "air"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_energy_budget_closes(exit_medium, dtype):
    """Emitted = landed + off-screen + reflected + unlit + non-finite to 1e-9, with steep slopes that lose light."""
    scene = CONTACT.model_copy(update={"exit_medium": exit_medium, "screen_position_m": (0.0, 0.0, -0.01)})
    heights = torch.from_numpy(np.random.default_rng(0).uniform(0, 2e-2, (32, 32))).to(dtype)
    budget = energy_budget(CausticSimulator(scene, "paper", n_photons=20000, dtype=dtype), heights)
    total = np.sum([budget[name] for name in FATE_NAMES], axis=0)
    np.testing.assert_allclose(total, 1.0, atol=1e-9)
    assert max(budget["off_screen"]) > 0.01
    assert (max(budget["reflected"]) > 0.01) == (exit_medium == "air")
    np.testing.assert_allclose(budget["emitted_W"], 0.05**2, rtol=1e-12)


@pytest.mark.parametrize("placement", ["stratified", "sobol", "random"])
def test_placements_cover_the_plate_evenly(placement):
    """chi^2 on 20 x 20 cells: far below random for the stratified ones, in line with chance for random."""
    from warp_caustics.photons import Chunk, PhotonPlan

    plan = PhotonPlan(CONTACT, placement, 40000, seed=3)
    positions = plan.positions(Chunk(0, plan.count, 0, plan.rows), torch.float64, torch.device("cpu")).numpy()
    counts, _, _ = np.histogram2d(*positions.T, bins=20, range=[[-0.025, 0.025]] * 2)
    assert counts.sum() == 40000
    chi2_per_dof = ((counts - 100) ** 2 / 100).sum() / 399
    if placement == "random":
        assert 0.75 < chi2_per_dof < 1.3
    else:
        assert chi2_per_dof < 0.05


def test_seeds_and_roles_give_unrelated_photons():
    """Same seed same photons; neighbouring seeds and other roles share none."""
    from warp_caustics.photons import Chunk, PhotonPlan

    def photons(seed, role=""):
        plan = PhotonPlan(CONTACT, "random", 20000, seed, role)
        return plan.positions(Chunk(0, plan.count), torch.float64, torch.device("cpu")).numpy()

    reference = photons(5)
    assert (photons(5) == reference).all()
    known = {tuple(p) for p in reference}
    for other in (photons(6), photons(2**32 + 5), photons(5, "clean")):
        assert not known & {tuple(p) for p in other}
        assert abs(np.corrcoef(reference[:, 0], other[:, 0])[0, 1]) < 5 / math.sqrt(20000)
