"""Shapes of footprints: what a GPU evaluates in fewer operations is the same Gaussian."""

import math

import numpy as np
import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.profiles import GAUSSIAN_REACH, NORMALISATION, REACH, WIDENING, profile_functions
from warp_caustics.kernels.runtime import start_warp


@made_once
def kernel(dtype, is_brief):
    cumulative, density = profile_functions(dtype, "gaussian", is_brief)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(t: wp.array[dtype], values: wp.array2d[dtype]):
        i = wp.tid()
        values[0, i] = cumulative(t[i])
        values[1, i] = density(t[i])

    return evaluate


def evaluated(t, dtype, is_brief):
    start_warp()
    values = wp.zeros((2, len(t)), dtype=dtype, device="cpu")
    wp.launch(
        kernel(dtype, is_brief), dim=len(t), inputs=[wp.array(t, dtype=dtype, device="cpu"), values], device="cpu"
    )
    return values.numpy()


def test_brief_gaussian():
    """To 1e-7 of the whole, in float32 too; nothing and everything beyond its ends; density the same but for rounding."""
    reach = REACH["gaussian"]
    t = np.linspace(-1.2 * reach, 1.2 * reach, 4801)
    u = np.clip(t / math.sqrt(WIDENING), -GAUSSIAN_REACH, GAUSSIAN_REACH)
    exact = 0.5 + 0.5 * NORMALISATION * np.array([math.erf(x / math.sqrt(2)) for x in u])
    for dtype, rounding in ((wp.float64, 0.0), (wp.float32, 2e-7)):
        cumulative, density = evaluated(t, dtype, True)
        assert np.abs(cumulative - exact).max() <= 1e-7 + rounding
        assert np.all(cumulative[t < -reach] == 0) and np.all(cumulative[t > reach] == 1)
        assert np.abs(density - evaluated(t, dtype, False)[1]).max() <= 1e-15 + rounding
