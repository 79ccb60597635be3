"""Gaussian sections that are cut off where they meet the plate."""

import numpy as np
import pytest
import torch

import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.fibres.bench.line_posterior import SHAPE_WIDTHS, joint_covariance, misfit_weight
from nets.reconstruct.fibres.image.descent_numbers import CUT, STEPS, DescentNumbers, by_shape, moving, reshaped
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.section import with_cut_bells
from nets.reconstruct.methods import create
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.line import section_height
from warp_caustics.prints.line_shape import SHAPE_LIMITS, Shape, half_height, line_section, section_edge
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N, SUB = 48, 4
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 1.0))
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]], dtype=torch.float64
)
OFF = 1e-3 * torch.tensor([0.1, -0.1, -0.1, 0.1, 0.2, -0.05], dtype=torch.float64)
NOISE = 0.005


def printed(exponent, reach):
    """Relief of cut Gaussians [m], shape [N, N]: means over cells, in float64, of what prints have."""
    at = (np.arange(SUB * N) + 0.5) / (SUB * N) - 0.5
    x, y = (size * axis for size, axis in zip(SCENE.plate_size_m, np.meshgrid(at, at), strict=True))
    total = np.zeros_like(x)
    for x0, y0, x1, y1, width, height in LINES.tolist():
        along = np.array([x1 - x0, y1 - y0])
        share = np.clip(((x - x0) * along[0] + (y - y0) * along[1]) / (along @ along), 0, 1)
        gap = np.hypot(x - x0 - share * along[0], y - y0 - share * along[1])
        total += height * section_height(2 * gap / width, "gaussian", exponent, reach)
    return torch.from_numpy(total.reshape(N, SUB, N, SUB).mean(axis=(1, 3))).float()


@pytest.mark.parametrize(("exponent", "reach"), [(1.0, 1.0), (0.6, 1.0), (1.0, 1.5)])
def test_the_family_has_cut_gaussians_at_its_end(exponent, reach):
    cut = float(np.exp(-4 * np.log(2) * exponent * reach**2))
    shape = Shape(SHAPE_LIMITS[1].exponent, cut=cut)
    t = np.linspace(0, 1.1 * reach, 200)
    half = np.interp(-0.5, -section_height(t, "gaussian", exponent, reach), t)
    found = line_section(shape, t * half_height(shape) / half)
    np.testing.assert_allclose(found, section_height(t, "gaussian", exponent, reach), atol=1e-3)


@pytest.mark.parametrize("shape", [Shape(6.0, cut=0.06), Shape(0.8, 0.3, cut=0.2), Shape(1.0, cut=0.3)])
def test_a_cut_section_falls_from_one_to_nothing_at_its_edge(shape):
    edge = section_edge(shape)
    assert line_section(shape, np.array([0.0])) == 1 and line_section(shape, np.array([half_height(shape)])) == (
        pytest.approx(0.5)
    )
    assert line_section(shape, np.array([0.999 * edge])) > 0 and line_section(shape, np.array([edge])) < 1e-12


def test_a_cut_is_a_number_of_a_descent_where_there_is_one():
    assert CUT[0] not in moving(Shape(6.0)) and CUT[0] in moving(Shape(6.0, cut=0.01))
    model = LineModel(SCENE, supersampling=8)
    model.shape = shape = Shape(6.0, 0.2, cut=0.05)
    numbers = DescentNumbers(model, len(LINES), True)
    at = numbers.of(LINES, shape)
    torch.testing.assert_close(numbers.put(at), LINES)
    np.testing.assert_allclose(model.shape, shape, rtol=1e-12)
    assert at[-1] == 0.05 and numbers.ends(at)[0][-1] == 0 and numbers.ends(at)[1][-1] == SHAPE_LIMITS[1].cut


def test_derivatives_by_the_cut():
    """Against differences three times as large, of lines that stay as wide at half their height."""
    model = LineModel(SCENE)
    model.shape = shape = Shape(6.0, 0.2, cut=0.05)
    (found,) = by_shape(model, LINES, CUT).double()
    reliefs = []
    for cut in (0.047, 0.053):
        model.shape = shape._replace(cut=cut)
        reliefs.append(model.heights(reshaped(LINES, shape, model.shape)).double())
    expected = (reliefs[1] - reliefs[0]) / 0.006
    assert float((found - expected).norm()) < 0.03 * float(expected.norm())


@pytest.mark.parametrize(("exponent", "reach", "uncut"), [(1.0, 1.0, 1.8), (1.0, 1.5, 60.0)])
def test_cut_gaussians_are_told_from_bells(exponent, reach, uncut):
    heights = printed(exponent, reach)
    shown = light_of(SCENE, heights).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(2, NOISE))
    model = LineModel(SCENE)
    model.shape = Shape(uncut)
    lines = LINES.clone()
    lines[:, 4] *= 0.5 / half_height(model.shape)
    fit = ImageFit(SCENE, image, model, 4 * N)
    found = fit.descend(model.clamped(lines + OFF), 60, with_section=True)
    before = 1e6 * float((model.heights(found.lines) - heights).square().mean().sqrt())
    kept = with_cut_bells(fit, found.lines, 60)
    after = 1e6 * float((model.heights(kept) - heights).square().mean().sqrt())
    assert model.shape.cut == pytest.approx(float(np.exp(-4 * np.log(2) * exponent * reach**2)), rel=0.3)
    assert after < 0.6 * before


@pytest.mark.parametrize("shape", [Shape(1.6), Shape(2.0, 0.4), Shape(1.0, 1.0), Shape(0.6)])
def test_bells_that_are_not_cut_stay(shape):
    model = LineModel(SCENE)
    model.shape = shape
    lines = model.clamped(reshaped(LINES, Shape(), shape))
    shown = light_of(SCENE, model.heights(lines)).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    fit = ImageFit(SCENE, CausticImage((shown + noise).astype(np.float32), np.full(2, NOISE)), model, 4 * N)
    with_cut_bells(fit, lines, 20)
    assert model.shape.cut == 0


def test_numbers_of_a_shape_have_steps_and_widths():
    assert len(STEPS) == len(SHAPE_WIDTHS) == len(Shape()) - 1, "all but whether it is a cap"
    model = LineModel(SCENE)
    model.shape = Shape(6.0, 0.1, cut=0.05)
    lines = model.clamped(reshaped(LINES, Shape(), model.shape))
    image = CausticImage(light_of(SCENE, model.heights(lines)).numpy(), np.full(2, NOISE))
    fit = ImageFit(SCENE, image, model, 2 * N)
    weight = misfit_weight(fit, 1e-3)
    found = joint_covariance(fit, lines, None, weight, with_section=True)
    assert CUT[0] in found.places and np.isfinite(found.matrix).all()
    assert 0 < found.matrix[-1, -1] < SHAPE_WIDTHS[-1] ** 2


def test_the_method_finds_cut_gaussians(monkeypatch, saved):
    """With the bench that lines tell, from a network that is nearly right."""
    heights = printed(1.0, 1.0)

    def answers(images):
        rough = 1.01 * heights + 2e-6 * torch.randn(N, N, generator=torch.Generator().manual_seed(4))
        return rough.expand(len(images), N, N).clone()

    monkeypatch.setattr(answers_module, "Replayed", lambda module: answers)
    shown = light_of(SCENE, heights).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(2, NOISE))
    method = create("fibres", SCENE, weights=saved("direct", scene=SCENE), symmetries=False, set_up="estimate")
    found = method.reconstruct(image)
    assert found.counters["explained_by"] == "fibres" and found.fibres_m.shape == (2, 6)
    assert found.counters["section"]["cut"] == pytest.approx(0.0625, rel=0.3)
    assert 1e6 * np.sqrt(np.mean((found.heights_m - heights.numpy()) ** 2)) < 0.5


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize("exponent", [1.3, 6.0, 53.7, 267.0, 600.0])
def test_no_point_is_below_the_plate(exponent, device):
    """A power of less than nothing is none: where lines merge, one such point would leave no relief."""
    model = LineModel(SCENE, device=device, supersampling=16)
    for cut in np.geomspace(1e-5, 0.4, 25).tolist():
        model.shape = Shape(exponent, 0.03, overlap=0.9993, cut=cut)
        points = model.points(reshaped(LINES, Shape(), model.shape))
        assert bool(torch.isfinite(points).all()) and float(points.min()) >= 0
