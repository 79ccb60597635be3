"""Few lines over others that stay are all of them, whatever is printed where they cross."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.on_others import LinesOnOthers
from warp_caustics.prints.model import LineModel, Shape
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=64)
LINES = torch.tensor(
    [
        [-0.018, -0.012, 0.016, 0.013, 3.2e-3, 0.9e-3],
        [-0.015, 0.014, 0.019, -0.016, 2.0e-3, 1.3e-3],
        [-0.002, -0.020, 0.004, 0.021, 4.0e-3, 0.6e-3],
        [0.010, 0.010, 0.018, 0.020, 1.5e-3, 0.8e-3],
    ],
    dtype=torch.float64,
)


@pytest.mark.parametrize("overlap", [0.0, 0.2, 0.5, 1.0])
def test_lines_over_others_that_stay_are_all_of_them(overlap):
    model = LineModel(SCENE)
    model.shape = Shape(overlap=overlap)
    over = LinesOnOthers(model, LINES[2:])
    total, jacobian = model.with_jacobian(LINES)
    there, by_moving = over.with_jacobian(LINES[:2])
    np.testing.assert_allclose(there, total, atol=1e-9)
    np.testing.assert_allclose(by_moving, jacobian[: 2 * LINES.shape[1]], atol=1e-6)
    np.testing.assert_allclose(over.heights(LINES[:2]), total, atol=1e-9)
    np.testing.assert_allclose(over.heights(LINES[:0]), model.heights(LINES[2:]), atol=1e-9)
