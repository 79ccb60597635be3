"""The section of lines found with them, on a small scene."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image_fit import ImageFit
from nets.reconstruct.fibres.search import LineSearch
from nets.reconstruct.fibres.section import half_height, reshaped
from warp_caustics.prints.line import section_height
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 1.0))
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]], dtype=torch.float64
)
OFF = 1e-3 * torch.tensor([0.1, -0.1, -0.1, 0.1, 0.2, -0.05], dtype=torch.float64)


def model_of(exponent):
    model = LineModel(SCENE)
    model.exponent = exponent
    return model


def seen(exponent):
    """With 0.5 % noise."""
    simulated = CausticSimulator(SCENE)(model_of(exponent).heights(LINES)).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    return CausticImage((simulated + 0.005 * noise).astype(np.float32), np.full(2, 0.005))


@pytest.mark.parametrize("exponent", [0.35, 0.5, 1.0, 2.0])
def test_width_at_half_the_height(exponent):
    assert float(section_height(np.array([half_height(exponent)]), "cosine", exponent)[0]) == pytest.approx(0.5)
    wider = reshaped(LINES, 1.0, exponent)
    np.testing.assert_allclose(wider[:, 4] * half_height(exponent), LINES[:, 4] / 2)
    assert torch.equal(wider[:, [0, 1, 2, 3, 5]], LINES[:, [0, 1, 2, 3, 5]])


@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.7])
def test_derivative_by_the_exponent(exponent):
    """Against the closed form dh/dg = 2 h ln cos(pi t / 2) of a section that a cell's mean hardly changes."""
    model = LineModel(SCENE, supersampling=1)
    model.exponent = exponent
    line = LINES[:1].clone()
    line[0, :4] = torch.tensor([-1e-1, 1e-3, 1e-1, 1e-3])  # along x, across the whole plate
    column = model.by_exponent(line)[:, N // 2].double().numpy()
    y = (np.arange(N) + 0.5) / N * SCENE.plate_size_m[1] - SCENE.plate_size_m[1] / 2
    t = np.abs(y - 1e-3) * 2 / float(line[0, 4])
    cosine = np.cos(np.pi / 2 * np.clip(t, 0, 1 - 1e-9))
    expected = np.where(t < 1, 2 * float(line[0, 5]) * cosine ** (2 * exponent) * np.log(cosine), 0.0)
    np.testing.assert_allclose(column, expected, atol=2e-3 * np.abs(expected).max())
    assert model.exponent == exponent


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.6])
def test_the_section_is_found_with_the_lines(exponent):
    model, truth = LineModel(SCENE), model_of(exponent).heights(LINES)
    search = LineSearch(SCENE, seen(exponent), model, 2 * N, jumps=0, finds_section=True)
    found = search.run(reshaped(LINES + OFF, exponent, 1.0))
    assert model.exponent == pytest.approx(exponent, rel=0.06)
    assert 1e6 * float((model.heights(found) - truth).square().mean().sqrt()) < 1.0


def test_a_told_section_stays():
    model = LineModel(SCENE)
    ImageFit(SCENE, seen(0.6), model, 2 * N).descend(LINES + OFF, 10)
    assert model.exponent == 1.0
    fit = ImageFit(SCENE, seen(0.6), model, 2 * N)
    better = fit.descend(LINES + OFF, 30, with_section=True)
    assert model.exponent < 0.9
    assert fit.loss(model.heights(better.lines)) == pytest.approx(better.loss, rel=1e-6), "left at its best"
