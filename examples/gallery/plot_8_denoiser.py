"""
Train a tiny denoiser
=====================

Few random photons make a noisy caustic, a lattice of photons a clean one. A small member of the paper's family of
networks learns the step between them, here in twenty steps on pairs simulated on the spot. ``nsfc train denoiser`` does
it in earnest.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

import nets
from data_gen import DatasetConfig, PhotonConfig
from data_gen.samples import DenoiserSampler
from nets.config import DenoiserConfig, NetworkConfig
from warp_caustics import Scene

torch.manual_seed(0)
scene = Scene(height_samples=32, image_pixels=64)
config = DatasetConfig(
    kind="denoiser",
    n_samples=100,
    scene=scene,
    noisy=PhotonConfig(preset="paper", n_photons=4_000, smoothing=2.0),
    clean=PhotonConfig(preset="lattice"),
)
sampler = DenoiserSampler(config, "cpu")


def pairs(first: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Noisy and clean images, shape [count, 3, 64, 64]."""
    arrays = sampler.draw(range(first, first + count)).arrays
    return tuple(torch.from_numpy(arrays[name].astype(np.float32)) for name in ("noisy", "clean"))


# %%
# Four images for training, two that it never sees.

noisy, clean = pairs(0, 4)
unseen_noisy, unseen_clean = pairs(50, 2)
numbers = NetworkConfig(learning_rate=3e-3, c_init=6, nonlinearity="PReLU", k_down=3, k_up=2, m_s=2, n_s=2)
network = nets.build(DenoiserConfig(network=numbers), scene)
optimiser = torch.optim.Adam(network.parameters(), numbers.learning_rate)
losses = []
for _ in range(20):
    loss = (network(noisy) - clean).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    with torch.no_grad():
        losses.append(float((network(unseen_noisy) - unseen_clean).square().mean()))
untouched = float((unseen_noisy - unseen_clean).square().mean())

figure, axes = plt.subplots(1, 4, figsize=(13, 3), layout="constrained")
axes[0].plot(range(1, 21), losses)
axes[0].axhline(untouched, ls="--", color="grey", label="noisy image itself")
axes[0].set(xlabel="step", ylabel="mean square error [(W/m²)²]", ylim=(0, None), title="unseen images")
axes[0].legend()
with torch.no_grad():
    shown = (unseen_noisy[0, 1], network(unseen_noisy)[0, 1], unseen_clean[0, 1])
for axis, panel, title in zip(axes[1:], shown, ("4,000 photons", "denoised", "clean"), strict=True):
    axis.imshow(panel, origin="upper", cmap="magma", vmin=0, vmax=2.5)
    axis.set(title=title, xticks=[], yticks=[])
plt.show()

# %%
# The check: on images it has never seen the network is better than leaving them as they are.

assert losses[-1] < 0.7 * untouched
