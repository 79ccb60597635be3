"""Single lines fitted to a relief in one batch, against one fit after the other."""

import math

import numpy as np
import torch

from warp_caustics.prints.fit import fit_lines
from warp_caustics.prints.fit_each import fit_each
from warp_caustics.prints.model import LineModel
from warp_caustics.scene import Scene

N = 48
MODEL = LineModel(Scene(height_samples=N, image_pixels=N))
TRUE = 1e-3 * torch.tensor([[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7]], dtype=torch.float64)
NEAR = 1e-3 * torch.tensor([[0.4, -0.3, -0.5, 0.3, -0.6, 0.1], [-0.3, 0.5, 0.3, -0.4, 0.5, -0.2]], dtype=torch.float64)
FAR = 1e-3 * torch.tensor([[10.0, 15.0, 20.0, 18.0, 2.0, 0.3]], dtype=torch.float64)
SIGMA = torch.full((N, N), 2e-5)


def test_each_line_finds_the_printed_one():
    """Whatever the others do, one of which is far away from everything."""
    relief = MODEL.heights(TRUE)
    starts = torch.cat([TRUE + NEAR, FAR])
    found, losses = fit_each(MODEL, starts, relief, SIGMA, iterations=20)
    np.testing.assert_allclose(found[:2].numpy(), TRUE.expand(2, 6).numpy(), atol=5e-6)
    assert float(losses[:2].max()) < 0.1 < float(losses[2])


def test_as_one_after_the_other():
    relief = MODEL.heights(torch.cat([TRUE, FAR]))
    starts = TRUE + NEAR
    together = fit_each(MODEL, starts, relief, SIGMA, iterations=20)
    for k, start in enumerate(starts):
        line, loss = fit_lines(MODEL, start[None], relief, SIGMA, iterations=20)
        np.testing.assert_allclose(together[0][k].numpy(), line[0].numpy(), atol=2e-6)
        np.testing.assert_allclose(float(together[1][k]), loss, rtol=1e-3)


def test_no_lines_need_no_fit():
    found, losses = fit_each(MODEL, TRUE[:0], SIGMA, SIGMA, iterations=5)
    assert found.shape == (0, 6) and losses.shape == (0,)


def test_what_is_out_of_reach_is_given_up(monkeypatch):
    """Sooner than it would end, by both; what can be reached is not."""
    relief, evaluations = MODEL.heights(torch.cat([TRUE, FAR])), []
    parts = MODEL.parts
    monkeypatch.setattr(MODEL, "parts", lambda lines: evaluations.append(len(lines)) or parts(lines))
    start = TRUE + NEAR[:1]
    for fit in (fit_each, fit_lines):
        spent = []
        for below in (math.inf, 1e3, 1e-3):
            evaluations.clear()
            found = fit(MODEL, start, relief, SIGMA, iterations=20, below=below)
            spent.append((len(evaluations), float(found[1])))
        free, easy, hopeless = spent
        assert easy == free and hopeless[0] < free[0] and hopeless[1] >= free[1]
