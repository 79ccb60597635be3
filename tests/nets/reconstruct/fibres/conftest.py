"""What tests of the whole method share."""

import pytest
import torch

import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.methods import create
from tests.nets.reconstruct.fibres.three_lines import SCENE


@pytest.fixture
def answering(monkeypatch, saved):
    """A method ``fibres`` whose network says what it is told."""

    def make(heights_m, **options):
        def answers(images):
            found = torch.as_tensor(heights_m, dtype=torch.float32)
            return found.expand(len(images), *found.shape).clone()

        monkeypatch.setattr(answers_module, "Replayed", lambda module: answers)
        weights = saved("direct", scene=SCENE)
        return create("fibres", SCENE, weights=weights, symmetries=False, **options)

    return make
