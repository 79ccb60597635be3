"""What tests of networks share: members of the family, tiny ones of the residual networks, and inputs."""

import pytest
import torch
from hypothesis import strategies as st
from torch import nn

from nets.config import RANGES, Choice, DenoiserConfig, NetworkConfig, UpdaterConfig
from nets.residual_config import BackboneConfig, DirectConfig, UnrolledConfig
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=16, image_pixels=64)
BACKBONE = BackboneConfig(widths=(8, 12, 16), depths=(1, 2, 1), attention_levels={1, 2}, head_channels=8)
SMALL = NetworkConfig(
    learning_rate=1e-3, c_init=3, nonlinearity="PReLU", k_down=3, k_up=2, m_s=2, n_s=2, m_dec=2, k_dec=4, lambda_tv=1e-9
)
KINDS = {
    "denoiser": DenoiserConfig(network=SMALL),
    "updater": UpdaterConfig(network=SMALL),
    "direct": DirectConfig(backbone=BACKBONE),
    "unrolled": UnrolledConfig(backbone=BACKBONE, hidden_channels=3, numbered_steps=4),
}


def _row(key):
    limits = RANGES[key]
    if isinstance(limits, Choice):
        return st.sampled_from(limits.values)
    if NetworkConfig.model_fields[key].annotation is float or key == "lambda_tv":
        return st.floats(limits.low, limits.high)
    return st.integers(int(limits.low), int(limits.high))


def members(**fixed):
    """Hypothesis strategy: any member of the family, every row of Tab. 2 over its whole range unless fixed."""
    return st.builds(NetworkConfig, **{key: fixed.get(key, _row(key)) for key in RANGES})


def inputs(scene=SCENE, batch=2, seed=0):
    """Target and simulated image, heights and gradient, as an updater takes them."""
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(2, batch, scene.n_wavelengths, scene.image_pixels, scene.image_pixels, generator=generator)
    maps = torch.rand(2, batch, scene.height_samples, scene.height_samples, generator=generator)
    return images[0] * 2, images[1] * 2, maps[0] * 1e-3, maps[1] - 0.5


@torch.no_grad()
def scramble(module, seed=0):
    """Give every weight a random value, those that start at zero too."""
    generator = torch.Generator().manual_seed(seed)
    for parameter in module.parameters():
        parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.1)
    return module


@torch.no_grad()
def positive(module, seed=0):
    """Positive weights that average their inputs: every nonlinearity passes, and no two paths cancel."""
    generator = torch.Generator().manual_seed(seed)
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            random = 0.5 + torch.rand(layer.weight.shape, generator=generator)
            layer.weight.copy_(random / layer.weight[0].numel())
            if layer.bias is not None:
                layer.bias.fill_(0.1)
    return module


def unreached(module):
    """Names of parameters whose gradient is missing, not finite, or zero throughout."""
    return [
        name
        for name, parameter in module.named_parameters()
        if parameter.grad is None or not parameter.grad.isfinite().all() or not parameter.grad.any()
    ]


@pytest.fixture(scope="session")
def scene():
    """16^2 heights and 64^2 pixels, the ratio of Tab. 1."""
    return SCENE


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """These tensors are too small to share; on a busy machine threads would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
