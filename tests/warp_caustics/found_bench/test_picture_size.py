"""Pictures of another size, and those brought back from one."""

import dataclasses

import numpy as np
import pytest
import torch

from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import VERGENCE, BenchNumbers
from warp_caustics.found_bench.picture_size import (
    SMALLEST,
    brought_back,
    enlarged,
    lowest_vergence,
    picture_size,
)
from warp_caustics.scene import Scene
from warp_caustics.way_of_light import way_of_light_m

SCENE = Scene(height_samples=32, image_pixels=128)
NUMBERS = BenchNumbers.of(SCENE)


def spot(m=96, at=(20.0, -12.0), width=6.0):
    """A smooth spot aside, means over pixels nearly, shape [m, m]."""
    x = torch.arange(m, dtype=torch.float64) - (m - 1) / 2
    return torch.exp(-((x[None] - at[0]) ** 2 + (x[:, None] - at[1]) ** 2) / (2 * width**2))


@pytest.mark.parametrize("size", [0.97, 0.995, 1.02])
def test_a_picture_is_enlarged_about_its_middle_and_stays_as_bright(size):
    wanted = spot(at=(20.0 * size, -12.0 * size), width=6.0 * size)
    torch.testing.assert_close(enlarged(spot(), size), wanted, rtol=0, atol=2e-3)
    torch.testing.assert_close(enlarged(torch.ones(3, 96, 96), size), torch.ones(3, 96, 96))


def test_it_is_undone_by_its_inverse_and_left_alone_at_1():
    image = torch.stack([spot(), 2 * spot(at=(-9.0, 4.0))])
    torch.testing.assert_close(enlarged(enlarged(image, 0.99), 1 / 0.99), image, rtol=0, atol=2e-3)
    assert enlarged(image, 1.0) is image


def test_size_and_vergence_hang_together_by_the_way_of_light():
    scene = Scene(screen_position_m=(0.0, 0.0, -5e-3))
    way = np.mean([3e-3 / n + 5e-3 / n_o for n, n_o in zip(scene.glass_indices, scene.exit_indices, strict=True)])
    assert way_of_light_m(scene) == pytest.approx(way)
    assert picture_size(scene, -2.0) == pytest.approx(1 - 2 * way)
    assert picture_size(scene, lowest_vergence(scene)) == pytest.approx(SMALLEST)


@pytest.mark.parametrize(("vergence", "as_of"), [(-2.0, -2.0), (-1.5, -2.0), (-3.0, -2.0), (3.0, 2.5), (1.0, -1.0)])
def test_sizes_of_pictures_that_were_brought_back_multiply(vergence, as_of):
    lamp, size = brought_back(SCENE, vergence, as_of)
    assert lamp >= 0 and size <= 1 and (lamp == 0 or size == 1)
    whole = picture_size(SCENE, lamp) * size * picture_size(SCENE, as_of)
    assert whole == pytest.approx(picture_size(SCENE, vergence), rel=1e-12)


def hill():
    x = torch.linspace(-1, 1, 32)
    return 1.2e-3 * torch.exp(-12 * (x[:, None] ** 2 + x**2))


@pytest.mark.parametrize("is_picture", [False, True])
def test_what_is_brought_back_is_simulated_without_resampling(is_picture):
    """On the bench itself the scene's own picture; a little off as that of a lamp, to first order of the same slope."""
    numbers = dataclasses.replace(NUMBERS, is_picture=is_picture)
    at = 3.0 if is_picture else -3.0
    values = {**numbers.before, VERGENCE: at}
    model = BenchModel(numbers, 128, "cpu")
    there, flat = model.in_size_of(values), model.image(hill(), numbers.before)
    torch.testing.assert_close(there.image(hill(), values), flat)
    torch.testing.assert_close(
        model.image(hill(), {**values, VERGENCE: -3.0}), enlarged(flat, 1 - 3 * way_of_light_m(SCENE))
    )
    k = numbers.names.index(VERGENCE)
    slope = there.by_numbers(hill(), values, flat)[k]
    larger = (enlarged(flat, 1 + 0.5 * way_of_light_m(SCENE)) - flat) / 0.5
    inside = (slice(None), slice(8, -8), slice(8, -8))
    cosine = torch.nn.functional.cosine_similarity(slope[inside].flatten(), larger[inside].flatten(), dim=0)
    assert cosine > 0.85, "what is high is enlarged more by a lamp"


def test_a_size_that_is_told_leaves_no_picture_to_look_for():
    assert NUMBERS.of_picture().is_picture and NUMBERS.picture_size({VERGENCE: 3.0}) == 1.0
    assert NUMBERS.of_lamp() is None and not NUMBERS.of_picture().of_lamp().is_picture
    assert NUMBERS.of_picture().of_lamp().within({VERGENCE: -3.0}) == {VERGENCE: 0.0}
    assert NUMBERS.of_picture().picture_size({VERGENCE: 3.0}) > 1 > NUMBERS.picture_size({VERGENCE: -3.0})
    assert BenchNumbers.of(SCENE, {"magnification": 0.0}).of_picture() is None
    assert BenchNumbers.of(SCENE, {VERGENCE: 0.0}).of_picture() is None
    assert BenchNumbers.of(SCENE, {"magnification": 0.0}).within({VERGENCE: -3.0}) == {VERGENCE: 0.0}
    lamp = Scene(emission_half_angle_rad=0.3, light_position_m=(0.0, 0.0, 0.3))
    assert BenchNumbers.of(lamp).of_picture() is None
    assert NUMBERS.of_picture().scene_of({**NUMBERS.before, VERGENCE: 3.0}).is_collimated
    assert NUMBERS.scene_of({**NUMBERS.before, VERGENCE: -3.0}).is_collimated
