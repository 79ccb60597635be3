"""What is covered, region by region, and what a doubt is worth."""

import numpy as np
import pytest

from nets.evaluation.bench.coverage import COVERAGE, REGIONS, WITHIN, covered_shares, region_masks
from nets.evaluation.bench.detector import WRONG, detection, is_wrong
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=128)


def ridge(height_m):
    """A round ridge along y [m], 3 mm wide, shape [128, 128]."""
    x = (np.arange(128) + 0.5) / 128 * SCENE.plate_size_m[0]
    across = np.abs(x - SCENE.plate_size_m[0] / 2) / (0.03 * SCENE.plate_size_m[0])
    return np.tile(height_m * np.where(across < 1, np.cos(np.pi / 2 * np.minimum(across, 1)) ** 2, 0.0), (128, 1))


def test_regions_part_the_plate():
    regions = region_masks(ridge(6e-4), SCENE)
    assert list(regions) == list(REGIONS)
    assert (regions["_bare"] ^ regions["_on_relief"]).all() and regions[""].all()
    np.testing.assert_array_equal(regions["_on_lines"] ^ regions["_on_folds"], regions["_on_relief"])
    # A ridge that is high enough to focus between plate and screen folds on its flanks or top; a low one nowhere.
    assert regions["_on_folds"].any() and regions["_on_lines"].any()
    low = region_masks(ridge(5e-6), SCENE)
    assert not low["_on_folds"].any() and low["_on_lines"].any()


def test_shares_are_of_their_region():
    regions = region_masks(ridge(6e-4), SCENE)
    error = np.select([regions["_bare"], regions["_on_lines"]], [0.5e-6, 1.5e-6], 3e-6)
    shares = covered_shares(error, regions, np.full((128, 128), 1e-6))
    assert set(shares) == set(COVERAGE)
    of = {region: [shares[name + region] for name in WITHIN] for region in REGIONS}
    assert of["_bare"] == [1, 1] and of["_on_lines"] == [0, 1] and of["_on_folds"] == [0, 0]
    on_lines = regions["_on_lines"].sum() / regions["_on_relief"].sum()
    assert of["_on_relief"] == [0, pytest.approx(on_lines)]
    assert of[""] == [pytest.approx(regions["_bare"].mean()), pytest.approx(1 - regions["_on_folds"].mean())]


def test_what_is_not_there_has_no_share():
    bare = region_masks(np.zeros((128, 128)), SCENE)
    shares = covered_shares(np.zeros((128, 128)), bare, np.full((128, 128), 1e-6))
    assert shares["within_one_bare"] == 1 and shares["within_two_on_relief"] is None
    assert set(covered_shares(np.zeros((128, 128)), bare, None).values()) == {None}


def row(rmse, stated, doubted):
    return {"rmse_um": rmse, "stated_um": stated, "doubted": doubted}


def test_a_detector_is_counted():
    assert not is_wrong(WRONG, 1.0) and is_wrong(WRONG * 1.01, 1.0)
    rows = [row(10, 1, True), row(10, 1, False), row(2, 1, True), row(1, 1, False), row(1, 2, False)]
    unknown = [row(10, None, True), row(None, 1, False), row(10, 1, None), {}]
    assert detection(rows + unknown) == (2, 1, 3, 1)
    assert detection(rows).line == (
        "2 of 5 results are off by more than 3 times what they state, 1 of them say so; of the 3 others 1 say so"
    )
    assert detection([]) == (0, 0, 0, 0)
