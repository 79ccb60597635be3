"""Lines added and removed by what the image says, on a small scene."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.growth import grown, pruned
from nets.reconstruct.fibres.search.line_search import FAINT_M, Answer, LineSearch
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.model import HEIGHT, LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 48
# Two wavelengths: growth sums over all; test_fibres.py has three.
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 1.0))
MODEL = LineModel(SCENE)
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.7],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9],
        # Little more than half a sample wide: the relief holds a blurred trace of it.
        [-18.0, 10.0, 12.0, 18.0, 0.6, 1.5],
    ],
    dtype=torch.float64,
)
NONE = torch.zeros(N, N)


def seen(lines):
    """With 1 % noise."""
    simulated = light_of(SCENE, MODEL.heights(lines)).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    return CausticImage((simulated + 0.01 * noise).astype(np.float32), np.full(2, 0.01))


def error_um(lines, expected=LINES):
    return 1e6 * float((MODEL.heights(lines) - MODEL.heights(expected)).square().mean().sqrt())


@pytest.fixture(scope="module")
def fit():
    return ImageFit(SCENE, seen(LINES), MODEL, 2 * N)


def answer_of(lines, wrong_um=5.0):
    """A relief as a network finds it: a few micrometres wrong everywhere, and unsure of that."""
    noise = torch.randn(N, N, generator=torch.Generator().manual_seed(2))
    return MODEL.heights(lines) + 1e-6 * wrong_um * noise, torch.full((N, N), 1e-6 * wrong_um)


@pytest.mark.parametrize("missing", [0, 2])
def test_a_missing_line_is_added(fit, missing):
    start = LINES[[k for k in range(3) if k != missing]]
    found = grown(fit, start, *answer_of(LINES), most=10)
    assert len(found.lines) > len(start)
    assert error_um(found.lines) < 0.1 * error_um(start)
    assert found.loss < 2 * fit.loss(MODEL.heights(LINES))
    assert len(pruned(fit, found.lines).lines) == 3


def test_nothing_is_added_to_what_explains_the_image(fit):
    """Even where the network saw a line that is not there; and never more than allowed."""
    ghost = 1e-3 * torch.tensor([[-5.0, -20.0, 15.0, -20.0, 3.0, 0.3]], dtype=torch.float64)
    relief, spread = answer_of(torch.cat([LINES, ghost]))
    found = grown(fit, LINES, relief, spread, most=10)
    assert torch.equal(found.lines, LINES)
    relief, spread = answer_of(LINES)
    assert torch.equal(grown(fit, LINES[:2], relief, spread, most=2).lines, LINES[:2])


def test_superfluous_lines_are_removed(fit):
    spare = 1e-3 * torch.tensor(
        [[-5.0, -20.0, 15.0, -20.0, 3.0, 0.01], [5.0, 20.0, 5.1, 20.0, 0.1, 0.01]], dtype=torch.float64
    )
    found = pruned(fit, torch.cat([spare, LINES]))
    assert torch.equal(found.lines, LINES)
    assert found.loss == pytest.approx(fit.loss(MODEL.heights(LINES)), rel=1e-6)
    assert torch.equal(pruned(fit, LINES).lines, LINES)


def test_a_search_finds_what_is_missing_and_drops_what_is_not_there():
    spare = 1e-3 * torch.tensor([[-5.0, -20.0, 15.0, -20.0, 3.0, 0.02]], dtype=torch.float64)
    answer = Answer(*answer_of(LINES))
    start = torch.cat([LINES[:2] + 5e-5, spare])
    search = LineSearch(SCENE, seen(LINES), MODEL, 2 * N, jumps=1, iterations=15, answer=answer)
    found = search.run(start)
    # One too low to be seen may be left where no view of the image says that all is explained.
    assert int((found[:, HEIGHT] > FAINT_M).sum()) == 3 and error_um(found) < 1.0 < 20 < error_um(start)


def test_faint_lines_that_make_up_for_a_wrong_one_are_left():
    """Two next to it, neither of which can go alone; one that was printed stays."""
    line = LINES[0]
    aside = 1e-3 * torch.tensor([-0.9, 1.3], dtype=torch.float64).repeat(2)
    beside = torch.stack([torch.cat([line[:4] + sign * aside, line[4:]]) for sign in (-1, 1)])
    beside[:, 5] = 1e-5
    lower = LINES.clone()
    lower[0, 5] *= 0.985
    answer = Answer(*answer_of(LINES))
    for printed, start, left in ((LINES, torch.cat([lower, beside]), 3), (None, None, 4)):
        if printed is None:
            low = torch.tensor([[-20e-3, -18e-3, 20e-3, -20e-3, 1.6e-3, 2.9e-5]], dtype=torch.float64)
            printed = start = torch.cat([LINES, low])
        search = LineSearch(SCENE, seen(printed), MODEL, 2 * N, jumps=1, iterations=30, answer=answer)
        search.lines = start
        search._leave_faint()
        assert len(search.lines) == left
        assert error_um(search.lines, printed) < 0.5


@pytest.mark.parametrize(("is_bent", "is_in_vain"), [(True, True), (False, False)])
def test_lines_that_leave_more_than_the_relief_they_are_of_are_given_up(monkeypatch, is_bent, is_in_vain):
    """A ring, which the network has found: no lines tell it, and the pixels of the image are not asked."""
    at = (np.arange(N) + 0.5) * SCENE.plate_size_m[0] / N - SCENE.plate_size_m[0] / 2
    off = np.abs(np.hypot(at[:, None], at[None]) - 12e-3)
    ring = torch.as_tensor(6e-4 * np.cos(np.pi * np.minimum(off / 4e-3, 0.5)) ** 2, dtype=torch.float32)
    relief = ring if is_bent else MODEL.heights(LINES)
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, 4 * N, 4 * N))
    image = CausticImage((light_of(SCENE, relief).numpy() + noise).astype(np.float32), np.full(2, 0.01))
    wrong = 2e-6 * torch.randn(N, N, generator=torch.Generator().manual_seed(2))
    answer = Answer(relief + wrong, torch.full((N, N), 2e-6), most=6)
    search = LineSearch(SCENE, image, MODEL, 2 * N, jumps=1, iterations=8, answer=answer)
    finely, descend = [], ImageFit.descend

    def counted(fit, *arguments, **options):
        if fit is not search.coarse:
            finely.append(fit)
        return descend(fit, *arguments, **options)

    monkeypatch.setattr(ImageFit, "descend", counted)
    start = LINES[:2].clone() if is_bent else LINES + 2e-5
    found = search.run(start)
    assert search.is_in_vain == is_in_vain and bool(finely) != is_in_vain
    assert len(found) and torch.equal(found, search.lines)


@pytest.mark.parametrize(("loss", "asked", "others", "is_in_vain"), [
    (0.1, 0, True, False), (0.9, 1, True, True), (0.9, 1, False, False), (1.1, 0, False, True),
])  # fmt: skip
def test_lines_that_do_not_do_well_give_way_to_others(loss, asked, others, is_in_vain):
    """They are asked for where lines leave nearly what the network's relief does; not where that is clear anyhow."""
    image, answer = seen(LINES), Answer(*answer_of(LINES))
    calls = []
    search = LineSearch(
        SCENE, image, MODEL, 2 * N, jumps=1, answer=answer, gives_way=lambda: calls.append(1) is None and others
    )
    of_relief = search.coarse.loss(answer.relief_m)
    assert search._is_in_vain(Fitted(LINES, loss * of_relief)) == is_in_vain and len(calls) == asked
    search.gives_way = None
    assert search._is_in_vain(Fitted(LINES, loss * of_relief)) == (loss > 1)
