"""What the rest of an image looks like: each cause planted on a small plate is named with its size, and nothing else."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.doubt import MOST_TIMES
from warp_caustics.found_bench.rest_causes import (
    APART,
    GRAIN,
    SOFTER,
    SPOTS,
    UNEVEN,
    RestCauses,
    rest_causes,
)
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.rest import COARSE_PX, coarse_means, local_relief
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=96, screen_position_m=(0, 0, -1e-3))
LINES = [
    Line((-0.018, -0.015), (0.015, 0.012), 7e-3, 8e-4),
    Line((0.018, -0.012), (-0.016, 0.017), 8e-3, 6e-4),
]
NOISE = 0.005
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def heights():
    return np.asarray(line_relief(LINES, 32, SCENE.plate_size_m), np.float64)


@pytest.fixture(scope="module")
def light(heights):
    return shown(heights)


def shown(heights, scene=SCENE):
    with torch.no_grad():
        return CausticSimulator(scene, "lattice")(torch.tensor(heights, dtype=torch.float32)).double().numpy()


def resimulation(image):
    image = image + NOISE * np.sqrt(np.maximum(image, 0.05)) * np.random.default_rng(5).standard_normal(image.shape)
    return Resimulation(CausticSimulator(SCENE, "lattice"), CausticImage(image, np.full(3, NOISE)))


def found(image, heights, deviation=None, is_found=False):
    seen = resimulation(image)
    predicted2 = None if deviation is None else seen.predicted2(heights, deviation)
    camera = ChannelCamera.perfect(3, 96)
    numbers = None if is_found else BenchNumbers.of(SCENE)
    return rest_causes(seen.rest(heights), heights, numbers, camera, CPU, predicted2)


def named(image, heights):
    return {cause.name: cause for cause in found(image, heights).causes}


def test_an_image_that_is_explained_has_no_cause(light, heights):
    causes = found(light, heights)
    assert causes.causes == () and causes.rest["beyond_noise"] < 0.01
    assert "not named" in causes.line


def test_uneven_light(light, heights):
    x = (np.arange(96) + 0.5) / 48 - 1
    (cause,) = named(light * (1 + 0.05 * x), heights).values()
    assert cause.name == UNEVEN and cause.share > 0.9
    assert abs(cause.value - 0.05) < 2 * cause.sigma < 0.03


def test_a_lens_out_of_focus(light, heights):
    soft = blurred(torch.tensor(light), blur_matrices(96, np.full(3, 0.5), CPU).double()).numpy()
    cause = named(soft, heights)[SOFTER]
    assert cause.value == pytest.approx(0.5, abs=0.1) and cause.share > 0.5


def test_colours_apart(light, heights):
    moved = light.copy()
    moved[0] -= 0.2 * np.gradient(light[0], axis=1)
    cause = named(moved, heights)[APART]
    assert cause.value == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize(("name", "value"), [("vergence_per_m", 0.8), ("screen_x_m", 1.5e-4), (AMBIENT, 0.05)])
def test_a_bench_other_than_told(heights, name, value):
    """Beside heights that are right nearly all of it is told; stray light only where it is dark in the image."""
    heights = heights * (4 if name == AMBIENT else 1)
    numbers = BenchNumbers.of(SCENE)
    values = {each: numbers.before[each] for each in numbers.names} | {name: value}
    image = BenchModel(numbers, 96, "cpu").image(torch.tensor(heights, dtype=torch.float32), values)
    causes = found(image.double().numpy(), heights)
    cause = {each.name: each for each in causes.causes}[name]
    assert cause.share is None and cause.value == pytest.approx(value, rel=0.35)
    assert cause.is_bench == (name != AMBIENT)
    assert not any(each.is_bench for each in found(image.double().numpy(), heights, is_found=True).causes)


def test_dirt_is_spots_or_grain(light, heights):
    generator = np.random.default_rng(1)
    spotted = light.copy()
    for row, column in generator.integers(8, 88, (12, 2)):
        spotted[:, row : row + 2, column : column + 2] *= 0.3
    assert 4 <= named(spotted, heights)[SPOTS].value <= 12, "those on lines are not told from lines"
    grainy = light * (1 + 0.05 * generator.standard_normal(light.shape))
    cause = named(grainy, heights)[GRAIN]
    assert cause.value == pytest.approx(0.05, abs=0.02)


def test_heights_more_wrong_than_they_say_leave_more(light, heights):
    """What is left is compared with what reliefs leave that are off by the deviation at random."""
    white = scipy.ndimage.gaussian_filter(np.random.default_rng(2).standard_normal(heights.shape), 0.7)
    off = 4e-6 * white / white.std()
    right, wrong = (found(light, heights + off, np.full_like(heights, size)) for size in (4e-6, 1e-6))
    assert right.ratio < MOST_TIMES < wrong.ratio


def test_where_it_is_left_is_told(light, heights):
    """Shares of parts add up in squares, and that of the contrast grows with what is wrong."""
    right, rest, worse = (resimulation(light).rest(heights * factor) for factor in (1.0, 1.1, 1.2))
    assert right.share < 0.05 < rest.share < 0.6 * worse.share < 1
    regions = rest.by_region()
    parts = [regions[name] for name in ("even", "bright", "between")]
    assert rest.record()["beyond_noise"] == pytest.approx(np.sqrt(np.square(parts).sum()), rel=0.05)


def test_the_relief_around_a_sample_is_at_least_a_part_of_its_own(heights):
    around = local_relief(heights)
    assert (around > 0.5 * heights).all() and around.max() <= heights.max()


def test_an_image_without_known_noise_has_no_rest(heights, light, monkeypatch):
    monkeypatch.setattr("warp_caustics.reconstruct.result.estimated_noise", lambda image, scene: None)
    seen = Resimulation(CausticSimulator(SCENE, "lattice"), CausticImage(light))
    assert seen.rest(heights) is None


def test_words():
    rest = {"beyond_noise": 0.05, "even": 0.0, "bright": 0.04, "between": 0.03, "coarse": 0.0}
    causes = RestCauses(rest, (), 3.0)
    assert causes.line.startswith("5 % of the image beyond its noise, most of it at bright lines")
    assert causes.record["ratio"] == 3.0 and causes.record["causes"] == []


def test_coarse_means_are_those_of_the_filter():
    """As a GPU takes them, by products along both axes."""
    left = np.random.default_rng(3).standard_normal((2, 96, 96))
    means = coarse_means(96).numpy()
    expected = scipy.ndimage.gaussian_filter(left, (0, COARSE_PX, COARSE_PX))
    np.testing.assert_allclose(means @ left @ means.T, expected, atol=1e-13)
