"""A recorded network answers as the network does, whatever it is given next."""

import pytest
import torch
from torch import nn

from nets.replayed import Replayed


@pytest.mark.parametrize(
    "device",
    [
        "cpu",
        pytest.param(
            "cuda",
            marks=[pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")],
        ),
    ],
)
def test_answers_are_the_networks(device):
    torch.manual_seed(0)
    module = nn.Sequential(nn.Conv2d(3, 8, 3, padding=1), nn.GELU(), nn.Conv2d(8, 1, 3, padding=1)).to(device).eval()
    replayed, kept = Replayed(module), []
    inputs = [torch.randn(batch, 3, 16, 16, device=device) for batch in (2, 2, 2, 1, 1, 2)]
    for x in inputs:
        kept.append(replayed(x))
    with torch.no_grad():
        for x, answer in zip(inputs, kept, strict=True):
            torch.testing.assert_close(answer, module(x), rtol=1e-3, atol=1e-3)
            assert not answer.requires_grad
