"""Named numbers of a set-up: there and back, and what is refused."""

import math

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.errors import InputError
from warp_caustics.materials import melt_index, refractive_index
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_parameters
from warp_caustics.setup.parameter import Parameter
from warp_caustics.setup.set_up import SetUp

COLLIMATED = Scene(
    height_samples=16, image_pixels=32, light_tilt_rad=(0.02, -0.01), lamp_half_angle_rad=0.01, fresnel=True,
    screen_position_m=(1e-4, -2e-4, -2e-3), index_offset=1e-3, dispersion_scale=0.9,
)  # fmt: skip
POINT = Scene(
    height_samples=16, image_pixels=32, emission_half_angle_rad=0.5, light_position_m=(0.01, -0.02, 0.4),
    lamp_radius_m=1e-3, screen_position_m=(0.0, 0.0, -1e-3),
)  # fmt: skip
CAMERA = CameraConfig(psf_px=0.5, shift_px=(0.2, -0.1), turn_rad=0.01, light=(0.01, 0.0, 0.02, 0.0, 0.0), ambient=0.01)
EVERYTHING = ("homography", "mixing", "light_x", "light_xy", "box_px")


def drawn(setup, seed=0):
    """Values within a hundredth of a prior width, and within the range."""
    generator = torch.Generator().manual_seed(seed)
    moved = setup.nominal + 0.01 * setup.priors * torch.randn(len(setup.names), generator=generator).double().abs()
    low, high = (torch.tensor([getattr(p, end) for p in setup.parameters]).double() for end in ("low", "high"))
    return torch.minimum(torch.maximum(moved, low), high)


@pytest.mark.parametrize("scene", [COLLIMATED, POINT], ids=["collimated", "point source"])
def test_a_vector_there_and_back(scene):
    """theta to a scene and a camera and back: the same to rounding; each number moves something."""
    setup = SetUp.of(scene, CAMERA)
    theta = drawn(setup)
    found = setup.theta(setup.scene(theta), setup.camera(theta))
    torch.testing.assert_close(found, theta, rtol=1e-12, atol=1e-15)
    assert len(set(setup.names)) == len(setup.names) > 25
    assert bool((theta != setup.nominal).all())


def test_the_nominal_vector_is_the_nominal_set_up():
    setup = SetUp.of(COLLIMATED, CAMERA, [*SetUp.of(COLLIMATED, CAMERA).names, *EVERYTHING])
    assert setup.scene(setup.nominal) == setup.scene() == COLLIMATED
    exact = camera_parameters(CAMERA, 3, 32, dtype=torch.float64)
    for field, value, expected in zip(CameraParameters._fields, setup.camera(setup.nominal), exact, strict=True):
        torch.testing.assert_close(value, expected, rtol=0, atol=0, msg=field)


def test_every_number_of_a_camera_can_be_free():
    """As many names as numbers, but for the homography's last, which only scales the others."""
    everything = CameraConfig(mixing=((1.0, 0.1, 0.0), (0.0, 1.0, 0.1)))
    probe = SetUp.of(COLLIMATED, everything)
    numbers = sum(value.numel() for value in probe.camera())
    groups = (
        "shift_x_px", "shift_y_px", "turn_rad", "magnification", "homography", "colour_shift_x_px",
        "colour_shift_y_px", "colour_scale", "psf_px", "box_px", "light_x", "light_y", "light_xx", "light_xy",
        "light_yy", "ambient", "mixing", "gain",
    )  # fmt: skip
    setup = SetUp.of(COLLIMATED, everything, groups)
    assert len(setup.names) == numbers - 1
    jacobian = torch.func.jacfwd(lambda theta: torch.cat([v.reshape(-1) for v in setup.camera(theta)]))(setup.nominal)
    assert torch.equal(jacobian.sum(0), torch.ones(numbers - 1).double())
    assert jacobian.sum(1).max() == 1


def test_parallel_light_from_far_is_a_point_source():
    """At 1 mm^-1... of 1e-6 / m the image is that of collimated light, tilted and with a lamp's size, to 1e-6."""
    scene = COLLIMATED.model_copy(update={"fresnel": False})
    setup = SetUp.of(scene, free=["vergence_per_m"])
    heights = torch.zeros(16, 16, dtype=torch.float64)
    heights[5:9, 6:12] = 3e-4
    far, parallel = (
        CausticSimulator(s, dtype=torch.float64)(heights) for s in (setup.scene([1e-6]), setup.scene([0.0]))
    )
    assert setup.scene([1e-6]).light_distance_m == pytest.approx(1e6)
    assert float((far - parallel).norm() / parallel.norm()) < 1e-6


def test_a_lamp_half_a_metre_away_has_the_angle_and_size_that_it_had():
    setup = SetUp.of(COLLIMATED, free=["tilt_x_rad", "tilt_y_rad", "vergence_per_m", "lamp_half_angle_rad"])
    scene = setup.scene([0.1, -0.05, 2.0, 0.01])
    assert scene.light_distance_m == pytest.approx(0.5)
    assert scene.light_position_m[:2] == pytest.approx((-0.5 * math.tan(0.1), 0.5 * math.tan(0.05)))
    assert scene.lamp_radius_m == pytest.approx(0.5 * math.sin(0.01))
    np.testing.assert_allclose(setup.theta(scene), [0.1, -0.05, 2.0, 0.01], rtol=1e-12)


def test_two_numbers_make_a_melt():
    """The offset is that at the d line, the scale the distance of any two wavelengths."""
    plain, melt = (Scene(index_offset=o, dispersion_scale=k).glass_indices for o, k in ((0.0, 1.0), (2e-3, 0.5)))
    assert np.ptp(melt) == pytest.approx(0.5 * np.ptp(plain), rel=1e-12)
    assert melt_index("n_bk7", 587.56e-9, 2e-3, 7.0) == pytest.approx(1.5168 + 2e-3, abs=1e-5)
    assert melt_index(1.5, 500e-9, 1e-3, 3.0) == 1.501
    assert melt_index("n_bk7", 500e-9) == refractive_index("n_bk7", 500e-9)


def test_a_catalogue_glass_leaves_records_as_they_were():
    assert not {"index_offset", "dispersion_scale"} & set(Scene().record())
    assert Scene(index_offset=1e-3).record()["index_offset"] == 1e-3


def test_parameters_say_what_they_are():
    for parameter in (*optical_parameters(COLLIMATED), *optical_parameters(POINT)):
        assert parameter.symbol and parameter.meaning and parameter.low < parameter.high and parameter.prior > 0
    assert SetUp.of(COLLIMATED, priors={"gap_m": 1e-3}, free=["gap_m"]).priors.tolist() == [1e-3]
    assert SetUp.of(COLLIMATED, CAMERA, ["psf_px"], ranges={"psf_px": (0.1, 2)}).parameters[2].high == 2


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SetUp.of(COLLIMATED, free=["gap"]), "'gap' is not known; did you mean 'gap_m'?"),
        (lambda: SetUp.of(COLLIMATED, CAMERA, ["psf_px.7"]), "'psf_px.7' is not known; did you mean 'psf_px"),
        (lambda: SetUp.of(POINT, free=["tilt_x_rad"]), "'tilt_x_rad' is not known; "),
        (lambda: SetUp.of(COLLIMATED, free=["psf_px"]), "'psf_px' is not known"),
        (lambda: SetUp.of(COLLIMATED, ranges={"gap_m": (1e-3, 1e-4)}), r"gap_m 0.001 to 0.0001 runs backwards"),
        (lambda: SetUp.of(COLLIMATED, free=["gap_m"], ranges={"gap_m": (0, 1e-4)}), "gap_m 0.002 m is outside 0 to"),
        (lambda: SetUp.of(COLLIMATED, priors={"gap_m": 0.0}), "prior width of gap_m 0 is not above 0"),
        (lambda: SetUp.of(COLLIMATED, free=["gap_m"]).scene([-1e-3]), "gap_m -0.001 m is outside 0 to 10"),
        (lambda: SetUp.of(COLLIMATED, free=["gap_m"]).scene([math.nan]), "gap_m nan m is outside"),
        (lambda: SetUp.of(COLLIMATED, free=["gap_m"]).scene([1e-3, 1.0]), r"shape \[2\] for 1 free parameters"),
        (lambda: SetUp.of(COLLIMATED, free=["gap_m"]).camera(), "has no camera; give"),
        (lambda: SetUp.of(POINT).theta(COLLIMATED), "collimated light has no lamp at a distance"),
        (lambda: SetUp.of(POINT, free=["lamp_x_m"]).scene([1.0]), "light misses the plate"),
        (lambda: Scene(glass=1.1, index_offset=-0.15), "thinner than air; raise scene.index_offset from -0.15"),
        (lambda: Parameter("a", "a", "m", 0, 1, math.inf, "light", ""), "prior width of a inf"),
    ],
)
def test_what_makes_no_set_up_is_refused_in_one_line(make, message):
    with pytest.raises((InputError, ValueError), match=message) as caught:
        make()
    if isinstance(caught.value, InputError):
        assert "\n" not in str(caught.value)
