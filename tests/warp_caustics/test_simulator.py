"""The simulator's interface: what it accepts, what it refuses, and with which words."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import CausticsError, InputError, ResourceError

SCENE = Scene(height_samples=8, image_pixels=16)


def test_presets():
    """lattice: deterministic grid; paper: 1e6 random photons at s = 16 (Tab. 1)."""
    assert CausticSimulator(SCENE).settings()["placement"] == "lattice"
    paper = CausticSimulator(SCENE, "paper", n_photons=None).settings()
    assert (paper["placement"], paper["n_photons"], paper["smoothing"]) == ("random", 1_000_000, 16.0)
    assert paper["profile"] == "gaussian"


def test_shapes_of_single_and_batch():
    """[n, n] -> [n_w, m, m], [B, n, n] -> [B, n_w, m, m]."""
    simulator = CausticSimulator(SCENE, n_photons=400)
    assert simulator(torch.zeros(8, 8)).shape == (3, 16, 16)
    assert simulator(torch.zeros(2, 8, 8)).shape == (2, 3, 16, 16)


def test_any_number_of_wavelengths():
    """One or thirty-one channels."""
    for count in (1, 31):
        wavelengths = tuple(np.linspace(400e-9, 700e-9, count))
        scene = SCENE.model_copy(update={"wavelengths_m": wavelengths, "radiosity_W_m2": (1.0,) * count})
        assert CausticSimulator(scene, n_photons=400)(torch.zeros(8, 8)).shape == (count, 16, 16)


def test_lattice_is_repeatable_and_seed_selects_random_photons():
    """Bitwise equal on the CPU, whatever the threads."""
    heights = torch.rand(8, 8) * 1e-3
    lattice = CausticSimulator(SCENE, n_photons=90000)
    assert torch.equal(lattice(heights), lattice(heights))
    first, same, other = (CausticSimulator(SCENE, "paper", n_photons=9000, seed=s)(heights) for s in (1, 1, 2))
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


def with_value(value):
    heights = torch.zeros(8, 8)
    heights[2, 3] = value
    return heights


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        (np.zeros((8, 8)), "torch tensor"),
        (torch.zeros(8, 9), r"\[8, 9\].*\[8, 8\]"),
        (torch.zeros(8), r"\[8\]"),
        (torch.zeros(0, 8, 8), r"\[0, 8, 8\]"),
        (torch.zeros(8, 8, dtype=torch.float64), "float64"),
        (with_value(float("nan")), r"nan at index \[2, 3\]"),
        (with_value(float("inf")), r"inf at index \[2, 3\]"),
        (with_value(-4e-3), "cuts through"),
    ],
)
def test_bad_heights_are_refused(heights, words):
    """One line that names the value and the fix."""
    with pytest.raises(InputError, match=words) as error:
        CausticSimulator(SCENE, n_photons=16)(heights)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"preset": "fast"}, "fast"),
        ({"n_photons": 0}, "n_photons 0"),
        ({"n_photons": -5}, "-5"),
        ({"n_photons": 10.5}, "10.5"),
        ({"n_photons": 10**12}, "1000000000000"),
        ({"smoothing": -1.0}, "-1.0"),
        ({"smoothing": float("nan")}, "nan"),
        ({"seed": -1}, "-1"),
        ({"seed": 2**63}, "2\\^63"),
        ({"seed": 1.5}, "1.5"),
        ({"placement": "hexagonal"}, "hexagonal"),
        ({"profile": "box"}, "box"),
        ({"dtype": torch.float16}, "float16"),
        ({"device": "tpu"}, "tpu"),
        ({"device": "meta"}, "meta"),
    ],
)
def test_bad_settings_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        CausticSimulator(SCENE, **arguments)


def test_missing_device_is_a_resource_error():
    with pytest.raises(ResourceError, match="cuda:77 is missing"):
        CausticSimulator(SCENE, device="cuda:77")


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"wavelengths_m": (610.0, 530e-9, 430e-9)}, "did you mean 6.1e-07"),
        ({"wavelengths_m": (610e-9,)}, "3 radiosities for 1 wavelengths"),
        ({"wavelengths_m": (), "radiosity_W_m2": ()}, "at least 1"),
        ({"base_thickness_m": 3.0}, "did you mean 0.003"),
        ({"base_thickness_m": -1.0}, "-1 m"),
        ({"plate_size_m": (float("nan"), 0.05)}, "finite"),
        ({"screen_position_m": (0, 0, 1e-3)}, "inside or above"),
        ({"glass": "cheese"}, "cheese"),
        ({"glass": 0.9}, "0.9"),
        ({"exit_medium": 7.0}, "7"),
        ({"height_samples": 0}, "greater than or equal to 2"),
        ({"radiosity_W_m2": (0.0, 0.0, 0.0)}, "black"),
        ({"emission_half_angle_rad": 2.0}, "less than"),
        ({"emission_half_angle_rad": 0.1, "light_position_m": (0, 0, 1e-3)}, "below the plate"),
        ({"thicknes": 1}, "[Ee]xtra"),
    ],
)
def test_bad_scenes_are_refused(fields, words):
    with pytest.raises(ValueError, match=words):
        Scene(**fields)


def test_scene_is_immutable():
    with pytest.raises(ValueError, match="frozen"):
        SCENE.base_thickness_m = 1.0


def test_every_error_has_an_exit_code():
    """Scripts tell failures apart by it; 1 is kept for bugs."""
    from warp_caustics import errors

    codes = [c.exit_code for c in vars(errors).values() if isinstance(c, type) and issubclass(c, CausticsError)]
    assert sorted(codes) == [1, 3, 4, 5, 6]


@pytest.mark.parametrize("placement", ["random", "stratified", "sobol"])
def test_reseeding_equals_a_new_simulator(placement):
    """The photon set changes, the rest stays."""
    heights = torch.rand(2, 8, 8) * 1e-3
    simulator = CausticSimulator(SCENE, "paper", n_photons=5000, placement=placement, seed=3)
    before = simulator(heights)
    simulator.reseed(4, "role")
    new = CausticSimulator(SCENE, "paper", n_photons=5000, placement=placement, seed=4, role="role")
    assert torch.equal(simulator(heights), new(heights))
    assert not torch.equal(simulator(heights), before)
    assert simulator.settings()["seed"] == 4
    with pytest.raises(InputError, match="-1"):
        simulator.reseed(-1)
