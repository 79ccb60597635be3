"""What the faces reflect: Fresnel's closed forms, a wedge, a lens, the budget, and nothing where it is off."""

import math

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.energy import FRESNEL, energy_budget
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.trace import FATE_NAMES

SCENE = Scene(height_samples=32, image_pixels=64, fresnel=True)
CONTACT = SCENE.model_copy(update={"exit_medium": "glass"})
POINT = SCENE.model_copy(update={"emission_half_angle_rad": 0.9, "light_position_m": (2e-3, 1e-3, 0.1)})


def double(scene, **kwargs):
    return CausticSimulator(scene, dtype=torch.float64, **kwargs)


def face(incidence, refraction):
    """Unpolarised light through a face, by the laws of sines and tangents (Born and Wolf, 1.5.2, eqs. 21a, 38)."""
    if incidence == refraction:
        return 1.0
    across = (math.sin(incidence - refraction) / math.sin(incidence + refraction)) ** 2
    within = (math.tan(incidence - refraction) / math.tan(incidence + refraction)) ** 2
    return 1 - (across + within) / 2


def share_of_slope(slope, index, outside):
    """Light through a wedge over that through a flat plate."""
    theta = math.atan(slope)
    bent = math.asin(math.sin(theta) / index)
    inside = theta - bent
    behind = math.asin(math.sin(inside) * index / outside)
    flat = (1 - ((index - 1) / (index + 1)) ** 2) * (1 - ((index - outside) / (index + outside)) ** 2)
    second = 1.0 if index == outside else face(inside, behind)
    return face(theta, bent) * second / flat


@pytest.mark.parametrize("scene", [SCENE, CONTACT, POINT], ids=["air", "contact", "point"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_flat_plate_shines_as_without(scene, dtype):
    """L_i under collimated light to rounding; right below a point source, too, and less beside it."""
    heights = torch.full((32, 32), 1e-3, dtype=dtype)
    found, plain = (
        CausticSimulator(s, dtype=dtype)(heights) for s in (scene, scene.model_copy(update={"fresnel": False}))
    )
    ratio = (found / plain)[:, 2:-2, 2:-2]
    if scene.is_collimated:
        assert float((ratio - 1).abs().max()) < 8 * torch.finfo(dtype).eps
    else:
        assert float(ratio[:, 32, 34].min()) == pytest.approx(1, abs=1e-5)
        assert 0.99 < float(ratio.min()) < 0.9999 and float(ratio.max()) < 1 + 1e-6


@pytest.mark.parametrize("exit_medium", ["air", "glass", 1.33])
@pytest.mark.parametrize("slope", [0.05, 0.5, 1.2, 3.0])
def test_a_wedge_loses_what_fresnel_says(slope, exit_medium):
    """Footprints in the middle of a plane slope, both tracers, each wavelength, to 1e-9."""
    scene = SCENE.model_copy(update={"exit_medium": exit_medium, "base_thickness_m": 0.2})
    x = cell_centres(32, scene.plate_size_m[0])
    heights = torch.from_numpy(slope * np.broadcast_to(x, (32, 32)).copy())[None]
    engine = double(scene, n_photons=1024).engine
    ((chunk, positions),) = engine.chunks(1)
    middle = positions[:, 0].abs() < 1e-3
    landed = engine.land(engine.maps(engine.coefficients(heights), chunk, positions), positions)
    for channel, index in enumerate(scene.glass_indices):
        outside = scene.exit_indices[channel]
        expected = share_of_slope(slope, index, outside)
        np.testing.assert_allclose(landed.shares[0, channel, middle].numpy(), expected, rtol=1e-9)
    # The fast kernels: light of the whole image with and without, over a part of the plate that is a plane.
    relief = torch.from_numpy(slope * np.clip(np.broadcast_to(x, (32, 32)), -1e-3, 1e-3).copy())
    plain = scene.model_copy(update={"fresnel": False})
    images = [double(s, n_photons=64**2)(relief) for s in (scene, plain)]
    kept = images[0].sum(dim=(1, 2)) / images[1].sum(dim=(1, 2))
    assert float(kept.max()) < 1
    budget = energy_budget(double(scene, n_photons=64**2), relief)
    budget_plain = energy_budget(double(plain, n_photons=64**2), relief)
    expected = np.array(budget["landed"]) / budget_plain["landed"]
    np.testing.assert_allclose(kept.numpy(), expected, rtol=2e-5)


def test_a_lens_is_dimmer_where_it_is_steep():
    """A dimple of 45 degrees spreads light without folds: the image is that without losses times the closed form."""
    scene = Scene(height_samples=128, image_pixels=64, plate_size_m=(0.02, 0.02), exit_medium="glass", fresnel=True)
    scene = scene.model_copy(update={"base_thickness_m": 4e-3})
    x, y = np.meshgrid(cell_centres(128, 0.02), cell_centres(128, 0.02))
    sigma, peak = 1.5e-3, -2.5e-3
    heights = torch.from_numpy(peak * np.exp(-(x**2 + y**2) / (2 * sigma**2)))
    n_photons = 512**2
    bright = double(scene.model_copy(update={"fresnel": False}), n_photons=n_photons)(heights)
    image = double(scene, n_photons=n_photons)(heights)
    radius = np.linspace(1e-5, 9e-3, 2001)
    h = peak * np.exp(-(radius**2) / (2 * sigma**2))
    slope = -h * radius / sigma**2
    pixel = cell_centres(64, 0.02)
    on_screen = np.hypot(*np.meshgrid(pixel, pixel))
    inside = on_screen < 7e-3
    for channel, index in enumerate(scene.glass_indices):
        theta = np.arctan(slope)
        landing = radius + (scene.base_thickness_m + h) * np.tan(theta - np.arcsin(np.sin(theta) / index))
        assert (np.diff(landing) > 0).all()
        share = [share_of_slope(value, index, index) for value in slope]
        expected = np.interp(on_screen[inside], landing, share)
        np.testing.assert_allclose((image / bright)[channel].numpy()[inside], expected, atol=2e-4)  # pixels are means
    assert expected.min() < 0.992


@pytest.mark.parametrize("scene", [SCENE, CONTACT, POINT], ids=["air", "contact", "point"])
def test_the_budget_closes_with_the_losses(scene):
    """Fates and reflected light are all the light, to 1e-12; steep slopes lose a percent and more."""
    heights = torch.from_numpy(np.random.default_rng(0).uniform(0, 5e-3, (32, 32)))
    simulator = double(scene, placement="random", n_photons=20_000)
    budget = energy_budget(simulator, heights)
    # From a point source, unlit paths carry no light and are counted as paths.
    names = {*FATE_NAMES, FRESNEL} - ({"unlit"} if not scene.is_collimated else set())
    total = np.sum([budget[name] for name in names], axis=0)
    np.testing.assert_allclose(total, 1.0, atol=1e-12)
    assert min(budget[FRESNEL]) > 0.01
    assert FRESNEL not in energy_budget(double(scene.model_copy(update={"fresnel": False}), n_photons=64), heights)


def test_the_image_holds_what_the_budget_says():
    """No light beside the window: the image's sum is the landed part, to 1e-9."""
    scene = SCENE.model_copy(
        update={"image_pixels": 256, "emission_half_angle_rad": 0.1, "light_position_m": (0, 0, 0.1)}
    )
    x, y = np.meshgrid(*[cell_centres(32, 0.05)] * 2)
    heights = torch.from_numpy(5e-4 * np.sin(900 * x) * np.sin(700 * y))
    simulator = double(scene, placement="stratified", n_photons=10_000, smoothing=1.0)
    image = simulator(heights)
    budget = energy_budget(simulator, heights, image)
    held = image.sum(dim=(1, 2)).numpy() * scene.pixel_size_m[0] * scene.pixel_size_m[1]
    np.testing.assert_allclose(held, np.array(budget["landed"]) * budget["emitted_W"], rtol=1e-9)
    np.testing.assert_allclose(np.array(budget["landed"]) + budget[FRESNEL], 1.0, atol=1e-9)


def test_the_losses_turn_the_gradient():
    """A descent that left out the weight's derivative would be wrong by a hundredth: it is not negligible."""
    heights = torch.from_numpy(np.random.default_rng(0).uniform(0, 5e-3, (32, 32)))
    grads = []
    for fresnel in (True, False):
        leaf = heights.clone().requires_grad_()
        double(SCENE.model_copy(update={"fresnel": fresnel}), n_photons=64**2)(leaf).sum().backward()
        grads.append(leaf.grad)
    assert float(grads[0].norm()) > 1.1 * float(grads[1].norm())


def test_what_is_off_is_not_written():
    """Records of scenes without later effects are those of before, so that fingerprints and weights stay."""
    assert "fresnel" not in Scene().record() and Scene(fresnel=True).record()["fresnel"] is True
    assert set(Scene().record()) == {
        "height_samples", "image_pixels", "base_thickness_m", "plate_size_m", "wavelengths_m", "radiosity_W_m2",
        "emission_half_angle_rad", "light_position_m", "screen_position_m", "glass", "exit_medium",
    }  # fmt: skip
    assert Scene(**Scene(fresnel=True).record()) == Scene(fresnel=True)
