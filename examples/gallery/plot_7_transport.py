"""
Optimal transport, compared with a descent
==========================================

Optimal transport moves the light of a flat plate to the measured caustic with the least effort, and the slopes that do
so give the heights, without any start. A descent on the exact model from a flat plate fits the image as well, with
other heights: slow bends of the plate hardly change its caustic.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from nets import create
from warp_caustics import CausticImage, CausticSimulator, Line, Scene, height_errors, line_relief

scene = Scene(height_samples=32, image_pixels=128, plate_size_m=(0.02, 0.02))
ends_m = [((-7e-3, -5e-3), (6e-3, 4e-3)), ((-4e-3, 7e-3), (5e-3, -6e-3))]
lines = [Line(start, end, width_m=3e-3, height_m=1.5e-4) for start, end in ends_m]
truth_m = line_relief(lines, 32, scene.plate_size_m)
measured = CausticSimulator(scene, n_photons=397**2)(torch.from_numpy(truth_m).float()).numpy()
measured += 0.01 * np.random.default_rng(0).standard_normal(measured.shape).astype(np.float32)
image = CausticImage(measured, np.full(3, 0.01))

# %%
# Two ways to heights.

transport = create("transport", scene).reconstruct(image)
from_flat = create("refine", scene, max_iterations=20).reconstruct(image)
results = {"transport": transport, "refine from flat": from_flat}
errors = {name: height_errors(r.heights_m, truth_m, scene.plate_size_m) for name, r in results.items()}
flat_um = errors["transport"]["reference_rms_um"]
for name, result in results.items():
    print(f"{name}: RMSE {errors[name]['rmse_um']:.2f} um, residual {result.residual:.4f}")
print(f"flat guess: {flat_um:.1f} um")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.5), layout="constrained")
axes[0].imshow(measured.transpose(1, 2, 0).clip(0, 2) / 2, origin="upper")
axes[0].set(title="measured", xticks=[], yticks=[])
for axis, (name, result) in zip(axes[1:], results.items(), strict=True):
    error_um = 1e6 * (result.heights_m - truth_m)
    shown = axis.imshow(error_um, origin="upper", extent=[-10, 10, 10, -10], cmap="RdBu_r", vmin=-30, vmax=30)
    axis.set(title=f"{name}: {errors[name]['rmse_um']:.2f} um", xlabel="x [mm]")
figure.colorbar(shown, ax=axes[1:], label="error [um]", shrink=0.8)
plt.show()

# %%
# The check: both explain the image, and transport alone is near the truth.

assert errors["transport"]["rmse_um"] < 2 < 40 < flat_um
assert errors["refine from flat"]["rmse_um"] < flat_um
assert max(transport.residual, from_flat.residual) < 0.05
