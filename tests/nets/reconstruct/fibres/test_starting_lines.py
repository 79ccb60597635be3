"""Where the search for lines begins."""

import pytest
import torch

from nets.reconstruct.fibres.search.starting_lines import starting_lines
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.scene import Scene

N = 48
SCENE = Scene(height_samples=N, image_pixels=2 * N)
LINES = 1e-3 * torch.tensor([[-15.0, -12.0, 14.0, 9.0, 4.0, 0.9], [-9.0, 15.0, 10.0, -16.0, 3.6, 1.1]]).double()


MORE = torch.cat([LINES, 1e-3 * torch.tensor([[-18.0, 5.0, 17.0, 15.0, 3.6, 0.5]]).double()])


@pytest.mark.parametrize("shape", [Shape(), Shape(0.5), Shape(1.0, 1.0)])
def test_section_of_lines_that_a_network_blurs(shape):
    """Told from lines that are found as cosines, within what a network leaves."""
    true, model = LineModel(SCENE), LineModel(SCENE)
    true.shape = shape
    noise = torch.randn(N, N, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    relief = true.heights(MORE).double() + 2e-6 * noise
    found = starting_lines(model, relief, torch.full_like(relief, 5e-6), 20, finds_section=True)
    assert model.shape == shape
    assert 1e6 * float((model.heights(found).double() - true.heights(MORE)).square().mean().sqrt()) < 5


@pytest.mark.parametrize("shape", [Shape(), Shape(1.0, 1.0)])
def test_section_of_a_relief(shape):
    """A cosine or a parabola; an overlap of two lines is a few samples, and told by the image."""
    true, model = LineModel(SCENE), LineModel(SCENE)
    true.shape = shape
    relief = true.heights(LINES).double()
    found = starting_lines(model, relief, torch.full_like(relief, 1e-6), 20, finds_section=True)
    assert model.shape == shape
    assert 1e6 * float((model.heights(found).double() - relief).square().mean().sqrt()) < 5


def test_a_told_section_stays():
    true, model = LineModel(SCENE), LineModel(SCENE)
    true.shape = Shape(1.0, 1.0)
    relief = true.heights(LINES).double()
    starting_lines(model, relief, torch.full_like(relief, 1e-6), 20, finds_section=False)
    assert model.shape == Shape()
