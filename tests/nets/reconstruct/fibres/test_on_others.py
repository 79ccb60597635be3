"""Few lines over others that stay are all of them, whatever is printed where they cross."""

import numpy as np
import pytest

from nets.reconstruct.fibres.image.on_others import LinesOnOthers
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel


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
