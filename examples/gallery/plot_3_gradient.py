"""
The gradient of one pixel
=========================

Which heights decide how bright a pixel is? The simulator knows the exact derivative of every pixel with respect to
every height. Raising a sample acts as a small lens, so its neighbours act the other way.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from warp_caustics import CausticSimulator, Line, Scene, line_relief

scene = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.02, 0.02), screen_position_m=(0.0, 0.0, -0.01))
line = Line((-0.008, -0.004), (0.008, 0.004), width_m=4e-3, height_m=1e-4)
heights = torch.from_numpy(line_relief([line], 32, scene.plate_size_m)).requires_grad_()
simulator = CausticSimulator(scene, dtype=torch.float64)

# %%
# One backward pass gives all 1024 derivatives.

row, column = 32, 36
image = simulator(heights)
image[1, row, column].backward()
gradient = heights.grad

# %%
# Left the caustic at 530 nm with the pixel, right which heights brighten (red) or darken (blue) it.

millimetres = [-10, 10, 10, -10]
figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
shown = axes[0].imshow(image[1].detach(), origin="upper", extent=millimetres, cmap="magma")
centre_mm = [(i + 0.5) / 64 * 20 - 10 for i in (column, row)]
axes[0].plot(*centre_mm, "s", color="cyan", mfc="none", ms=10)
axes[0].set(title="irradiance [W/m²]", xlabel="x [mm]", ylabel="y [mm]")
figure.colorbar(shown, ax=axes[0], shrink=0.8)
limit = float(gradient.abs().max()) * 1e-6
shown = axes[1].imshow(gradient * 1e-6, origin="upper", extent=millimetres, cmap="RdBu_r", vmin=-limit, vmax=limit)
axes[1].set(title="derivative of the pixel [W/m² per um]", xlabel="x [mm]", xlim=(-2, 5), ylim=(-3, 4))
figure.colorbar(shown, ax=axes[1], shrink=0.8)
plt.show()

# %%
# The check: moving single heights by a nanometre and back changes the pixel as predicted.

order = gradient.abs().flatten().argsort(descending=True)
for index in order[:5].tolist():
    step = torch.zeros(32 * 32, dtype=torch.float64)
    step[index] = 1e-9
    change = [simulator(heights.detach() + sign * step.view(32, 32))[1, row, column] for sign in (1, -1)]
    numeric = float(change[0] - change[1]) / 2e-9
    np.testing.assert_allclose(float(gradient.flatten()[index]), numeric, rtol=1e-5)
