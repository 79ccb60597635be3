"""Samples of what an image leaves open, with answers that are made up."""

import numpy as np
import pytest
import torch

from nets.reconstruct.posterior_samples import SLACK, farthest, posterior_samples
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N)
FIBRE = Line((-0.018, -0.012), (0.014, 0.012), 4e-3, 3e-4)
DROP = Line((0.012, -0.012), (0.012, -0.012), 4e-3, 1e-4)
NOISE = 0.01


def relief(*lines):
    return line_relief(lines, N, SCENE.plate_size_m)


def seen(heights, hidden=()):
    """The image of heights, with pixels that do not count around hidden points (x, y) [m]."""
    simulator = CausticSimulator(SCENE, "lattice")
    light = simulator(torch.tensor(heights, dtype=torch.float32)).numpy()
    light = light + NOISE * np.random.default_rng(0).standard_normal(light.shape).astype(np.float32)
    at = (np.arange(4 * N) + 0.5) / (4 * N) * 0.05 - 0.025
    mask = np.ones(light.shape, bool)
    for x, y in hidden:
        mask[:, np.hypot(at[:, None] - y, at[None, :] - x) < 4.5e-3] = False
    return Resimulation(simulator, CausticImage(light, np.full(3, NOISE), mask))


def samples(count, answers, resimulation, result=None, **options):
    stack = torch.tensor(np.stack(answers))
    found = stack.mean(0).numpy() if result is None else result
    return posterior_samples(count, found, stack, resimulation, lambda heights: heights, **options)


def test_samples_differ_where_the_image_is_open_and_agree_elsewhere():
    """Half of the answers have a drop of glass where no pixel counts."""
    bare, full = relief(FIBRE), relief(FIBRE, DROP)
    found = samples(4, [bare, full, bare, full], seen(bare, [DROP.start_m]), bare)
    assert found.heights_m.shape == (4, N, N)
    there = relief(DROP) > 3e-5
    apart = found.heights_m.std(axis=0)
    assert apart[there].min() > 1e-5 and apart[relief(DROP) == 0].max() < 1e-6
    assert 0.5 * there.mean() < found.share < 3 * (relief(DROP) > 0).mean()
    assert np.abs(found.residuals - found.residual).max() < 0.02 * found.residual
    assert "they differ by" in found.line and found.record["count"] == 4


def test_what_the_image_decides_is_in_no_sample():
    """The same drop in sight of the camera: an answer that has it leaves more of the image, and is not believed."""
    bare, full = relief(FIBRE), relief(FIBRE, DROP)
    found = samples(4, [bare, full, bare, full], seen(bare), bare)
    np.testing.assert_allclose(found.heights_m, np.broadcast_to(bare, (4, N, N)), atol=1e-9)
    assert found.share == 0 and "agree everywhere" in found.line


def test_parts_are_judged_one_by_one():
    """Of two drops only the one out of sight is open."""
    other = Line((-0.014, 0.014), (-0.014, 0.014), 4e-3, 1e-4)
    bare, both = relief(FIBRE), relief(FIBRE, DROP, other)
    found = samples(2, [bare, both], seen(bare, [DROP.start_m]), bare)
    assert found.heights_m.std(axis=0)[relief(DROP) > 3e-5].min() > 1e-5
    assert np.abs(found.heights_m - bare)[:, relief(other) > 0].max() < 1e-6


def test_every_sample_explains_the_image_about_as_well():
    """Answers that err at random: what is taken over raises the rest of the image by no more than the slack."""
    truth = relief(FIBRE)
    rng = np.random.default_rng(2)
    answers = [truth + 3e-5 * rng.standard_normal() * relief(FIBRE) / 3e-4 for _ in range(6)]
    found = samples(5, answers, seen(truth), truth)
    assert (found.residuals**2 <= (1 + SLACK) * found.residual**2).all()


def test_how_many_lie_within_two_uncertainties_is_told():
    bare, full = relief(FIBRE), relief(FIBRE, DROP)
    at = seen(bare, [DROP.start_m])
    wide = samples(2, [bare, full], at, bare, uncertainty_m=np.full((N, N), 1e-3))
    narrow = samples(2, [bare, full], at, bare, uncertainty_m=np.full((N, N), 1e-7))
    assert wide.within_two == 1.0 and narrow.within_two < 0.9


def test_an_image_whose_noise_cannot_be_told_has_none(monkeypatch):
    resimulation = seen(relief(FIBRE))
    monkeypatch.setattr(resimulation, "rest", lambda heights, found_at: None)
    assert samples(2, [relief(FIBRE), relief(FIBRE, DROP)], resimulation) is None


@pytest.mark.parametrize("count", [1, 2, 5])
def test_those_farthest_apart_are_chosen(count):
    reliefs = np.array([0.0, 1.0, 1.1, 10.0, -8.0])[:, None, None] * np.ones((1, 2, 2))
    chosen = farthest(reliefs, count)
    assert chosen[:3] == [3, 4, 2][:count] or chosen[:3] == [3, 4, 1]
    assert len(set(chosen)) == count and farthest(reliefs, 2, first=4) == [4, 3]
