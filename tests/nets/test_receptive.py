"""Receptive fields that are computed are those that a gradient finds."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from nets.architecture import PRESETS
from nets.config import DenoiserConfig, UpdaterConfig
from nets.denoiser import Denoiser
from nets.direct_net import DirectNet
from nets.receptive import receptive_field
from nets.residual_config import BackboneConfig, DirectConfig, UnrolledConfig
from nets.unrolled_net import UnrolledUpdater
from nets.updater import Updater
from tests.nets.conftest import inputs, members, positive
from warp_caustics.scene import Scene


def extent(gradient):
    """Side of the smallest rows that hold all of a gradient."""
    rows = gradient.abs().sum(tuple(range(gradient.ndim - 2)))
    used = rows.sum(1).nonzero()
    return int(used.max() - used.min() + 1)


def probed(answer, inputs_, period):
    """Widest extent in each input that outputs over a period of positions depend on."""
    centre = answer.shape[-1] // 2
    widest = [0] * len(inputs_)
    for offset in range(period):
        at = answer[..., centre + offset, centre + offset].sum()
        found = torch.autograd.grad(at, inputs_, retain_graph=True)
        widest = [max(before, extent(gradient)) for before, gradient in zip(widest, found, strict=True)]
    return widest


@settings(max_examples=12, deadline=None)
@given(members(c_init=st.just(1), m_s=st.just(1), n_s=st.integers(1, 2), nonlinearity=st.just("ELU")))
def test_denoiser(network):
    config = DenoiserConfig(network=network)
    image = (torch.rand(1, 1, 160, 160, dtype=torch.float64) + 0.5).requires_grad_()
    # The module works in float32; a product of many small weights must not vanish.
    answer = positive(Denoiser(config))(image)
    assert probed(answer, [image], 2**network.n_s) == [receptive_field(config, Scene()).image_pixels]


@settings(max_examples=8, deadline=None)
@given(
    members(m_s=st.just(1), n_s=st.integers(1, 2), nonlinearity=st.just("ELU"), k_down=st.integers(2, 7), k_up=st.integers(2, 7)),
    st.sampled_from([1, 2, 3, 4]),
)  # fmt: skip
def test_updater(network, ratio):
    config, scene = UpdaterConfig(network=network), Scene(height_samples=80, image_pixels=80 * ratio)
    target, simulated, heights, gradient = inputs(scene, batch=1)
    arguments = [target.requires_grad_(), gradient.abs().requires_grad_()]
    answer = positive(Updater(config, scene))(arguments[0], simulated, heights, arguments[1])
    field = receptive_field(config, scene)
    assert probed(answer, arguments, 2**network.n_s) == [field.image_pixels, field.height_samples]


@pytest.mark.parametrize("depths", [(1,), (1, 1), (2, 1), (1, 1, 1)])
def test_residual(depths):
    """Without normalisation and attention, which see the whole plate."""
    backbone = BackboneConfig(widths=(2,) * len(depths), depths=depths)
    scene = Scene(height_samples=96, image_pixels=192)
    target, simulated, heights, gradient = inputs(scene, batch=1)
    # Inside the range in which nothing is clipped, slopes included.
    target, heights = (target * 0.4 + 0.5).requires_grad_(), (heights * 0.1).requires_grad_()
    for module, arguments in (
        (DirectNet(DirectConfig(backbone=backbone), scene), [target]),
        (UnrolledUpdater(UnrolledConfig(backbone=backbone), scene), [target, heights]),
    ):
        for name, layer in list(module.named_modules()):
            if isinstance(layer, nn.GroupNorm):
                module.get_submodule(name.rpartition(".")[0])._modules[name.rpartition(".")[2]] = nn.Identity()
        positive(module)
        answer = (
            module(target) if len(arguments) == 1 else module(target, simulated, heights, gradient).heights - heights
        )
        field = receptive_field(module.config, scene)
        expected = [side for side in (field.image_pixels, field.height_samples) if side is not None]
        assert probed(answer, arguments, 2 ** (len(depths) - 1)) == expected
        assert field.sees_all


@pytest.mark.parametrize(
    ("name", "image", "heights"), [("paper-denoiser", 95, None), ("paper-updater", 29, 23), ("direct", 1764, None)]
)
def test_presets(name, image, heights):
    field = receptive_field(PRESETS[name], Scene())
    assert (field.image_pixels, field.height_samples) == (image, heights)
