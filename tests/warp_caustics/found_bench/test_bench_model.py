"""Derivatives of images by the numbers of a bench: of what is mirrored in itself they are so, too."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from warp_caustics.found_bench import bench_model
from warp_caustics.found_bench.bench_model import STEP, BenchModel
from warp_caustics.found_bench.bench_numbers import VERGENCE, BenchNumbers
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.resampling import blur_matrices
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=256, screen_position_m=(0, 0, -1e-3))
LINE = Line((0.0, -0.012), (0.0, 0.012), 3e-3, 8e-4)
"""Along y in the middle: its caustic, of two sharp lines, is mirrored in x."""


@pytest.fixture(scope="module")
def heights():
    return torch.tensor(line_relief([LINE], 64, SCENE.plate_size_m), dtype=torch.float32)


def slopes(heights, numbers=None):
    """Columns by name; of the numbers that lines tell, none of which makes a picture smaller, if none are given."""
    numbers = numbers or numbers_of_lines(BenchNumbers.of(SCENE))
    model = BenchModel(numbers, 256, "cpu", blur_matrices(256, np.full(3, 0.7), torch.device("cpu")))
    at = {name: numbers.before[name] for name in numbers.names}
    columns = model.by_numbers(heights, at, model.image(heights, at))
    return dict(zip(numbers.names, columns, strict=True))


@pytest.mark.parametrize("name", ["screen_x_m", "tilt_x_rad"])
def test_what_moves_a_mirrored_picture_is_odd(heights, name):
    """By differences to one side 3.3 % of it were even: what is left to second order, as another blur would be."""
    column = slopes(heights)[name]
    even, odd = column + column.flip(-1), column - column.flip(-1)
    assert float(even.square().mean().sqrt()) < 0.01 * float(odd.square().mean().sqrt())


@pytest.mark.parametrize("name", ["gap_m", VERGENCE])
def test_what_enlarges_a_mirrored_picture_is_even(heights, name):
    column = slopes(heights)[name]
    even, odd = column + column.flip(-1), column - column.flip(-1)
    assert float(odd.square().mean().sqrt()) < 0.01 * float(even.square().mean().sqrt())


def test_at_an_end_of_its_range_a_number_is_asked_to_second_order(heights, monkeypatch):
    """Light that converges is no lamp's: of a vergence of 0 three points on one side are asked; of two 13 % were off."""
    inside = np.s_[:, 8:-8, 8:-8]
    wide = slopes(heights)[VERGENCE][inside]
    monkeypatch.setattr(bench_model, "STEP", STEP / 4)
    narrow = slopes(heights)[VERGENCE][inside]
    assert float((wide - narrow).square().mean().sqrt()) < 0.06 * float(narrow.square().mean().sqrt())


def test_below_parallel_light_a_vergence_is_not_asked(heights):
    """There a picture is resampled, and softer: whether numbers may be there changes nothing of their columns."""
    numbers = BenchNumbers.of(SCENE)
    assert numbers.parameters[numbers.names.index(VERGENCE)].low < 0
    torch.testing.assert_close(slopes(heights, numbers)[VERGENCE], slopes(heights)[VERGENCE], rtol=0, atol=0)
