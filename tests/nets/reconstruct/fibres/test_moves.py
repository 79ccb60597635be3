"""Jumps of lines that descents cannot make."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import drops, is_short, jump
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 128
SCENE = Scene(height_samples=N, image_pixels=2 * N, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
DROP = 1e-3 * torch.tensor([-11.0, -9.2, -11.0, -9.2, 2.43, 0.63], dtype=torch.float64)
SHORT = 1e-3 * torch.tensor([-11.0, -9.36, -11.0, -9.03, 2.22, 0.53], dtype=torch.float64)
LONG = 1e-3 * torch.tensor([3.0, -9.0, 9.0, 12.0, 1.5, 0.4], dtype=torch.float64)


def test_a_drop_that_a_short_line_tells_is_found():
    """From a line 0.33 mm long and a sixth lower, where a descent stays."""
    model = LineModel(SCENE)
    printed = torch.stack([DROP, LONG])
    shown = light_of(SCENE, model.heights(printed)).numpy()
    fit = ImageFit(SCENE, CausticImage(shown, np.full(1, 0.01)), model, 2 * N)

    def error_um(lines):
        return 1e6 * float((model.heights(lines) - model.heights(printed)).square().mean().sqrt())

    stuck = fit.descend(torch.stack([SHORT, LONG]), 40)
    moved, has_jumped = jump(fit, stuck.lines)
    found = fit.descend(moved, 20)
    assert has_jumped and found.loss < 0.7 * stuck.loss
    assert 3 * error_um(found.lines) < error_um(stuck.lines)


def test_drops_stand_for_short_lines_alone():
    assert is_short(SHORT) and is_short(DROP) and not is_short(LONG)
    found = torch.stack(list(drops(SHORT)))
    middle = torch.tensor([-11e-3, -9.195e-3], dtype=torch.float64)
    torch.testing.assert_close(found[:, :2], middle.expand(len(found), 2))
    torch.testing.assert_close(found[:, 2:4], found[:, :2])
    # Of the true drop, one is within a tenth in both numbers.
    assert ((found[:, 4:] / DROP[4:] - 1).abs().amax(dim=1)).min() < 0.1
    assert float(found[:, 5].max() / found[:, 5].min()) == pytest.approx(4.8)
