"""A user's scene as a network of another grid, plate and number of wavelengths sees it."""

import itertools

import pytest
import torch

from nets.seen_scene import channels_shown, grid_problems, scaled, seen_scene
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

TRAINED = Scene(height_samples=16, image_pixels=64)
NEAR = {"emission_half_angle_rad": 0.3, "light_position_m": (0.01, 0.0, 0.3), "lamp_radius_m": 1e-3}
TILTED = {"light_tilt_rad": (0.02, -0.01), "lamp_half_angle_rad": 4e-3, "fresnel": True}


@pytest.mark.parametrize("light", [{}, NEAR, TILTED])
@pytest.mark.parametrize("scale", [0.4, 5 / 3])
def test_refraction_knows_no_length(light, scale):
    """All lengths multiplied, heights too: the same image, to the rounding of 32-bit places on the screen."""
    scene = TRAINED.model_copy(update={"screen_position_m": (1e-3, 0.0, -2e-3), **light})
    lines = [Line((-0.015, -0.01), (0.012, 0.008), 8e-3, 2.5e-3), Line((0.015, -0.015), (-0.012, 0.018), 8e-3, 2.5e-3)]
    relief = torch.tensor(line_relief(lines, 16, scene.plate_size_m), dtype=torch.float32)
    one = CausticSimulator(scene)(relief)
    other = CausticSimulator(scaled(scene, scale))(scale * relief)
    assert (one - other).norm() < 1e-4 * one.norm()
    # Heights alone make another image.
    assert (one - CausticSimulator(scaled(scene, scale))(relief)).norm() > 0.05 * one.norm()


def test_a_scaled_bench_is_seen_as_the_networks_own():
    for scale in (0.4, 0.6, 0.7123, 1.6, 2.0):
        seen = seen_scene(scaled(TRAINED, scale), TRAINED)
        assert seen.scene == TRAINED and seen.scale == pytest.approx(1 / scale) and not seen.is_same
    assert seen_scene(TRAINED, TRAINED).is_same and seen_scene(TRAINED, TRAINED).record == {}


def test_what_is_seen_is_the_bench_scaled():
    user = Scene(
        height_samples=20, image_pixels=100, plate_size_m=(0.03, 0.03), screen_position_m=(1e-3, 0, -6e-4), **NEAR
    )
    seen = seen_scene(user, TRAINED)
    assert seen.scale == pytest.approx(5 / 3)
    assert seen.scene.base_thickness_m == pytest.approx(5e-3)
    assert seen.scene.screen_position_m == pytest.approx((5e-3 / 3, 0, -1e-3))
    assert seen.scene.light_distance_m == pytest.approx(user.light_distance_m * 5 / 3)
    assert seen.scene.lamp_radius_m == pytest.approx(5e-3 / 3)
    assert seen.scene.image_pixels == 64 and seen.scene.height_samples == 16
    assert seen.record == {
        "image_pixels": 64,
        "height_samples": 16,
        "lengths_scaled_by": pytest.approx(5 / 3),
        "channels": [0, 1, 2],
        "refined_samples": 20,
    }
    many = TRAINED.model_copy(update={"height_samples": 32})
    assert seen_scene(many, TRAINED).working.height_samples == 16  # two pixels for each tell no more
    assert seen_scene(many.model_copy(update={"image_pixels": 128}), TRAINED).working.height_samples == 32
    few = seen_scene(TRAINED.model_copy(update={"height_samples": 8}), TRAINED)
    assert few.record["refined_samples"] == few.working.height_samples == 16 and few.user.height_samples == 8


@pytest.mark.parametrize(
    ("wavelengths", "shown"),
    [
        ((530e-9,), (0, 0, 0)),
        ((850e-9,), (0, 0, 0)),
        ((610e-9, 530e-9), (0, 1, 1)),
        ((430e-9, 530e-9), (1, 1, 0)),
        ((610e-9, 430e-9), (0, 0, 1)),
        ((430e-9, 530e-9, 610e-9), (2, 1, 0)),
        ((640e-9, 525e-9, 465e-9), (0, 1, 2)),
        ((400e-9, 700e-9, 420e-9, 540e-9, 615e-9), (4, 3, 2)),
    ],
)
def test_wavelengths_go_where_the_networks_are_nearest(wavelengths, shown):
    user = Scene(wavelengths_m=wavelengths, radiosity_W_m2=(1.0,) * len(wavelengths))
    assert channels_shown(user, TRAINED) == shown
    seen = seen_scene(user, TRAINED)
    assert [seen.scene.glass_indices[k] for k in range(3)] == pytest.approx([user.glass_indices[k] for k in shown])
    for one, other in itertools.combinations(range(3), 2):
        if shown[one] == shown[other]:
            assert abs(seen.scene.glass_indices[one] - seen.scene.glass_indices[other]) < 1e-12


def test_dark_wavelengths_are_not_shown():
    assert channels_shown(Scene(radiosity_W_m2=(1, 1, 0)), TRAINED) == (0, 1, 1)
    assert channels_shown(Scene(radiosity_W_m2=(0, 0, 2)), TRAINED) == (2, 2, 2)
    dark = TRAINED.model_copy(update={"radiosity_W_m2": (1.0, 1.0, 0.0)})
    assert channels_shown(dark, dark) == (0, 1, 2) and grid_problems(dark, dark) == []
    assert "radiosity_W_m2 is (1.0, 1.0, 0.0) there and (1.0, 1.0, 1.0) here" in grid_problems(TRAINED, dark)[0]


def test_a_network_of_one_wavelength_is_shown_the_nearest():
    single = Scene(wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    assert channels_shown(Scene(), single) == (1,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_pixels": 31}, "image_pixels is 31 here, the nearest that it serves is 32"),
        ({"image_pixels": 257}, "image_pixels is 257 here, the nearest that it serves is 256"),
        ({"height_samples": 3}, "height_samples is 3 here, the nearest that it serves is 4"),
        ({"height_samples": 65}, "height_samples is 65 here, the nearest that it serves is 64"),
        ({"plate_size_m": (0.019, 0.019)}, "plate_size_m is 19 x 19 mm here, the nearest that it serves is 20 mm"),
        ({"plate_size_m": (0.101, 0.101)}, "plate_size_m is 101 x 101 mm here, the nearest that it serves is 100 mm"),
        ({"plate_size_m": (0.05, 0.03)}, "50 x 30 mm here, one side 67% too long for a network of 50 x 50 mm"),
    ],
)
def test_bounds_are_said(changes, message):
    (problem,) = grid_problems(TRAINED.model_copy(update=changes), TRAINED)
    assert message in problem


@pytest.mark.parametrize("changes", [{"image_pixels": 32}, {"image_pixels": 256}, {"height_samples": 4},
                                     {"height_samples": 64}, {"plate_size_m": (0.02, 0.02)},
                                     {"plate_size_m": (0.1, 0.1)}, {"plate_size_m": (0.05, 0.0498)}])  # fmt: skip
def test_bounds_are_within(changes):
    assert grid_problems(TRAINED.model_copy(update=changes), TRAINED) == []
