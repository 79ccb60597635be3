"""Planning: closed forms, exact light paths and the simulator agree."""

import math

import numpy as np
import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.plan import Fibre, highest_unfolded_m, magnification, plan
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


def scene(gap_m=1e-6, **fields):
    return Scene(screen_position_m=(0.0, 0.0, -gap_m), **fields)


@pytest.mark.parametrize(("width_m", "height_m"), [(2e-3, 1e-5), (4e-3, 1e-4), (1e-3, 1e-5)])
def test_gentle_fibres_focus_where_the_formula_says(width_m, height_m):
    found = plan(scene(), Fibre(width_m, height_m))
    assert found.traced_focus_m == pytest.approx(found.focus_m, rel=0.01)


@pytest.mark.parametrize("width_m", [1e-3, 4e-3])
@pytest.mark.parametrize("gap_m", [1e-6, 5e-3, 0.1])
def test_the_highest_fibre_that_does_not_fold(width_m, gap_m):
    limit = highest_unfolded_m(scene(gap_m), width_m)
    assert not plan(scene(gap_m), Fibre(width_m, 0.9 * limit)).folds
    assert plan(scene(gap_m), Fibre(width_m, 1.1 * limit)).folds


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_the_light_map_of_a_printed_line_folds_where_the_plan_does(factor):
    """Exact derivatives of the spline relief, by other code."""
    set_up = scene(5e-3, plate_size_m=(0.01, 0.01), height_samples=256)
    fibre = Fibre(2e-3, factor * highest_unfolded_m(set_up, 2e-3))
    line = Line((-0.02, 0.0), (0.02, 0.0), fibre.width_m, fibre.height_m)
    relief = line_relief([line], 256, set_up.plate_size_m)
    assert (fold_fraction(relief, set_up) > 0) == plan(set_up, fibre).folds == (factor > 1)


def test_the_brightest_pixel_is_that_of_the_simulator():
    set_up = scene(5e-3, plate_size_m=(0.02, 0.02), height_samples=512, image_pixels=256)
    fibre = Fibre(4e-3, 1e-4)
    relief = line_relief([Line((-0.05, 0.0), (0.05, 0.0), 4e-3, 1e-4)], 512, set_up.plate_size_m)
    simulator = CausticSimulator(set_up, n_photons=2048**2)
    across = simulator(torch.tensor(relief, dtype=simulator.dtype))[1].numpy()[:, 128]
    found = plan(set_up, fibre)
    assert found.brightest == pytest.approx(across.max(), rel=0.05)
    assert found.darkest == pytest.approx(across[20:-20].min(), rel=0.03)


def test_blur_of_a_lamp_grows_with_the_screens_distance():
    near, far = (plan(scene(gap), Fibre(2e-3, 1e-5), 5e-3) for gap in (5e-3, 5e-2))
    assert far.lamp_blur_m == pytest.approx(5e-3 * (5e-2 + 3e-3 / 1.46) / 2, rel=0.01)
    assert far.brightest < plan(scene(5e-2), Fibre(2e-3, 1e-5)).brightest
    assert near.lamp_blur_px < far.lamp_blur_px
    assert [advice.rating for advice in far.advice if advice.topic == "lamp"] == ["bad"]


def test_a_lamp_without_collimator_spreads_the_light():
    lamp = {"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.0, 0.5)}
    lit = scene(0.05, **lamp)
    assert magnification(lit) == pytest.approx(1 + (0.05 + 3e-3 / 1.46) / 0.497, rel=1e-3)
    assert plan(lit, Fibre(2e-3, 1e-5)).focus_m > plan(scene(0.05), Fibre(2e-3, 1e-5)).focus_m


def test_advice_has_every_topic_and_plain_numbers():
    found = plan(scene(5e-3), Fibre(2e-3, 2e-4), 1e-3)
    assert [advice.topic for advice in found.advice] == ["folds", "lamp", "size", "exposure"]
    assert found.folds and "print lower than" in found.advice[0].text
    assert 0 < found.flat_level < 1 and np.isfinite(found.farthest_shift_m)


@pytest.mark.parametrize(
    ("width_m", "height_m"), [(0, 1e-4), (2.0, 1e-4), (1e-3, -1e-4), (math.nan, 1e-4), (1e-300, 1e-4)]
)
def test_what_is_no_fibre_is_refused(width_m, height_m):
    with pytest.raises(InputError, match=r"not between 1e-07 and 0\.1 m"):
        Fibre(width_m, height_m)
