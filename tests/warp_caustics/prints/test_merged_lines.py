"""Lines that do not add up where they cross, point by point: double precision, differences, and limits."""

import numpy as np
import pytest
import torch

from data_gen.reliefs import printed_relief
from data_gen.variety import PrintTraits
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import HEIGHT, LineModel
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=64)
OVERLAPS = (0.0, 0.021, 0.036, 0.2, 0.5, 0.8)
LINES = torch.tensor(
    [
        [-0.018, -0.012, 0.016, 0.013, 3.2e-3, 0.9e-3],
        [-0.015, 0.014, 0.019, -0.016, 2.0e-3, 1.3e-3],
        [-0.002, -0.020, 0.004, 0.021, 4.0e-3, 0.6e-3],
        [0.010, 0.010, 0.018, 0.020, 1.5e-3, 0.8e-3],
    ],
    dtype=torch.float64,
)


def model_of(overlap, shape=None, supersampling=4):
    model = LineModel(SCENE, supersampling=supersampling)
    model.shape = (shape or Shape())._replace(overlap=overlap)
    return model


def wanted(overlap, lines=LINES, supersampling=4):
    strokes = np.concatenate([np.zeros((len(lines), 1)), lines.numpy()], axis=1)
    traits = PrintTraits(merging=np.inf if overlap == 0 else 1 / overlap)
    return printed_relief(strokes, SCENE.height_samples, SCENE.plate_size_m, traits, supersampling)


@pytest.mark.parametrize("supersampling", [1, 2, 4])
@pytest.mark.parametrize("overlap", OVERLAPS)
def test_relief_is_that_of_double_precision(overlap, supersampling):
    found = model_of(overlap, supersampling=supersampling).heights(LINES).double().numpy()
    np.testing.assert_allclose(found, wanted(overlap, supersampling=supersampling), atol=2e-8)


def test_what_is_printed_of_the_means_is_another_relief():
    """Lower, where lines cross; this is what the kernels are for."""
    model = model_of(0.0)
    of_means = model.joined(model.parts(LINES)[0]).double().numpy()
    missing = wanted(0.0) - of_means
    assert missing.min() > -1e-8 and missing.max() > 2e-5


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_lines_tried_besides_others_are_as_printed_together(overlap):
    """Cells in which they cross and all: 26 lines of which the highest is printed left twice as much without them."""
    model = model_of(overlap)
    more = torch.stack([LINES[:1], LINES[:1] + 1e-3 * torch.tensor([2.0, 0, 0, 1, 0.5, 0.2], dtype=torch.float64)])
    others = LINES[1:]
    expected = [model.heights(torch.cat([others, each])) for each in more]
    for tried in (more, more[:, 0]):
        torch.testing.assert_close(model.with_each(others, tried), torch.stack(expected), rtol=0, atol=2e-9)
    pair = torch.cat([more, more.flip(0)], dim=1)
    both = model.heights(torch.cat([others, pair[0]]))
    torch.testing.assert_close(model.with_each(others, pair), torch.stack([both, both]), rtol=0, atol=2e-9)
    without = [model.heights(LINES[[j for j in range(len(LINES)) if j != k]]) for k in range(len(LINES))]
    torch.testing.assert_close(model.heights_without_each(LINES), torch.stack(without), rtol=0, atol=2e-9)
    assert model.with_each(others, more[:0, 0]).shape == (0, model.n, model.n)


@pytest.mark.parametrize(
    "shape", [Shape(), Shape(1.6, 0.5), Shape(1.0, 0.3, 1.0, 0.3, 1e-3), Shape(5.0, cut=0.08), Shape(is_cap=True)]
)
@pytest.mark.parametrize("overlap", OVERLAPS)
def test_derivatives_are_those_by_differences(overlap, shape):
    model, step = model_of(overlap, shape), 1e-6
    total, jacobian = model.with_jacobian(LINES)
    assert torch.equal(total, model.heights(LINES))
    for number, column in enumerate(jacobian.reshape(*LINES.shape, *total.shape).flatten(0, 1)):
        ends = []
        for sign in (-1, 1):
            moved = LINES.clone()
            moved.view(-1)[number] += sign * step
            ends.append(model.heights(moved).double())
        by_differences = (ends[1] - ends[0]) / (2 * step)
        off = (column.double() - by_differences).norm() / by_differences.norm()
        # At any one of few points on a steep rim a difference quotient may be half right.
        assert off < (0.12 if shape.is_cap else 0.02)


def test_lines_apart_are_what_they_are_alone():
    apart = LINES[[0, 0]]
    apart[1, [1, 3]] += 8e-3
    apart[1, HEIGHT] = 0.4e-3
    alone = model_of(1.0).heights(apart)
    for overlap in OVERLAPS:
        np.testing.assert_allclose(model_of(overlap).heights(apart), alone, atol=2e-10)


def test_no_lines_are_bare_plate():
    total, jacobian = model_of(0.3).with_jacobian(LINES[:0])
    assert not total.any() and jacobian.shape == (0, 32, 32)


@pytest.mark.gpu
@pytest.mark.parametrize("overlap", OVERLAPS)
def test_a_gpu_finds_the_same(overlap):
    here, there = model_of(overlap), LineModel(SCENE, device="cuda")
    there.shape = here.shape
    for of_cpu, of_gpu in zip(here.with_jacobian(LINES), there.with_jacobian(LINES), strict=True):
        np.testing.assert_allclose(of_gpu.cpu(), of_cpu, atol=2e-4 if of_cpu.ndim == 3 else 1e-8)
