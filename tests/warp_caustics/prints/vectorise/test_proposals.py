"""Ridges are followed as far as they go, and no farther."""

import numpy as np
import pytest
import scipy

from warp_caustics.prints.vectorise import proposals
from warp_caustics.prints.vectorise.proposals import ANGLES, FOLLOWED_STEPS, RIDGE_END_SHARE


@pytest.mark.parametrize("seed", range(4))
def test_ridges_end_where_they_did_when_all_were_followed_to_the_end(seed):
    """Runs above both thresholds, of ridges that reach the plate's border, end within it, or are a single peak."""
    smooth = scipy.ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((64, 64)), (1.5, 4.0)) * 1e-3
    smooth[30] += 1e-3
    smooth[:, 9] += 5e-4
    tops = np.array([[30, 20], [30, 63], [5, 9], [*np.unravel_index(smooth.argmax(), smooth.shape)], [0, 0]])
    smooth[0, 0] = smooth.max() / 3
    steps = np.arange(-FOLLOWED_STEPS, FOLLOWED_STEPS + 1) / 2
    angles = np.arange(ANGLES) * np.pi / ANGLES
    at = tops.T[:, :, None, None] + np.stack([np.sin(angles), np.cos(angles)])[:, None, :, None] * steps
    everywhere = scipy.ndimage.map_coordinates(smooth, at, order=1, mode="constant", cval=-1.0)
    followed = proposals._along(smooth, tops)
    height = smooth[tuple(tops.T)][:, None, None]
    ends = []
    for share in (RIDGE_END_SHARE, 0.5):
        first, last = proposals._runs(everywhere > share * height)
        np.testing.assert_array_equal(proposals._runs(followed > share * height), (first, last))
        ends += [int((last - first).max()), int((last - first).min())]
    assert ends[0] > 60 and ends[1] < 10
    middle = followed[..., FOLLOWED_STEPS - 3 : FOLLOWED_STEPS + 4]
    np.testing.assert_allclose(middle, everywhere[..., FOLLOWED_STEPS - 3 : FOLLOWED_STEPS + 4], atol=1e-15)
