"""
A data set in ten lines
=======================

Build a small data set of printed plates and their caustics, read it as training does, and show it.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import torch

from data_gen import CausticDataset, DatasetConfig, make_sampler
from data_gen.store import build, verify
from warp_caustics import CausticSimulator, Scene

scene = Scene(height_samples=32, image_pixels=64)
config = DatasetConfig(kind="updater", n_samples=8, samples_per_shard=4, scene=scene)
with tempfile.TemporaryDirectory() as folder:
    build(Path(folder, "set"), config, make_sampler)
    problems = verify(Path(folder, "set")).problems
    samples = [CausticDataset(Path(folder, "set"))[i] for i in range(4)]

# %%
# Above the printed relief, below its caustic at 530 nm.

figure, axes = plt.subplots(2, 4, figsize=(10, 5), layout="constrained")
for column, sample in enumerate(samples):
    axes[0, column].imshow(1e3 * sample["heights"], origin="upper", cmap="viridis")
    axes[1, column].imshow(sample["target"][1].float(), origin="upper", cmap="magma", vmin=0, vmax=2.5)
for axis in axes.flat:
    axis.set_axis_off()
plt.show()

# %%
# The check: nothing is damaged, and each image is the caustic of its relief, but for the rounding to 16-bit floats.

assert not problems
for sample in samples:
    caustic = CausticSimulator(scene)(sample["heights"])
    torch.testing.assert_close(sample["target"].float(), caustic, rtol=1e-3, atol=1e-3)
