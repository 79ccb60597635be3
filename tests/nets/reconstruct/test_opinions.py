"""Which of two networks is believed."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.reconstruct.methods import create
from nets.reconstruct.opinions import opinion
from nets.shipped import find_network, told_network
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.run_log import RunLog
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

TRUTH = torch.full((4, 4), 1e-3)


class Says:
    """A network whose answers are the truth and errors [m], two in each batch; another where it looks again."""

    def __init__(
        self, *errors: float, again: tuple[float, ...] = (), learns: float = 0.0, stops_after: int | None = None
    ):
        self.errors, self.again, self.learns, self.stops_after, self.asked = errors, again, learns, stops_after, 0
        self.has_feedback, self.given = bool(again or learns), []
        self.batches, self.device = len(errors or again) // 2, torch.device("cpu")
        working = SimpleNamespace(height_samples=4)
        self.network = SimpleNamespace(file=f"{errors}", seen=SimpleNamespace(working=working))

    def look(self, heights, caustic):
        assert torch.equal(caustic, 2 * heights)
        return heights

    def __call__(self, image, look=None):
        errors = self.errors if look is None else self.again
        if look is not None and self.learns:
            error = float((look - TRUTH).mean()) * self.learns
            errors = (error,) * 4
        if look is not None:
            self.given.append(float((look - TRUTH).mean()))
        for k in range(0, len(errors), 2):
            if self.stops_after == k:
                raise KeyboardInterrupt
            self.asked += 2
            yield torch.stack([TRUTH + error for error in errors[k : k + 2]])


def heard(*networks):
    """Their opinion, where the mean error [m] is what an answer leaves of the image."""

    def caustic(heights):
        return 2 * heights, float((heights - TRUTH).mean().abs())

    return opinion(networks, None, caustic, RunLog(0))


def error_of(found):
    return float((found.answers.mean(0) - TRUTH).mean())


def test_one_network_without_feedback_is_asked_once():
    found = heard(Says(1e-4, 2e-4, 1e-4, 2e-4))
    assert len(found.answers) == 4 and found.looked is found.answers and not found.record


def test_a_worse_second_is_asked_no_further():
    first, second = Says(1e-4, 2e-4, 1e-4, 2e-4), Says(3e-4, 3e-4, 0.0, 0.0)
    found = heard(first, second)
    assert found.source is first and len(found.answers) == 4 and second.asked == 2
    assert found.record["taken"] == "first" and list(found.record["residual"]) == ["first"]


def test_a_better_second_is_taken():
    first, second = Says(2e-4, 2e-4, 2e-4, 2e-4), Says(1e-5, 1e-5, 1e-5, 1e-5)
    found = heard(first, second)
    assert found.source is second and len(found.answers) == 4 and error_of(found) == pytest.approx(1e-5, rel=1e-2)
    assert found.record["taken"] == "second"


def test_both_where_their_errors_cancel():
    first, second = Says(2e-4, 2e-4, 2e-4, 2e-4), Says(-1e-4, -1e-4, -1e-4, -1e-4)
    found = heard(first, second)
    assert found.record["taken"] == "both" and len(found.answers) == len(found.looked) == 8
    assert error_of(found) == pytest.approx(5e-5, rel=1e-2) and found.source is first


def test_a_second_that_only_began_well_is_left():
    first, second = Says(1e-4, 1e-4, 1e-4, 1e-4), Says(5e-5, 5e-5, 9e-4, 9e-4)
    found = heard(first, second)
    assert found.source is first and found.record["taken"] == "first" and len(found.answers) == 4


def test_a_network_looks_again_at_its_own_answer():
    network = Says(1e-4, 3e-4, 1e-4, 3e-4, again=(1e-5, 3e-5, 1e-5, 3e-5))
    found = heard(network)
    assert network.given == [pytest.approx(2e-4, rel=1e-3)]
    assert found.record["taken"] == "first again" and error_of(found) == pytest.approx(2e-5, rel=1e-2)
    # How far to trust it is told by those that had not been given the same.
    assert found.looked.std(0).mean() == pytest.approx(1.15e-4, rel=0.01)


def test_a_second_look_that_makes_it_worse_is_left():
    found = heard(Says(1e-4, 1e-4, again=(2e-4, 2e-4)))
    assert found.record["taken"] == "first" and error_of(found) == pytest.approx(1e-4, rel=1e-2)


def test_the_second_looks_at_what_the_first_said():
    first, second = Says(1e-4, 3e-4), Says(9e-4, 9e-4, 9e-4, 9e-4, again=(3e-4, 3e-4, 0.0, 0.0))
    found = heard(first, second)
    assert second.given == [pytest.approx(2e-4, rel=1e-3)] and second.asked == 2  # one batch, which is worse
    assert found.record["taken"] == "first" and len(found.answers) == 2


def test_the_second_adds_to_what_the_first_said():
    first, second = Says(2e-4, 2e-4), Says(0.0, 0.0, again=(-3e-4, -3e-4, -3e-4, -3e-4))
    found = heard(first, second)
    assert found.record["taken"] == "both" and error_of(found) == pytest.approx(-5e-5, rel=1e-2)
    assert len(found.answers) == 4 and len(found.looked) == 2 and found.source is first


def test_where_the_first_knows_no_such_plate_the_second_looks_on():
    first, second = Says(8e-4, 8e-4), Says(0.0, 0.0, learns=0.25)
    found = heard(first, second)
    assert second.given == [pytest.approx(8e-4, rel=1e-3), pytest.approx(2e-4, rel=1e-3)]
    assert found.record["taken"] == "second again" and error_of(found) == pytest.approx(5e-5, rel=1e-2)
    assert found.source is found.looked_by is second and len(found.looked) == 4


def test_how_far_to_trust_a_second_look_is_told_by_the_first_lookers_own_spread():
    first, second = Says(1e-4, 3e-4), Says(0.0, 0.0, again=(1.9e-4, 1.9e-4, 5e-4, 5e-4))
    found = heard(first, second)
    assert found.record["taken"] == "second" and found.source is second and found.looked_by is first


@pytest.mark.parametrize("after", [0, 2])
@pytest.mark.parametrize("again", [(), (0.0, 0.0, 0.0, 0.0)])
def test_an_interrupt_keeps_what_the_first_said(after, again):
    first = Says(1e-4, 1e-4)
    found = heard(first, Says(0.0, 0.0, 0.0, 0.0, again=again, stops_after=after))
    assert found.reason == "interrupted" and found.source is first and len(found.answers) == 2


def test_who_is_asked():
    def asked(scene, **options):
        return [each.network.file for each in create("direct", scene, **options).asked]

    own, told = "direct.safetensors", "direct-family.safetensors"
    assert asked(Scene()) == [own, told]
    assert asked(Scene(), second_opinion=False) == [own]
    assert asked(Scene(base_thickness_m=4e-3)) == [told]
    first = find_network("direct", Scene(), any_grid=True)
    assert told_network("direct", Scene(base_thickness_m=2e-2), first) is None  # beyond its family
    assert told_network("direct", Scene(), first).file == told
    second = find_network("direct", Scene(base_thickness_m=4e-3), any_grid=True)
    assert told_network("direct", Scene(base_thickness_m=4e-3), second) is None  # is told itself


def test_rings_are_told_by_the_network_that_has_seen_them():
    """The scene's own has seen straight lines only; the heights that explain the image better are nearer."""
    scene = Scene()
    config = DatasetConfig(kind="updater", n_samples=1, seed=91, scene=scene, reliefs={"pattern": "rings"})
    truth = Reliefs(config, "cpu").true([0])[0]
    image = CausticImage(CausticSimulator(scene, "lattice", n_photons=262_144)(truth).numpy())
    heights = {}
    for second in (False, True):
        options = {"refine": False, "symmetries": False, "causes": False}
        found = create("direct", scene, second_opinion=second, **options).reconstruct(image)
        heights[second] = found.heights_m
        if second:
            assert found.counters["networks"]["taken"] != "first"
    error = {key: np.sqrt(((each - truth.numpy()) ** 2).mean()) for key, each in heights.items()}
    assert error[True] < 0.9 * error[False]
