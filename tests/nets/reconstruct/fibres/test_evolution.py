"""Lines that evolve at a place, on a small scene."""

import pytest
import torch

import nets.reconstruct.fibres.search.evolution as evolution
import nets.reconstruct.fibres.search.rebuild as rebuild
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.evolution import APART_M, REACH_M, evolved, evolved_ends
from nets.reconstruct.fibres.search.moves import stretched
from nets.reconstruct.fibres.search.rebuild import rebuilt
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um, noisy_image
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage

HIDDEN = 1e-3 * torch.tensor([[-1.0, -1.5, 1.5, 1.0, 1.5, 0.6]], dtype=torch.float64)
"""On top of the others, nearer to where these cross than what is looked at of a place."""
PLACE = (0.0, 0.0)
TURNED = [2, 3, 0, 1, 4, 5]


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def fit(model):
    shown = LineModel(SCENE)
    image = noisy_image(_Printed(shown))
    few = ImageFit(SCENE, image, model, 2 * N, photons_per_pixel=4)
    return ImageFit(SCENE, image, model, 2 * N, metric=few)


class _Printed:
    """The three lines and the hidden one."""

    def __init__(self, model):
        self.scene, self._model = model.scene, model

    def heights(self, lines):
        return self._model.heights(torch.cat([lines, HIDDEN]))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_line_evolves_without_a_start(model, fit, seed):
    found = evolved(fit.metric, LINES, PLACE, seed)
    apart = min(float((line - HIDDEN[0])[:4].abs().max()) for line in (found[0], found[0][TURNED]))
    assert apart < 1e-3
    missing = error_um(model, LINES, torch.cat([LINES, HIDDEN]))
    assert error_um(model, torch.cat([LINES, found[:1]]), torch.cat([LINES, HIDDEN])) < 0.5 * missing


def test_what_is_found_lies_at_the_place_and_apart(model, fit):
    found = evolved(fit.metric, LINES, (1e-3, -2e-3))
    ends = found[:, :4].reshape(-1, 2, 2)
    assert float((ends - torch.tensor([1e-3, -2e-3])).abs().max()) <= REACH_M
    for k, line in enumerate(found):
        for other in found[:k]:
            assert all(float((line[:4] - e).abs().max()) > APART_M for e in (other[:4], other[[2, 3, 0, 1]]))


def test_the_same_seed_finds_the_same(model, fit, monkeypatch):
    monkeypatch.setattr(evolution, "GENERATIONS", 2)
    once, again = (evolved(fit.metric, LINES, PLACE, 3) for _ in range(2))
    assert torch.equal(once, again)


def test_evaluations_are_told_and_may_end_it(model, fit):
    def stopped(loss):
        raise KeyboardInterrupt

    timed = ImageFit(SCENE, noisy_image(model), model, 2 * N, photons_per_pixel=4, report=stopped)
    with pytest.raises(KeyboardInterrupt):
        evolved(timed, LINES, PLACE)


@pytest.mark.parametrize("evolves", [False, True])
def test_a_place_where_nothing_else_is_better_has_lines_evolve(model, fit, monkeypatch, evolves):
    """Two low, wide lines stand for a thin, high one; nothing that a ridge proposes is better."""
    low = HIDDEN.repeat(2, 1)
    low[:, 4] *= 2
    low[:, 5] *= 0.2
    low[1, :2] += 5e-4
    start = torch.cat([LINES, low])
    monkeypatch.setattr(rebuild, "_ways", lambda *about: iter(()))
    sure = torch.zeros(N, N)
    about = start, model.heights(start), sure
    found = rebuilt(fit, *about, is_enough=lambda lines: len(lines) == 4, evolves=evolves)
    if not evolves:
        assert found is None
        return
    truth = torch.cat([LINES, HIDDEN])
    assert found is not None and len(found.lines) == 4
    assert error_um(model, found.lines, truth) < 0.5 * error_um(model, start, truth)
    nearest = min(float((line - HIDDEN[0]).abs().max()) for line in (found.lines[-1], found.lines[-1][TURNED]))
    assert nearest < 2e-4


def test_ends_that_meet_find_their_places_together(model, fit):
    """Three lines end at one place, one too late and two too soon."""
    start = LINES.clone()
    start[:, 2:4] = torch.tensor([[1e-3, 0.0], [-1e-3, 1e-3], [0.0, -1e-3]], dtype=torch.float64)
    printed = start.clone()
    for k, by in enumerate((2e-3, -3e-3, 1.5e-3)):
        printed[k] = stretched(start[k], 2, by)
    shown = light_of(SCENE, model.heights(printed)).numpy()
    seen = ImageFit(SCENE, CausticImage(shown), model, 2 * N, photons_per_pixel=4)
    found = evolved_ends(seen, start, [(0, 2), (1, 2), (2, 2)])
    assert float((found - printed)[:, :4].abs().max()) < 5e-4
    assert torch.equal(found[:, 4:], start[:, 4:])
