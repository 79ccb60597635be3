"""What becomes of the light, and light that becomes nothing."""

import numpy as np
import pydantic
import pytest
import torch

from warp_caustics.energy import check_reaches, energy_budget
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=32)
FLAT = torch.zeros(32, 32)


@pytest.mark.parametrize(("preset", "n_photons"), [("paper", 500), ("paper", 20_000), ("lattice", None)])
def test_the_budget_counts_light_of_footprints_over_the_border(preset, n_photons):
    """Landed less what reaches over the border is what the image holds; of few wide footprints that is much."""
    simulator = CausticSimulator(SCENE, preset, n_photons=n_photons)
    image = simulator(FLAT)
    budget = energy_budget(simulator, FLAT, image)
    pixel = SCENE.pixel_size_m[0] * SCENE.pixel_size_m[1]
    held = image.double().sum(dim=(1, 2)).numpy() * pixel / np.array(budget["emitted_W"])
    assert budget["landed"] == pytest.approx([1, 1, 1])
    np.testing.assert_allclose(np.array(budget["landed"]) - budget["over_border"], held, atol=1e-6)
    assert budget["over_border"][0] > 0.01 if n_photons == 500 else budget["over_border"][0] < 0.05


def test_a_wavelength_without_light_loses_none():
    scene = SCENE.model_copy(update={"radiosity_W_m2": (1.0, 0.0, 1.0)})
    simulator = CausticSimulator(scene, "paper", n_photons=500)
    assert energy_budget(simulator, FLAT, simulator(FLAT))["over_border"][1] == 0


def test_light_beside_the_plate_is_refused():
    with pytest.raises(pydantic.ValidationError, match="light misses the plate by 0.0[0-9]+ m: its cone lights a disc"):
        Scene(emission_half_angle_rad=0.01, light_position_m=(0.1, 0, 1))
    Scene(emission_half_angle_rad=0.01, light_position_m=(0.03, 0, 1))


def test_a_cone_between_all_light_paths_is_refused():
    scene = Scene(height_samples=32, image_pixels=32, emission_half_angle_rad=1e-6, light_position_m=(1e-4, 0, 1))
    simulator = CausticSimulator(scene, n_photons=100)
    with pytest.raises(InputError, match="none of 100 light paths meets .* raise --n-photons"):
        energy_budget(simulator, FLAT)


def test_a_black_image_is_refused():
    simulator = CausticSimulator(SCENE.model_copy(update={"screen_position_m": (1.0, 0.0, -1e-6)}))
    budget = energy_budget(simulator, FLAT)
    with pytest.raises(InputError, match=r"no light reaches the image \(100 % off screen"):
        check_reaches(budget)


@pytest.mark.parametrize("radiosity", [1e300, 1e-45, 1e13, -1.0, 1e-13])
def test_radiosity_has_limits(radiosity):
    with pytest.raises(pydantic.ValidationError, match="neither 0 nor between 1e-12 and 1e\\+12 W/m"):
        Scene(radiosity_W_m2=(1.0, 1.0, radiosity))
