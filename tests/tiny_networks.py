"""Fixtures of all tests that run whole methods: a small scene, its image, and tiny networks on disk."""

import pytest
import torch

from nets.architecture import build
from nets.config import DenoiserConfig, NetworkConfig, UpdaterConfig
from nets.residual_config import BackboneConfig, DirectConfig, UnrolledConfig
from nets.weights import save_weights
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

BACKBONE = BackboneConfig(widths=(8, 12), depths=(1, 1), attention_levels={1}, head_channels=4)
SMALL = NetworkConfig(
    learning_rate=1e-3, c_init=3, nonlinearity="PReLU", k_down=3, k_up=2, m_s=2, n_s=2, m_dec=2, k_dec=4, lambda_tv=1e-9
)
KINDS = {
    "denoiser": DenoiserConfig(network=SMALL),
    "updater": UpdaterConfig(network=SMALL),
    "updater-no-gradient": UpdaterConfig(network=SMALL, use_gradient=False),
    "direct": DirectConfig(backbone=BACKBONE),
    "unrolled": UnrolledConfig(backbone=BACKBONE, hidden_channels=2, numbered_steps=3),
}


@pytest.fixture(scope="session")
def scene():
    """16^2 heights and 64^2 pixels, the ratio of Tab. 1."""
    return Scene(height_samples=16, image_pixels=64)


@pytest.fixture(scope="session")
def heights(scene):
    """Tall lines whose light crosses, shape [16, 16] [m]."""
    lines = [
        Line((-0.015, -0.01), (0.012, 0.008), 8e-3, 2.5e-3),
        Line((0.015, -0.015), (-0.012, 0.018), 8e-3, 2.5e-3),
    ]
    return line_relief(lines, 16, scene.plate_size_m)


@pytest.fixture(scope="session")
def image(scene, heights):
    relief = torch.tensor(heights, dtype=torch.float32)
    return CausticImage(CausticSimulator(scene)(relief).numpy())


def save_network(folder, name, scene, *, spread=0.0, training=None):
    """Write a tiny network and return its path; weights random with that spread, or as a fresh network has them."""
    torch.manual_seed(0)
    network = build(KINDS[name], scene)
    if spread:
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.copy_(torch.randn(parameter.shape) * spread)
    path = folder / f"{name}.safetensors"
    save_weights(path, network, scene=scene, data_fingerprint=None, training=training or {})
    return str(path)


@pytest.fixture
def saved(tmp_path, scene):
    """Writes a tiny network and returns its path; every weight random, or as a fresh network has it."""

    def save(name, *, is_random=False, training=None, scene=scene):
        return save_network(tmp_path, name, scene, spread=0.1 if is_random else 0.0, training=training)

    return save


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """An empty folder in place of the shipped networks."""
    folder = tmp_path / "shipped"
    folder.mkdir()
    monkeypatch.setattr("nets.shipped.FOLDER", folder)
    return folder


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """These tensors are too small to share; on a busy machine threads would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
