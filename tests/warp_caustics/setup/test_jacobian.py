"""Derivatives of an image by the set-up: against the oracle in float64, closed forms, signs and products."""

import math

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.errors import InputError
from warp_caustics.oracle import oracle_image
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.setup.differences import difference
from warp_caustics.setup.model import SetUpModel
from warp_caustics.setup.set_up import SetUp
from warp_caustics.setup.unknown_heights import line_heights, smooth_heights

from .conftest import bump

TINY = {
    "height_samples": 8, "image_pixels": 12, "wavelengths_m": (610e-9, 430e-9), "radiosity_W_m2": (1.0, 0.7),
    "base_thickness_m": 0.02, "screen_position_m": (1e-4, -2e-4, -5e-3), "index_offset": 1e-3,
}  # fmt: skip
COLLIMATED = Scene(**TINY, light_tilt_rad=(0.02, -0.015), lamp_half_angle_rad=0.02, fresnel=True)
POINT = Scene(**TINY, emission_half_angle_rad=0.6, light_position_m=(0.01, -0.02, 0.4), lamp_radius_m=5e-3)
BLUR = CameraConfig(psf_px=0.8)


def by_oracle(scene, setup, name, step):
    """Five-point difference of the oracle's images, h^4 (Abramowitz and Stegun, 25.3.6), [n_w, m, m]."""
    heights = bump(8)
    model = SetUpModel(setup, n_photons=16**2)
    simulator = model._simulator
    ((_, positions),) = simulator.engine.chunks(1)
    k = setup.names.index(name)

    def image(offset):
        theta = setup.nominal.clone()
        theta[k] += offset
        moved = setup.scene(theta)
        return oracle_image(heights, moved, positions.double(), simulator.smoothing, simulator.profile, True)

    near, far = image(step) - image(-step), image(2 * step) - image(-2 * step)
    return model.jacobian(heights, [name])[0], (8 * near - far) / (12 * step)


@pytest.mark.parametrize(
    ("scene", "name", "step"),
    [
        (COLLIMATED, "base_thickness_m", 2e-6),
        (COLLIMATED, "gap_m", 2e-6),
        (COLLIMATED, "index_offset", 5e-5),
        (COLLIMATED, "dispersion_scale", 5e-3),
        (COLLIMATED, "tilt_x_rad", 1e-4),
        (COLLIMATED, "tilt_y_rad", 1e-4),
        (COLLIMATED, "lamp_half_angle_rad", 1e-4),
        (COLLIMATED, "screen_x_m", 2e-6),
        (POINT, "base_thickness_m", 2e-6),
        (POINT, "gap_m", 2e-6),
        (POINT, "lamp_x_m", 4e-5),
        (POINT, "lamp_y_m", 4e-5),
        (POINT, "lamp_distance_m", 2e-4),
        (POINT, "lamp_radius_m", 4e-5),
        (POINT, "screen_y_m", 2e-6),
    ],
)
def test_against_differences_of_the_oracle(scene, name, step):
    """To 1e-5 as the screen sees it, through a camera with a PSF as well, on a smooth plate."""
    setup = SetUp.of(scene)
    found, expected = by_oracle(scene, setup, name, step)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    assert float(expected[inner].norm()) > 0
    assert float((found - expected).norm() / expected.norm()) < 1e-5
    camera = Camera(BLUR, scene, dtype=torch.float64)
    seen = SetUpModel(SetUp.of(scene, BLUR, [name]), n_photons=16**2).jacobian(bump(8))[0]
    wanted = camera.linear(expected)
    assert float((seen - wanted).norm() / wanted.norm()) < 1e-5


def test_vergence_from_parallel_light_on():
    """At its bound the derivative is from one side: against a parabola through the oracle's point sources."""
    scene = COLLIMATED
    setup = SetUp.of(scene, free=["vergence_per_m"])
    model = SetUpModel(setup, n_photons=16**2)
    ((_, positions),) = model._simulator.engine.chunks(1)

    def image(v):
        s = model._simulator
        return oracle_image(bump(8), setup.scene([v]), positions.double(), s.smoothing, s.profile, True)

    def slope(h):
        return (-5 * image(h) + 8 * image(2 * h) - 3 * image(3 * h)) / (2 * h)

    expected = (4 * slope(1e-3) - slope(2e-3)) / 3
    (found,) = model.jacobian(bump(8))
    assert float((found - expected).norm() / expected.norm()) < 1e-5


def test_the_disagreement_tells_smooth_images_from_folds():
    """A narrow line whose light folds, without blur: ten times that of a smooth plate, and still a good derivative."""
    scene = Scene(height_samples=64, image_pixels=64, screen_position_m=(0, 0, -5e-3))
    lines = [Line((-0.02, -0.01), (0.02, 0.012), 2e-3, 5e-4)]
    folded = torch.from_numpy(line_relief(lines, 64, scene.plate_size_m))
    model = SetUpModel(SetUp.of(scene, free=["gap_m"]))
    smooth, sharp = (float(model.derivatives(h).disagreement[0]) for h in (bump(64), folded))
    assert 10 * smooth < sharp < 1e-5


FLAT = Scene(height_samples=16, image_pixels=32, screen_position_m=(0, 0, -2e-3))


def test_a_flat_plate_shows_neither_base_nor_gap_nor_index():
    model = SetUpModel(SetUp.of(FLAT))
    found = model.derivatives(torch.zeros(16, 16))
    for name in ("base_thickness_m", "gap_m", "index_offset", "dispersion_scale"):
        column = found.values[found.names.index(name)]
        assert float(column.abs().max()) * SetUp.of(FLAT, free=[name]).parameters[0].prior < 1e-9, name


def test_tilted_light_moves_a_flat_plates_image_by_gap_and_base():
    """By gap tan(a) and d tan(a'), sin a' = sin a / n: the light at the edge that lies in the window moves by that."""
    scene = FLAT.model_copy(update={"light_tilt_rad": (0.1, 0.0), "plate_size_m": (0.01, 0.01)})
    found = SetUpModel(SetUp.of(scene)).derivatives(torch.zeros(16, 16))
    for c, index in enumerate(scene.glass_indices):
        inside = math.asin(math.sin(0.1) / index)
        by_tilt = 2e-3 / math.cos(0.1) ** 2 + 3e-3 * math.cos(0.1) / (index * math.cos(inside) ** 3)
        expected = {
            "gap_m": math.tan(0.1), "base_thickness_m": math.tan(inside), "screen_x_m": -1.0, "tilt_x_rad": by_tilt,
            "index_offset": -3e-3 * math.tan(inside) / (index * math.cos(inside) ** 2),
        }  # fmt: skip
        for name, shift in expected.items():
            change = found.values[found.names.index(name)][c, 16]
            assert -float(change[:8].sum()) * scene.pixel_size_m[0] == pytest.approx(shift, rel=1e-6), name
            assert float(change[8:].abs().max()) < 1e-6 * float(change.abs().max())


def test_more_gap_and_more_glass_make_a_weak_lens_stronger():
    """The crown of a hill is brighter the farther the screen, the thicker the base and the higher the index."""
    scene = FLAT.model_copy(update={"image_pixels": 64})
    model = SetUpModel(SetUp.of(scene))
    heights = bump(16, height_m=1e-4, width_m=0.008)
    image = model.image(heights)[1]
    row, column = divmod(int(image.argmax()), 64)
    found = model.derivatives(heights)
    for name in ("gap_m", "base_thickness_m", "index_offset"):
        assert float(found.values[found.names.index(name)][1, row, column]) > 0, name
    # In air light spreads further than in glass, by the index.
    by_gap, by_base = (found.values[found.names.index(n)][1, row, column] for n in ("gap_m", "base_thickness_m"))
    assert float(by_gap / by_base) == pytest.approx(scene.glass_indices[1], rel=2e-2)


def test_a_taller_base_is_a_higher_relief(heights):
    """E depends on d + h: the derivative by all heights alike, through the exact adjoint too, is that by the base."""
    scene = FLAT.model_copy(update={"lamp_half_angle_rad": 0.01, "fresnel": True})
    model = SetUpModel(SetUp.of(scene, CameraConfig(psf_px=0.6)))
    by_base = model.jacobian(heights, ["base_thickness_m"])[0]
    by_all = model.by_heights(heights, smooth_heights(scene, 1).modes)[0]
    torch.testing.assert_close(by_all, by_base, rtol=1e-6, atol=1e-6 * float(by_base.abs().max()))
    free = heights.clone().requires_grad_()
    seen = Camera(CameraConfig(psf_px=0.6), scene, dtype=torch.float64)(
        CausticSimulator(scene, dtype=torch.float64)(free)
    )
    weight = torch.randn(seen.shape, generator=torch.Generator().manual_seed(1)).double()
    (gradient,) = torch.autograd.grad(seen, free, weight)
    assert float(gradient.sum()) == pytest.approx(float((weight * by_base).sum()), rel=1e-6)


@pytest.mark.parametrize("nominal", [CameraConfig(), CameraConfig(psf_px=0.5, shift_px=(0.5, -0.3), turn_rad=0.02)])
def test_each_number_of_a_camera_by_differences(heights, nominal):
    groups = (
        "shift_x_px", "shift_y_px", "turn_rad", "magnification", "homography", "colour_shift_x_px", "colour_scale",
        "psf_px", "box_px", "light_x", "light_xy", "ambient", "mixing", "gain",
    )  # fmt: skip
    setup = SetUp.of(FLAT, nominal, groups)
    model = SetUpModel(setup)
    light, found = model.on_screen(heights), model.derivatives(heights)
    operator = setup.operator()
    assert not found.disagreement.any()
    for k, name in enumerate(setup.names):
        step = torch.zeros_like(setup.nominal)
        step[k] = 1e-5
        ahead, behind = (operator(light, setup.camera(setup.nominal + s * step)) for s in (1, -1))
        expected = (ahead - behind) / 2e-5
        torch.testing.assert_close(found.values[k], expected, rtol=1e-5, atol=1e-8, msg=name)


def test_a_screen_that_moves_is_a_picture_that_moves(heights):
    """S_x to the right, the picture to the left; a blurred one, whose pixels a camera can move without error."""
    model = SetUpModel(SetUp.of(FLAT, CameraConfig(psf_px=1.5), ["screen_x_m", "shift_x_px"]))
    screen, shift = model.jacobian(heights, ["screen_x_m", "shift_x_px"])[:, :, 8:-8, 8:-8]
    pixel = FLAT.pixel_size_m[0]
    torch.testing.assert_close(screen * pixel, -shift, rtol=0, atol=2e-3 * float(shift.abs().max()))


def test_names_choose_and_keep_their_order(heights):
    model = SetUpModel(SetUp.of(FLAT, CameraConfig(psf_px=0.5)))
    found = model.derivatives(heights, ["psf_px", "gap_m"])
    assert found.names == ("psf_px.0", "psf_px.1", "psf_px.2", "gap_m") and found.values.shape == (4, 3, 32, 32)
    theta = model.setup.nominal.clone()
    theta[model.setup.names.index("gap_m")] = 4e-3
    moved = model.jacobian(heights, ["gap_m"], theta)
    assert float((moved[0] - found.values[3]).norm() / moved[0].norm()) > 1e-3
    with pytest.raises(InputError, match="'box_px' is not known"):
        model.jacobian(heights, ["box_px"])
    with pytest.raises(InputError, match=r"shape \[1, 16, 16\]; derivatives are of one plate"):
        model.jacobian(heights[None])


def test_lines_move_as_they_are_printed():
    """Images by a line's numbers against images of moved lines."""
    scene = Scene(height_samples=64, image_pixels=32, screen_position_m=(0, 0, -1e-3))
    line = Line((-0.012, -0.01), (0.014, 0.008), 8e-3, 3e-4)
    unknown = line_heights(scene, [line])
    assert unknown.names[5] == "line.0.height_m" and unknown.modes.shape == (6, 64, 64)
    heights = torch.from_numpy(line_relief([line], 64, scene.plate_size_m))
    model = SetUpModel(SetUp.of(scene))
    by_height = model.by_heights(heights, unknown.modes)[5]
    step = 1e-6
    images = [model.image(heights * (1 + sign * step / 3e-4)) for sign in (1, -1)]
    expected = (images[0] - images[1]) / (2 * step)
    assert float((by_height - expected).norm() / expected.norm()) < 1e-3


def test_smooth_heights_cover_the_plate():
    for grid in (1, 2, 5):
        unknown = smooth_heights(FLAT, grid)
        assert unknown.modes.shape == (grid**2, 16, 16) and len(unknown.names) == grid**2
        torch.testing.assert_close(unknown.modes.sum(0), torch.ones(16, 16).double())
    with pytest.raises(InputError, match="grid of 0 x 0 heights is not between 1 and 32"):
        smooth_heights(FLAT, 0)
    with pytest.raises(InputError, match="no lines"):
        line_heights(FLAT, [])


@pytest.mark.parametrize("at", [0.0, 0.3, 1.0])
def test_differences_at_both_ends_of_a_range(at):
    """Of sin(3 x): a fourth-order error in the middle, a third-order one at the ends, no value beyond."""
    asked = []

    def function(x):
        asked.append(x)
        return torch.tensor(math.sin(3 * x), dtype=torch.float64)

    found = difference(function, at, 1e-2, 0.0, 1.0)
    assert float(found.derivative) == pytest.approx(3 * math.cos(3 * at), rel=1e-5)
    assert min(asked) >= 0 and max(asked) <= 1 and 0 < found.disagreement < 1e-2
    assert difference(lambda x: torch.zeros(2), 0.5, 0.1, 0.0, 1.0).disagreement == 0
    np.testing.assert_allclose(float(difference(function, 0.0, 1e9, 0.0, 1.0).derivative), 3.0, rtol=0.2)


@pytest.mark.gpu
def test_the_same_on_a_gpu(heights, device):
    """Derivatives by light, camera and heights: what atomic sums in another order change."""
    setup = SetUp.of(FLAT.model_copy(update={"lamp_half_angle_rad": 0.01}), CameraConfig(psf_px=0.5))
    modes = smooth_heights(FLAT, 2).modes
    here, there = (SetUpModel(setup, device=where) for where in ("cpu", device))
    for name, expected, found in zip(setup.names, here.jacobian(heights), there.jacobian(heights), strict=True):
        assert float((found.cpu() - expected).norm()) < 1e-6 * float(expected.norm()) + 1e-12, name
    torch.testing.assert_close(
        there.by_heights(heights, modes).cpu(), here.by_heights(heights, modes), rtol=1e-6, atol=1e-4
    )
