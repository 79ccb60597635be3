r"""
A lens and its focus
====================

A paraboloid is a lens. On its axis the light of a collimated beam gets denser by :math:`1 / \det J`, where :math:`J` is
the derivative of where light lands with respect to where it entered. For curvature :math:`1 / R`, glass of thickness
:math:`t` and a screen at distance :math:`g` in air,

.. math:: J = \left( 1 - \frac{n - 1}{R} \left( \frac{t}{n} + g \right) \right) I

so the irradiance on the axis follows in closed form, and has its focus where :math:`J` vanishes.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.height_field import cell_centres

RADIUS_M, SIZE_M, PEAK_M = 0.1, 0.02, 1.2e-3

x_m, y_m = np.meshgrid(*[cell_centres(64, SIZE_M)] * 2)
heights = torch.from_numpy(PEAK_M - (x_m**2 + y_m**2) / (2 * RADIUS_M))

# %%
# Move the screen away from the plate and look at the middle of the image.

distances_m = np.linspace(0.0, 0.12, 7)
images, found, expected = [], [], []
for distance_m in distances_m:
    scene = Scene(
        height_samples=64,
        image_pixels=65,
        plate_size_m=(SIZE_M, SIZE_M),
        screen_position_m=(0.0, 0.0, -distance_m),
        wavelengths_m=(530e-9,),
        radiosity_W_m2=(1.0,),
    )
    image = CausticSimulator(scene, n_photons=260**2, dtype=torch.float64)(heights)[0].numpy()
    (n,) = scene.glass_indices
    narrowing = 1 - (n - 1) / RADIUS_M * ((scene.base_thickness_m + PEAK_M) / n + distance_m)
    images.append(image)
    found.append(image[31:34, 31:34].mean())
    expected.append(1 / narrowing**2)

# %%
# Irradiance at the axis, and three of the images.

figure, axes = plt.subplots(1, 4, figsize=(12, 3), layout="constrained")
axes[0].plot(1e3 * distances_m, expected, label="1 / det J")
axes[0].plot(1e3 * distances_m, found, "o", label="simulated")
axes[0].set(xlabel="screen distance [mm]", ylabel="irradiance on the axis [W/m²]")
axes[0].legend()
for axis, i in zip(axes[1:], (1, 3, 6), strict=True):
    shown = axis.imshow(images[i], origin="upper", extent=[-10, 10, 10, -10], cmap="magma")
    axis.set(title=f"{1e3 * distances_m[i]:.0f} mm", xlabel="x [mm]")
    figure.colorbar(shown, ax=axis, shrink=0.8)
plt.show()

# %%
# The check: half a percent, at six times the light of a flat plate too.

assert np.abs(np.divide(found, expected) - 1).max() < 5e-3
assert max(expected) > 4
