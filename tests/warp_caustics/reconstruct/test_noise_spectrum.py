"""Noise that neighbouring pixels share, made white."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from warp_caustics.reconstruct.noise_spectrum import Whitening

PIXELS = 128


def shared_noise(seed, width_px=1.0, white=0.6):
    """Of standard deviation 1: speckle as wide, and white noise beside it."""
    rng = np.random.default_rng(seed)
    grain = gaussian_filter(rng.standard_normal((2, PIXELS, PIXELS)), (0, width_px, width_px), mode="wrap")
    both = grain / grain.std() + white * rng.standard_normal(grain.shape)
    return torch.from_numpy(both / both.std())


def in_common(values, apart):
    """Correlation of pixels so far apart along rows."""
    return float((values[..., apart:] * values[..., :-apart]).mean() / values.square().mean())


def test_neighbours_share_nothing_of_it_afterwards():
    left, ones = shared_noise(0), torch.ones(2, PIXELS, PIXELS, dtype=torch.float64)
    white = Whitening.of(left, ones)(left)
    assert in_common(left, 1) > 0.5 and in_common(left, 2) > 0.2
    assert float(white.square().mean()) == pytest.approx(1.0, abs=0.02)
    assert all(abs(in_common(white, apart)) < 0.02 for apart in (1, 2, 3, 5))


def test_noise_of_another_image_becomes_white_too():
    """So that what is found is the noise's spectrum, and not the noise."""
    ones = torch.ones(2, PIXELS, PIXELS, dtype=torch.float64)
    other = Whitening.of(shared_noise(0), ones)(shared_noise(1))
    assert float(other.square().mean()) == pytest.approx(1.0, abs=0.03)
    assert all(abs(in_common(other, apart)) < 0.03 for apart in (1, 2, 3))


def test_white_noise_stays_as_it_is():
    ones = torch.ones(1, PIXELS, PIXELS, dtype=torch.float64)
    left = torch.from_numpy(np.random.default_rng(2).standard_normal((1, PIXELS, PIXELS)))
    white = Whitening.of(left, ones)(left)
    assert float((white * left).mean() / white.square().mean().sqrt()) > 0.98
    torch.testing.assert_close(Whitening.none(ones)(left), left)


def test_pixels_that_do_not_count_are_not_seen():
    left, counts = shared_noise(3), torch.ones(2, PIXELS, PIXELS, dtype=torch.float64)
    counts[:, :9] = counts[:, -9:] = 0.0
    spoilt = left.clone()
    spoilt[:, :9], spoilt[:, -9:] = 1e3, -1e3
    white = Whitening.of(spoilt, counts)
    torch.testing.assert_close(white.gain, Whitening.of(left, counts).gain)
    torch.testing.assert_close(white(spoilt), white(left))
    assert not white(left)[:, :9].any()
    inside = white(left)[:, 12:-12]
    assert float(inside.square().mean()) == pytest.approx(1.0, abs=0.03)


def test_what_is_fine_is_told_better_by_least_squares_of_white_noise():
    """The amplitude of a stripe pattern, in 100 images: as far off as its information says (Gauss-Markov)."""
    ones = torch.ones(2, PIXELS, PIXELS, dtype=torch.float64)
    white = Whitening.of(shared_noise(0), ones)
    shape = torch.cos(2.2 * torch.arange(PIXELS, dtype=torch.float64)).expand(2, PIXELS, PIXELS)
    plain, whitened = [], []
    information = float(white(shape).square().sum())
    for seed in range(100):
        noise = shared_noise(10 + seed)
        plain.append(float((shape * noise).sum() / shape.square().sum()))
        whitened.append(float((white(shape) * white(noise)).sum()) / information)
    # Of one frequency both are the same estimate; what is told of its error is not.
    told_by_white, told = float(shape.square().sum()) ** -0.5, information**-0.5
    assert np.std(whitened) == pytest.approx(np.std(plain), rel=0.05)
    assert np.std(whitened) == pytest.approx(told, rel=0.25)
    assert told_by_white > 1.3 * np.std(plain)
