"""Lines that no relief tells, found by what they leave of the image."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import jump
from nets.reconstruct.fibres.search.shadows import grown_in_shadows
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 128
SCENE = Scene(height_samples=N, image_pixels=2 * N, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.7],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9],
        # Half a sample wide.
        [-18.0, 10.0, 12.0, 18.0, 0.2, 0.25],
    ],
    dtype=torch.float64,
)


def highest(overlap=0.0):
    """A model that prints the highest of lines, and sums of others."""
    model = LineModel(SCENE)
    model.shape = Shape(overlap=overlap)
    return model


def fit_of(model, lines):
    """Judges by light with 1 % noise."""
    seen = light_of(SCENE, model.heights(lines)).numpy()
    noise = np.random.default_rng(0).standard_normal(seen.shape)
    image = CausticImage((seen + 0.01 * noise).astype(np.float32), np.full(1, 0.01))
    return ImageFit(SCENE, image, model, 2 * N), ImageFit(SCENE, image, model, N)


@pytest.mark.parametrize(("overlap", "missing"), [(0.0, 2), (1.0, 2), (1.0, 0)])
def test_a_missing_line_is_found_without_a_relief(overlap, missing):
    model = highest(overlap)
    fit, quick = fit_of(model, LINES)
    start = LINES[[k for k in range(3) if k != missing]]
    found = grown_in_shadows(fit, start, 10, quick)

    def error_um(lines):
        return 1e6 * float((model.heights(lines) - model.heights(LINES)).square().mean().sqrt())

    assert error_um(found.lines) < 0.2 * error_um(start)
    assert found.loss < 0.5 * fit.loss(model.heights(start))


def test_nothing_is_added_to_what_explains_the_image():
    model = highest()
    fit, quick = fit_of(model, LINES)
    assert torch.equal(grown_in_shadows(fit, LINES, 10, quick).lines, LINES)
    assert torch.equal(grown_in_shadows(fit, LINES[:2], 2, quick).lines, LINES[:2])


def test_a_line_that_goes_on_behind_a_higher_one_is_followed():
    """Where the highest is printed it disappears under one that lies along it, and 8 mm more show nothing."""
    over = 1e-3 * torch.tensor([-12.0, 0.0, 8.0, 0.5, 4.0, 1.0], dtype=torch.float64)
    under = 1e-3 * torch.tensor([-20.0, 0.0, 20.0, 0.0, 1.5, 0.3], dtype=torch.float64)
    short = under.clone()
    short[2] = -11e-3
    model = highest()
    fit, quick = fit_of(model, torch.stack([over, under]))
    moved, has_jumped = jump(fit, torch.stack([over, short]), quick=quick)
    assert has_jumped
    for _ in range(3):  # too far, and back
        moved, _ = jump(fit, fit.descend(moved, 10).lines, quick=quick)
    found = fit.descend(moved, 10)
    assert float(found.lines[1, [0, 2]].max()) == pytest.approx(20e-3, abs=2e-4)
