"""Which of two results is taken, where both explain an image to some extent."""

from types import SimpleNamespace

import pytest

from nets.reconstruct.fibres.lines_of_image import LinesOfImage
from nets.reconstruct.fibres.method import CLEARLY_LESS, nearer_lines
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, noisy_image
from warp_caustics.prints.model import LineModel


@pytest.mark.parametrize(
    ("first", "later", "is_later"),
    [
        ((True, 0.02), (True, 0.03), False),
        ((True, 0.03), (True, 0.02), True),
        ((True, 0.03), (False, 0.02), False),
        ((False, 0.01), (True, 0.02), True),
        ((False, 0.03), (False, 0.02), False),
        ((False, None), (True, 0.1), True),
    ],
)
def test_of_two_benches_the_lines_are_taken_that_leave_less(first, later, is_later):
    searches = [
        SimpleNamespace(takes_lines=takes, counters={} if left is None else {"residual_of_fibres": left})
        for takes, left in (first, later)
    ]
    assert nearer_lines(*searches) is searches[is_later]


@pytest.mark.parametrize("share", [0.9, 0.98])
def test_lines_give_way_to_heights_that_leave_clearly_less(answering, monkeypatch, share):
    """Whatever lines are taken and leave more than noise, ``direct`` is asked."""
    found, fit, lines = [], LinesOfImage.fit, LinesOfImage.result

    def nearly(run):
        fit(run)
        run.takes_lines, run.is_noise_left = True, False

    monkeypatch.setattr(LinesOfImage, "fit", nearly)
    monkeypatch.setattr(LinesOfImage, "result", lambda run: found.append(lines(run)) or found[-1])
    monkeypatch.setattr(LinesOfImage, "residual_of", lambda run, other: share * found[-1].residual)
    model = LineModel(SCENE)
    truth = model.heights(LINES).double().numpy()
    options = {"refine_iterations": 3, "max_iterations": 8, "jumps": 0, "set_up": "known", "curves": False}
    result = answering(truth, **options).reconstruct(noisy_image(model))
    assert len(found) == 1 and found[0].fibres_m is not None
    assert result.counters["explained_by"] == ("network" if share < CLEARLY_LESS else "fibres")
    assert (result.fibres_m is None) == (share < CLEARLY_LESS)
