"""Convolutions in shapes for tensor cores: the same numbers and gradients as those that are printed."""

from types import SimpleNamespace

import pytest
import torch
from torch.nn import functional

from nets import unet
from nets.config import UpdaterConfig
from nets.wide_convolutions import doubled, halved, is_wanted, round_channels, widened


@pytest.mark.parametrize("kernel", range(2, 17))
def test_strided_kernels_are_kernels_over_blocks(kernel):
    generator = torch.Generator().manual_seed(kernel)
    x = torch.randn(2, 3, 12, 8, dtype=torch.float64, generator=generator)
    weight = torch.randn(5, 3, kernel, kernel, dtype=torch.float64, generator=generator)
    bias = torch.randn(5, dtype=torch.float64, generator=generator)
    margin = (kernel - 1) // 2
    straight = functional.conv2d(x, weight, bias, stride=2, padding=margin)
    torch.testing.assert_close(halved(x, weight, bias), straight, rtol=1e-12, atol=1e-12)
    back = weight.transpose(0, 1).contiguous()
    straight = functional.conv_transpose2d(x, back, bias, stride=2, padding=margin, output_padding=kernel % 2)
    torch.testing.assert_close(doubled(x, back, bias), straight, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("channels", "wide"), [(1, 8), (8, 8), (24, 24), (32, 32), (33, 40), (54, 64), (96, 96)])
def test_channels_become_a_multiple_and_the_added_are_empty(channels, wide):
    assert round_channels(channels) == wide
    x = torch.ones(1, channels, 2, 2)
    assert widened(x).shape[1] == wide and widened(x)[:, channels:].eq(0).all() and widened(x).sum() == 4 * channels


def test_a_network_of_wide_blocks_is_the_printed_one(monkeypatch):
    torch.manual_seed(0)
    network = unet.UNet(UpdaterConfig().network, 6, 48).double()
    x = torch.randn(1, 6, 16, 24, dtype=torch.float64)

    def answer_and_gradients():
        answer = network(x)
        return answer.detach(), torch.autograd.grad(answer.square().mean(), list(network.parameters()))

    straight, gradients = answer_and_gradients()
    used = []
    monkeypatch.setattr(unet, "is_wanted", lambda *_: used.append(1) or True)
    wide, others = answer_and_gradients()
    assert len(used) == 3, "down, up and merge"
    torch.testing.assert_close(wide, straight, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(others, gradients, rtol=1e-10, atol=1e-14)


def test_they_are_wanted_in_training_in_half_precision_on_a_gpu_only(monkeypatch):
    weight = torch.nn.Parameter(torch.zeros(1))
    on_gpu = SimpleNamespace(is_cuda=True)
    with torch.autocast("cpu", torch.bfloat16):
        assert not is_wanted(torch.zeros(1), weight) and not is_wanted(on_gpu, weight)
    monkeypatch.setattr(torch, "is_autocast_enabled", lambda device: device == "cuda")
    assert is_wanted(on_gpu, weight) and not is_wanted(torch.zeros(1), weight)
    assert not is_wanted(on_gpu, weight.detach())
    with torch.no_grad():
        assert not is_wanted(on_gpu, weight)
