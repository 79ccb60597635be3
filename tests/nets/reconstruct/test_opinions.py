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
    """A network whose answers are the truth and errors [m], two in each batch."""

    def __init__(self, *errors: float, stops_after: int | None = None):
        self.errors, self.stops_after, self.asked = errors, stops_after, 0
        self.batches, self.device = len(errors) // 2, torch.device("cpu")
        working = SimpleNamespace(height_samples=4)
        self.network = SimpleNamespace(file=f"{errors}", seen=SimpleNamespace(working=working))

    def __call__(self, image):
        for k in range(0, len(self.errors), 2):
            if self.stops_after == k:
                raise KeyboardInterrupt
            self.asked += 2
            yield torch.stack([TRUTH + error for error in self.errors[k : k + 2]])


def heard(*networks):
    """Their opinion, where the mean error [m] is what an answer leaves of the image."""
    return opinion(networks, None, lambda heights: float((heights - TRUTH).mean().abs()), RunLog(0))


def error_of(found):
    return float((found.answers.mean(0) - TRUTH).mean())


def test_a_worse_second_is_asked_no_further():
    first, second = Says(1e-4, 2e-4, 1e-4, 2e-4), Says(3e-4, 3e-4, 0.0, 0.0)
    found = heard(first, second)
    assert found.source is first and len(found.answers) == 4 and second.asked == 2
    assert found.record["taken"] == "first" and found.record["residual_at_a_glance"]["second"] == pytest.approx(3e-4)


def test_a_better_second_is_taken():
    first, second = Says(2e-4, 2e-4, 2e-4, 2e-4), Says(1e-5, 1e-5, 1e-5, 1e-5)
    found = heard(first, second)
    assert found.source is second and len(found.answers) == 4 and error_of(found) == pytest.approx(1e-5, rel=1e-2)
    assert found.record["taken"] == "second"


def test_both_where_their_errors_cancel():
    first, second = Says(2e-4, 2e-4, 2e-4, 2e-4), Says(-1e-4, -1e-4, -1e-4, -1e-4)
    found = heard(first, second)
    assert found.record["taken"] == "both" and len(found.answers) == 8
    assert error_of(found) == pytest.approx(5e-5, rel=1e-2) and found.source is first


def test_a_second_that_only_began_well_is_left():
    first, second = Says(1e-4, 1e-4, 1e-4, 1e-4), Says(5e-5, 5e-5, 9e-4, 9e-4)
    found = heard(first, second)
    assert found.source is first and found.record["taken"] == "first" and len(found.answers) == 4


@pytest.mark.parametrize("after", [0, 2])
def test_an_interrupt_keeps_what_the_first_said(after):
    first = Says(1e-4, 1e-4)
    found = heard(first, Says(0.0, 0.0, 0.0, 0.0, stops_after=after))
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
        found = create("direct", scene, refine=False, symmetries=False, second_opinion=second).reconstruct(image)
        heights[second] = found.heights_m
        if second:
            assert found.counters["networks"]["taken"] != "first"
    error = {key: np.sqrt(((each - truth.numpy()) ** 2).mean()) for key, each in heights.items()}
    assert error[True] < 0.9 * error[False]
