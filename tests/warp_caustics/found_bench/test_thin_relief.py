"""The closed form of what heights do in answer to a bench, against the simulator's own derivatives and known maps."""

import numpy as np
import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.found_bench.thin_relief import MAGNIFICATION, TURN, ThinRelief, parameters_of, relief_responses
from warp_caustics.height_field import cell_centres
from warp_caustics.scene import Scene
from warp_caustics.setup.model import SetUpModel
from warp_caustics.setup.set_up import SetUp

PARALLEL = Scene(height_samples=48, image_pixels=96, screen_position_m=(0, 0, -1e-3))
LAMP = PARALLEL.model_copy(update={"light_position_m": (0.01, 0.0, 0.3), "emission_half_angle_rad": 0.15})
SIDE_PX = 8
"""Of the image, where the flat plate's light ends."""


def hill(scene, height_m=4e-4, at=(0.0, 0.0)):
    x, y = (cell_centres(scene.height_samples, size) for size in scene.plate_size_m)
    wide = np.exp(-(((x[None, :] - 0.003 - at[0]) / 0.011) ** 2 + ((y[:, None] + 0.003 - at[1]) / 0.009) ** 2))
    narrow = np.exp(-(((x[None, :] + 0.007 - at[0]) / 0.008) ** 2 + ((y[:, None] - 0.006 - at[1]) / 0.01) ** 2))
    return height_m * (wide + 0.6 * narrow)


CASES = [
    (PARALLEL, "base_thickness_m", 0.01),
    (PARALLEL, "gap_m", 0.01),
    (PARALLEL, "index_offset", 0.02),
    (PARALLEL, "screen_x_m", 0.1),
    (PARALLEL, "screen_y_m", 0.1),
    (PARALLEL, "tilt_x_rad", 0.25),
    (PARALLEL, "vergence_per_m", 0.15),
    (LAMP, "base_thickness_m", 0.06),
    (LAMP, "gap_m", 0.06),
    (LAMP, "index_offset", 0.02),
    (LAMP, "lamp_distance_m", 0.25),
    (LAMP, "lamp_x_m", 0.4),
]
"""Scene, number, and share of the derivative that the first order may leave: shifts by less than a sample pitch are
also those of the spline through the samples."""


@pytest.mark.parametrize(("scene", "name", "most"), CASES)
def test_heights_that_move_so_make_up_for_the_bench(scene, name, most):
    """dI / d theta = dI / dh dh / d theta, relative to the light of a flat plate, which a flat frame divides out."""
    heights = hill(scene)
    response = relief_responses(scene, heights, [name])[name]
    model = SetUpModel(SetUp.of(scene, None, [name]), n_photons=16 * scene.image_pixels**2)
    relief = torch.tensor(heights)
    flat = torch.zeros_like(relief)
    level, image = model.image(flat), model.image(relief)
    wanted = (model.jacobian(relief, [name])[0] - image * model.jacobian(flat, [name])[0] / level) / level
    given = model.by_heights(relief, torch.tensor(response)[None])[0] / level
    inside = slice(SIDE_PX, -SIDE_PX)
    wanted, given = wanted[:, inside, inside], given[:, inside, inside]
    assert float((given - wanted).norm()) <= most * float(wanted.norm())


def test_a_wider_gap_raises_heights_in_proportion():
    """(n - 1) d h: heights of a thin relief grow by dg / D, D the way in air that the glass is worth."""
    heights = hill(PARALLEL, 1e-7)
    found = relief_responses(PARALLEL, heights, ["gap_m", "base_thickness_m"])
    n = np.mean(PARALLEL.glass_indices)
    way = np.mean([3e-3 / each for each in PARALLEL.glass_indices]) + 1e-3
    np.testing.assert_allclose(found["gap_m"], heights / way, rtol=1e-3)
    np.testing.assert_allclose(found["base_thickness_m"], heights / n / way, rtol=1e-3)


def test_the_heights_of_a_moved_a_turned_and_an_enlarged_picture():
    """Against the hill itself moved, turned and enlarged; heights of an enlarged picture grow by its square."""
    fine = PARALLEL.model_copy(update={"height_samples": 256})
    heights = hill(fine, 1e-6)
    found = relief_responses(fine, heights, ["screen_x_m", TURN, MAGNIFICATION])
    step = 1e-5
    np.testing.assert_allclose(step * found["screen_x_m"], hill(fine, 1e-6, (-step, 0)) - heights, atol=4e-12)
    x, y = np.meshgrid(*(cell_centres(256, size) for size in fine.plate_size_m))
    near = np.hypot(x, y) < 0.02
    angle, size = 1e-3, 1e-3
    turned = sampled(fine, heights, np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x)
    np.testing.assert_allclose((angle * found[TURN])[near], (turned - heights)[near], atol=1e-11)
    larger = (1 + size) ** 2 * sampled(fine, heights, x / (1 + size), y / (1 + size))
    np.testing.assert_allclose((size * found[MAGNIFICATION])[near], (larger - heights)[near], atol=1e-11)


def sampled(scene, heights, x, y):
    from scipy.interpolate import RectBivariateSpline

    at_x, at_y = (cell_centres(scene.height_samples, size) for size in scene.plate_size_m)
    return RectBivariateSpline(at_y, at_x, heights).ev(y, x)


def test_a_lamp_tells_its_numbers_and_no_size_of_it_any():
    assert {p.name for p in parameters_of(LAMP)} >= {"lamp_distance_m", TURN, MAGNIFICATION}
    assert "lamp_radius_m" not in {p.name for p in parameters_of(LAMP)}
    assert ThinRelief.of(LAMP).spread == pytest.approx(1 + (3e-3 / 1.46 + 1e-3) / 0.297, rel=1e-3)
    with pytest.raises(InputError, match="lamp_radius_m"):
        relief_responses(LAMP, hill(LAMP), ["lamp_radius_m"])


def test_bare_plate_answers_to_nothing():
    for name, response in relief_responses(LAMP, np.zeros((48, 48))).items():
        assert not response.any(), name
