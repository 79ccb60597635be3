"""Numbers of a bench beside heights that are nearly right, on small plates."""

import numpy as np
import pytest
import torch

from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_step import bench_step, systematic
from warp_caustics.found_bench.height_changes import height_changes
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=96, screen_position_m=(0, 0, -1e-3))
LINES = [
    Line((-0.018, -0.015), (0.015, 0.012), 7e-3, 8e-4),
    Line((0.018, -0.012), (-0.016, 0.017), 8e-3, 6e-4),
    Line((-0.02, 0.012), (0.02, 0.018), 6e-3, 5e-4),
]
TRUTH = {"screen_x_m": 1.5e-4, "screen_y_m": -1e-4, "vergence_per_m": 0.8, "dispersion_scale": 0.7, AMBIENT: 0.03}


@pytest.fixture(scope="module")
def heights():
    return torch.tensor(line_relief(LINES, 32, SCENE.plate_size_m), dtype=torch.float32)


def seen(model, heights, values, noise=0.0, seed=0):
    image = model.image(heights, values).double().numpy()
    image = image + noise * np.random.default_rng(seed).standard_normal(image.shape)
    return measurement_at(CausticImage(image), SCENE, SCENE.image_pixels, torch.device("cpu"), 2)


def test_every_number_is_found_beside_heights_that_are_right(heights):
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    told = {name: numbers.before[name] for name in numbers.names}
    truth = {name: TRUTH[name] for name in numbers.names}
    measurement = seen(model, heights, truth)
    values, noise = told, torch.full((3,), 0.005, dtype=torch.float64)
    for _ in range(6):
        step = bench_step(model, heights, values, measurement, noise)
        values = step.values
    for parameter in numbers.parameters:
        off, moved = values[parameter.name] - truth[parameter.name], truth[parameter.name] - told[parameter.name]
        assert abs(off) < 0.1 * abs(moved), parameter.name


def test_deviations_cover_what_noise_does(heights):
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    truth = {name: TRUTH[name] for name in numbers.names}
    noise = torch.full((3,), 0.02, dtype=torch.float64)
    least = systematic(SCENE, SCENE.image_pixels)
    scores = []
    for seed in range(6):
        step = bench_step(model, heights, truth, seen(model, heights, truth, 0.02, seed), noise)
        left = {name: (step.sigma[name] ** 2 - least[name] ** 2) ** 0.5 for name in numbers.names}
        scores.append([(step.values[name] - truth[name]) / left[name] for name in numbers.names])
    square = float(np.mean(np.square(scores)))
    assert 0.3 < square < 2.5  # 30 numbers of unit variance


def test_a_plate_that_is_moved_is_no_bench_that_is_moved(heights):
    """Heights a pixel beside their place explain themselves: the bench stays where it is told."""
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    told = {name: numbers.before[name] for name in numbers.names}
    measurement = seen(model, heights, told, 0.01)
    beside = heights + 0.3 * height_changes(heights, SCENE.plate_size_m, SCENE.pixel_size_m[0])[2]
    step = bench_step(model, beside, told, measurement, torch.full((3,), 0.01, dtype=torch.float64))
    moved = step.values["screen_x_m"] / SCENE.pixel_size_m[0]
    assert abs(moved) < 0.05  # and not 0.3


def test_a_step_never_makes_it_worse_and_keeps_to_ranges(heights):
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    told = {name: numbers.before[name] for name in numbers.names}
    darker = {**told, AMBIENT: 0.0}
    image = model.image(heights, darker) * 1.05 - 0.05  # less than no stray light
    measurement = measurement_at(CausticImage(image.numpy()), SCENE, SCENE.image_pixels, torch.device("cpu"))
    step = bench_step(model, heights, told, measurement, torch.full((3,), 0.01, dtype=torch.float64))
    assert step.gain >= 0
    assert step.values[AMBIENT] == 0
    assert step.values["vergence_per_m"] >= 0


def test_derivatives_are_those_of_the_image(heights):
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    values = {name: TRUTH[name] for name in numbers.names}
    image = model.image(heights, values)
    columns = model.by_numbers(heights, values, image)
    steps = {"screen_x_m": 2e-5, "screen_y_m": 2e-5, "vergence_per_m": 0.1, "dispersion_scale": 0.1, AMBIENT: 0.01}
    for column, name in zip(columns, numbers.names, strict=True):
        ahead, behind = (model.image(heights, {**values, name: values[name] + s * steps[name]}) for s in (1, -1))
        expected = (ahead - behind) / (2 * steps[name])
        alike = float((column * expected).sum() / column.norm() / expected.norm())
        assert alike > 0.97, name
        assert 0.9 < float(column.norm() / expected.norm()) < 1.1, name


def test_a_flat_plate_shows_even_light_on_every_bench():
    """What is told is divided by its own flat frame; stray light is in both."""
    numbers = BenchNumbers.of(SCENE)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    image = model.image(torch.zeros(32, 32), {**numbers.before, "vergence_per_m": 2.0, AMBIENT: 0.1})
    inner = image[:, 8:-8, 8:-8]
    assert float((inner - 1).abs().max()) < 2e-3


def test_changes_of_heights_are_what_they_say():
    x = (torch.arange(64, dtype=torch.float64) + 0.5) / 64 * 0.05 - 0.025

    def bump(at_x, at_y, scale):
        return 1e-3 * torch.exp(-(((x[None, :] * scale - at_x) ** 2 + (x[:, None] * scale - at_y) ** 2) / 4e-5))

    changes = height_changes(bump(2e-3, -3e-3, 1.0), (0.05, 0.05), 1e-4)
    expected = {
        2: (bump(2e-3 - 1e-4, -3e-3, 1.0) - bump(2e-3, -3e-3, 1.0)),
        3: (bump(2e-3, -3e-3 - 1e-4, 1.0) - bump(2e-3, -3e-3, 1.0)),
        4: (bump(2e-3, -3e-3, 1 + 1e-4 / 0.025) - bump(2e-3, -3e-3, 1.0)),
    }
    for number, change in expected.items():
        assert float((changes[number] - change).norm() / change.norm()) < 0.05
    torch.testing.assert_close(changes[0], 0.1 * bump(2e-3, -3e-3, 1.0))
