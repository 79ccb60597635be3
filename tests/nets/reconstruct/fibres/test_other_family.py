"""Powers of cosines and of parabolas, which are nearly alike: the misfit has a valley along each."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.section import other_family, with_other_family
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.line_shape import Shape, line_section
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 1.0))
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.7],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9],
        [-17.0, 11.0, 16.0, 13.0, 2.7, 0.5],
        [-12.0, -3.0, 6.0, -14.0, 3.6, 0.8],
    ],
    dtype=torch.float64,
)
OFF = 1e-3 * torch.tensor([0.1, -0.1, -0.1, 0.1, 0.2, -0.05], dtype=torch.float64)


@pytest.mark.parametrize("shape", [Shape(0.55), Shape(1.0), Shape(1.4, 1.0), Shape(2.5, 1.0)])
def test_the_other_family_is_nearly_the_same_section(shape):
    t = np.linspace(0, 1, 200)
    other = other_family(shape)
    assert other.parabola == 1 - shape.parabola and other_family(other).exponent == pytest.approx(shape.exponent)
    assert np.abs(line_section(shape, t) - line_section(other, t)).max() < 0.03
    near = t < 0.1
    np.testing.assert_allclose(line_section(shape, t[near]), line_section(other, t[near]), atol=2e-5)


def test_what_lines_cross_as_stays():
    shape = Shape(0.6, 0.1, 0.35, 0.2, 2e-3)
    assert other_family(shape)[2:] == shape[2:]


@pytest.mark.parametrize(("truth", "begun"), [(Shape(1.4, 1.0), Shape(0.6)), (Shape(0.5), Shape(0.55))])
def test_the_family_that_explains_more_is_taken(truth, begun):
    """From lines that have descended with the other one, and from those of the right one."""
    model = LineModel(SCENE)
    model.shape = truth
    heights = model.heights(LINES)
    image = CausticImage(light_of(SCENE, heights).numpy(), np.full(2, 0.005))
    model.shape = begun
    fit = ImageFit(SCENE, image, model, 2 * N)
    found = fit.descend(LINES + OFF, 20, with_section=True)
    lines = with_other_family(fit, found.lines, 20)
    assert round(model.shape.parabola) == truth.parabola
    assert model.shape.exponent == pytest.approx(truth.exponent, abs=0.06)
    assert fit.loss(model.heights(lines)) <= found.loss * (1 + 1e-6)
    assert 1e6 * float((model.heights(lines) - heights).square().mean().sqrt()) < 1.5


@pytest.mark.parametrize(
    "shape", [Shape(1.0, 1.0, is_cap=True), Shape(6.0, cut=0.06), Shape(1.6), Shape(4.0, 1.0), Shape(8.0)]
)
def test_caps_and_bells_have_no_other_family(shape):
    model = LineModel(SCENE)
    model.shape = shape
    image = CausticImage(light_of(SCENE, model.heights(LINES)).numpy(), np.full(2, 0.005))
    lines = with_other_family(ImageFit(SCENE, image, model, N), LINES, 20)
    assert lines is LINES and model.shape == shape


def test_a_family_that_explains_hardly_more_is_not_taken():
    """Of lines that are too wrong for any section to tell."""
    model = LineModel(SCENE)
    rng = np.random.default_rng(0)
    image = CausticImage(1 + 0.3 * rng.standard_normal((2, 4 * N, 4 * N)), np.full(2, 0.3))
    model.shape = Shape(0.9)
    lines = with_other_family(ImageFit(SCENE, image, model, N), LINES, 3)
    assert model.shape.parabola < 0.5 and len(lines) == len(LINES)
