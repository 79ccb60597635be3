"""Lines on a grid and their derivatives."""

import numpy as np
import pytest
import torch

from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.vectorise.model import LineModel
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64, plate_size_m=(0.05, 0.04))
LINES = torch.tensor([[-10.0, 3.0, 12.0, -7.0, 2.9, 0.8], [1.0, 2.0, 5.0, 5.0, 1.3, 1.0]], dtype=torch.float64)


@pytest.mark.parametrize("profile", ["cosine", "quarter"])
def test_heights_are_those_of_printed_lines(profile):
    lines = [Line(tuple(q[:2] * 1e-3), tuple(q[2:4] * 1e-3), q[4] * 1e-3, q[5] * 1e-3) for q in LINES.numpy()]
    expected = 1e3 * line_relief(lines, 64, SCENE.plate_size_m, profile=profile)
    found = LineModel(SCENE, profile).heights(LINES).double().numpy()
    # On the rim of a "quarter" line float32 decides otherwise here and there.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 if profile == "cosine" else 0.02)
    assert np.abs(found - expected).mean() < 1e-6 * 64


@pytest.mark.parametrize("profile", ["cosine", "quarter"])
@pytest.mark.parametrize("number", range(6))
def test_derivatives(profile, number):
    """Against central differences; the steep rim of a "quarter" line is left out by a wide step's mean."""
    model, step = LineModel(SCENE, profile, supersampling=8), torch.zeros_like(LINES)
    step[:, number] = 2e-3
    derivative = model.parts(LINES)[1][:, number]
    difference = (model.parts(LINES + step)[0] - model.parts(LINES - step)[0]) / 4e-3
    assert difference.norm() > 0.1
    # The rim of a quarter profile is a kink: at any one of 8^2 points the difference quotient may be half right.
    assert (difference - derivative).norm() <= (2e-3 if profile == "cosine" else 0.25) * difference.norm()


def test_no_lines():
    model = LineModel(SCENE)
    heights, derivatives = model.parts(torch.zeros(0, 6, dtype=torch.float64))
    assert heights.shape == (0, 64, 64) and derivatives.shape == (0, 6, 64, 64)
    assert not model.heights(torch.zeros(0, 6, dtype=torch.float64)).any()


def test_limits():
    wild = torch.tensor([[100.0, -100.0, 0.0, 0.0, 9.0, -1.0]], dtype=torch.float64)
    clamped = LineModel(SCENE).clamped(wild)[0]
    assert clamped.tolist() == pytest.approx([27.0, -21.6, 0.0, 0.0, 4.5, 0.01])
