"""A lamp of finite size and light from the side: closed forms, averages of beams, energy, and what is refused."""

import math

import numpy as np
import pydantic
import pytest
import torch
from scipy import ndimage

from nets.symmetries import scene_symmetries
from warp_caustics import CausticSimulator, Scene
from warp_caustics.energy import energy_budget
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.optics import lamp_sigma
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.transport.ray_inversion import LightPath

GREEN = {"wavelengths_m": (530e-9,), "radiosity_W_m2": (1.0,)}
SCENE = Scene(height_samples=32, image_pixels=64, **GREEN)


def double(scene, **kwargs):
    return CausticSimulator(scene, dtype=torch.float64, **kwargs)


def records(simulator, heights):
    """Footprint records [n_w, 6, N] of all photons and where they start [N, 2]."""
    engine = simulator.engine
    ((chunk, positions),) = engine.chunks(1)
    return engine.records(engine.maps(engine.coefficients(heights[None]), chunk, positions), positions)[0], positions


def disc_of_beams(half_angle_rad, count=64):
    """Tilts (a_x, a_y) [rad] that cover a disc evenly, with its second moment."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    turn = np.arange(count) * math.pi * (3 - math.sqrt(5))
    s = math.sin(half_angle_rad) * radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    return np.arctan(s / np.sqrt(1 - (s**2).sum(1, keepdims=True)))


@pytest.mark.parametrize("gap", [0.0, 5e-3])
@pytest.mark.parametrize("half_angle", [0.002, 0.0175, 0.1])
def test_a_flat_plate_blurs_by_the_lamps_angle(gap, half_angle):
    """sin(theta) / 2 times d / n + gap / n_e along each axis, beside the point lamp's footprint."""
    scene = SCENE.model_copy(update={"screen_position_m": (0.0, 0.0, -gap), "lamp_half_angle_rad": half_angle})
    flat = torch.zeros(32, 32, dtype=torch.float64)
    with_lamp, _ = records(double(scene, n_photons=1024), flat)
    without, _ = records(double(scene.model_copy(update={"lamp_half_angle_rad": 0.0}), n_photons=1024), flat)
    way = scene.base_thickness_m / scene.glass_indices[0] + gap
    expected = (math.sin(half_angle) / 2 * way / scene.pixel_size_m[0]) ** 2
    added = (with_lamp - without)[0]
    np.testing.assert_allclose(added[2], expected, rtol=1e-9)
    np.testing.assert_allclose(added[4], expected, rtol=1e-9)
    np.testing.assert_allclose(added[[0, 1, 3, 5]], 0, atol=1e-12)


@pytest.mark.parametrize("slope", [0.3, 1.0])
def test_a_wedge_blurs_more_along_its_slope(slope):
    """Finite differences of Snell's law in two planes: along the slope, and, by reversal of sign, across it."""
    scene = SCENE.model_copy(
        update={"base_thickness_m": 0.2, "screen_position_m": (0.0, 0.0, -5e-3), "lamp_half_angle_rad": 0.01}
    )
    x = cell_centres(32, scene.plate_size_m[0])
    heights = torch.from_numpy(slope * np.broadcast_to(x, (32, 32)).copy())
    found, positions = records(double(scene, n_photons=1024), heights)
    plain, _ = records(double(scene.model_copy(update={"lamp_half_angle_rad": 0.0}), n_photons=1024), heights)
    middle = positions[:, 0].abs() < 1e-3
    index = scene.glass_indices[0]

    def shift(s):
        """Landing from light of direction (s_x, s_y, .), by unit vectors."""
        ray = np.array([*s, -math.sqrt(1 - s @ s)])
        normal = np.array([-slope, 0, 1]) / math.hypot(slope, 1)
        cosine = -ray @ normal
        inside = ray / index + (cosine / index - math.sqrt(1 - (1 - cosine**2) / index**2)) * normal
        tail = index * inside[:2]
        return -inside[:2] / inside[2] * thickness + scene.screen_position_m[2] * -tail / math.sqrt(1 - tail @ tail)

    thickness = scene.base_thickness_m + slope * float(positions[middle, 0][0])
    step = 1e-6
    columns = [(shift(step * unit) - shift(-step * unit)) / (2 * step) for unit in np.eye(2)]
    jacobian = np.stack(columns, 1) / np.array(scene.pixel_size_m)[:, None]
    expected = lamp_sigma(scene) ** 2 * jacobian @ jacobian.T
    added = (found - plain)[0][:, middle][:, 0]
    np.testing.assert_allclose(added[2:5], [expected[0, 0], expected[0, 1], expected[1, 1]], rtol=1e-6, atol=1e-12)
    assert abs(expected[0, 0] / expected[1, 1] - 1) > 0.02


PLATE = Scene(height_samples=64, image_pixels=256, plate_size_m=(0.025, 0.025), **GREEN)
LINES = [Line((-0.008, -0.006), (0.009, 0.004), 2e-3, 3e-4), Line((-0.004, 0.009), (0.006, -0.008), 1.5e-3, 4e-4)]


def error_of(scene, lamp, beams):
    """Relative error of two crossing lines under a lamp to the average of its beams, both blurred by 1 px; without it."""
    heights = torch.from_numpy(line_relief(LINES, 64, scene.plate_size_m)).float()

    def seen(**changes):
        image = CausticSimulator(scene.model_copy(update=changes), n_photons=512**2)(heights)[0]
        return ndimage.gaussian_filter(image.double().numpy(), 1.0)

    expected = np.mean([seen(**beam) for beam in beams], axis=0)
    return [float(np.linalg.norm(seen(**c) - expected) / np.linalg.norm(expected)) for c in (lamp, {})]


@pytest.mark.parametrize(("half_angle", "gap"), [(math.radians(1), 1e-6), (math.radians(0.3), 5e-3)])
def test_a_lamp_is_the_average_of_its_beams(half_angle, gap):
    """64 tilted pencil beams, pixels of 98 um: within 0.15 %, a quarter of what leaving the lamp out makes."""
    scene = PLATE.model_copy(update={"screen_position_m": (0.0, 0.0, -gap)})
    beams = [{"light_tilt_rad": tuple(tilt)} for tilt in disc_of_beams(half_angle)]
    found, sharp = error_of(scene, {"lamp_half_angle_rad": half_angle}, beams)
    assert found < 0.0015 < 0.005 < sharp


def test_a_lamp_is_the_average_of_its_points():
    """The same for a point source: a disc of 6 mm across at 0.3 m, a gap of 5 mm."""
    changes = {
        "light_position_m": (2e-3, 0.0, 0.3), "emission_half_angle_rad": 0.9, "screen_position_m": (0.0, 0.0, -5e-3),
    }  # fmt: skip
    points = 3e-3 / 1e-3 * np.tan(disc_of_beams(1e-3))
    beams = [{"light_position_m": (2e-3 + x, y, 0.3)} for x, y in points]
    found, sharp = error_of(PLATE.model_copy(update=changes), {"lamp_radius_m": 3e-3}, beams)
    assert found < 0.0015 < 0.005 < sharp


@pytest.mark.parametrize("tilt", [(0.1, 0.0), (0.0, -0.2), (0.15, 0.1)])
@pytest.mark.parametrize("exit_medium", ["glass", "air"])
def test_tilted_light_moves_the_image_of_a_flat_plate(tilt, exit_medium):
    """By d tan(theta') + gap tan(theta''), in the direction of the tilt; the window stays; the light stays L_i."""
    gap = 5e-3
    scene = SCENE.model_copy(
        update={
            "light_tilt_rad": tilt, "exit_medium": exit_medium, "screen_position_m": (0.0, 0.0, -gap), "fresnel": True,
        }
    )  # fmt: skip
    flat = torch.zeros(32, 32, dtype=torch.float64)
    found, positions = records(double(scene, n_photons=64**2), flat)
    way = np.tan(tilt)
    theta = math.atan(math.hypot(*way))
    inside = math.asin(math.sin(theta) / scene.glass_indices[0])
    behind = math.asin(math.sin(theta) / scene.exit_indices[0])
    length = scene.base_thickness_m * math.tan(inside) + gap * math.tan(behind)
    expected = length * way / math.hypot(*way)
    np.testing.assert_allclose(scene.flat_shift_m[0], expected, rtol=1e-12)
    landed = found[0, :2].T.numpy() * scene.pixel_size_m[0] - scene.plate_size_m[0] / 2
    np.testing.assert_allclose(landed - positions.numpy(), np.broadcast_to(expected, positions.shape), atol=1e-12)
    followed = scene.model_copy(update={"screen_position_m": (*map(float, expected), -gap)})
    np.testing.assert_allclose(double(followed, n_photons=128**2)(flat)[:, 2:-2, 2:-2], 1.0, rtol=1e-6)


def test_a_distant_lamp_beside_the_axis_is_tilted_light():
    """A point source 1 km away, aside: the same image but for the window."""
    scene = Scene(height_samples=32, image_pixels=64, **GREEN)
    heights = torch.from_numpy(3e-4 * np.random.default_rng(0).random((32, 32)))
    tilted = double(scene.model_copy(update={"light_tilt_rad": (0.1, -0.05)}))(heights)
    at = (-1e3 * math.tan(0.1), 1e3 * math.tan(0.05), 1e3)
    point = double(scene.model_copy(update={"light_position_m": at, "emission_half_angle_rad": 0.5}))(heights)
    cosine = 1 / math.sqrt(1 + math.tan(0.1) ** 2 + math.tan(0.05) ** 2)
    torch.testing.assert_close(point, tilted * cosine**3, rtol=1e-3, atol=1e-3)


def test_energy_closes_with_lamp_and_tilt():
    """Every path is counted; no light beside a wide window: the image holds what landed, to 1e-9."""
    heights = torch.from_numpy(np.random.default_rng(0).uniform(0, 4e-3, (32, 32)))
    effects = {"light_tilt_rad": (0.2, -0.1), "lamp_half_angle_rad": 0.05, "fresnel": True}
    budget = energy_budget(double(SCENE.model_copy(update=effects), n_photons=200**2), heights)
    names = {*FATE_NAMES, "fresnel"} - {"unlit"}
    assert sum(budget[name][0] for name in names) == pytest.approx(1.0, abs=1e-12)
    assert budget["emitted_W"][0] == pytest.approx(0.05**2, rel=0.05)

    relief = torch.zeros(32, 32, dtype=torch.float64)
    relief[12:20, 12:20] = heights[12:20, 12:20] / 4
    cone = {"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.0, 0.1), "lamp_radius_m": 2e-3, "fresnel": True}
    scene = SCENE.model_copy(update=cone)
    simulator = double(scene, n_photons=200**2, placement="stratified")
    image = simulator(relief)
    budget = energy_budget(simulator, relief, image)
    held = float(image.sum()) * scene.pixel_size_m[0] * scene.pixel_size_m[1]
    assert held == pytest.approx(budget["landed"][0] * budget["emitted_W"][0], rel=1e-9)


def test_tilt_breaks_symmetries():
    assert scene_symmetries(SCENE) == (True, True, True)
    assert scene_symmetries(SCENE.model_copy(update={"light_tilt_rad": (0.1, 0.0)})) == (False, True, False)
    assert scene_symmetries(SCENE.model_copy(update={"lamp_half_angle_rad": 0.1})) == (True, True, True)


def test_light_paths_are_inverted_under_tilt():
    """From a landing point back to the slope that sends light there."""
    path = LightPath.of_scene(SCENE.model_copy(update={"light_tilt_rad": (0.1, -0.05)}))
    rng = np.random.default_rng(0)
    points, heights = rng.uniform(-0.01, 0.01, (2, 50)), rng.uniform(0, 1e-3, 50)
    slopes = rng.uniform(-1, 1, (2, 50))
    found, limited = path.slopes_towards(points, heights, path.landing(points, heights, slopes))
    assert limited == 0
    np.testing.assert_allclose(found, slopes, atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"lamp_half_angle_rad": 1.6}, "lamp of half angle 1.6 rad reaches behind the plate; use at most 0.2"),
        ({"lamp_half_angle_rad": 0.3}, "lamp of half angle 0.3 rad is too large .* use at most 0.2 .1 degree is 0.01745"),
        ({"lamp_half_angle_rad": -0.1}, "greater than or equal to 0"),
        ({"light_tilt_rad": (0.0, 0.3)}, r"light_tilt_rad \[0.0, 0.3\] is beyond 0.25, where slopes .* use -0.25 to 0.25"),
        ({"light_tilt_rad": (0.0, math.nan)}, "finite number"),
        ({"lamp_radius_m": 1e-3}, "lamp_radius_m 0.001 is for a point source; .* scene.lamp_half_angle_rad"),
        ({"emission_half_angle_rad": 0.5, "lamp_radius_m": 1.0}, "radius 1 m is too large .* at most 0.199, or move"),
        ({"emission_half_angle_rad": 0.5, "lamp_half_angle_rad": 0.1}, "is for collimated light; .* scene.lamp_radius_m"),
        ({"emission_half_angle_rad": 0.5, "light_tilt_rad": (0.1, 0)}, "for collimated light; .* scene.light_position_m"),
    ],
)  # fmt: skip
def test_lamps_that_cannot_be_are_refused(fields, message):
    with pytest.raises(pydantic.ValidationError, match=message):
        Scene(**fields)
