"""
Design a relief for a picture
=============================

The same physics the other way round: which relief sends the light of a lamp to a given picture? Optimal transport makes
the start, a descent on the exact model the rest; the result is checked with light paths that the descent never used.
"""

import matplotlib.pyplot as plt
import numpy as np

from warp_caustics import Designer, Scene
from warp_caustics.design.options import DesignOptions
from warp_caustics.design.target import target_irradiance

scene = Scene(height_samples=48, image_pixels=96, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))

# %%
# The picture: a bright ring with a dot, on a background that keeps some light.

x, y = np.meshgrid(*[np.linspace(-1, 1, 96)] * 2)
radius = np.hypot(x, y)
picture = 1.0 * (np.abs(radius - 0.6) < 0.08) + 1.0 * (radius < 0.15)
target = target_irradiance(picture, scene, floor=0.3)

# %%
# Twenty steps per image size.

options = DesignOptions(screen_distance_m=0.2, max_iterations=20, start_cells=32)
found = Designer(scene, options).design(target)
image = found.image[0]
likeness = np.corrcoef(image.ravel(), target.ravel())[0, 1]
print(f"relief {1e3 * np.ptp(found.heights_m):.2f} mm high, correlation with the picture {likeness:.3f}")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.5), layout="constrained")
extent = [-25, 25, 25, -25]
panels = (target, image, 1e3 * found.heights_m)
titles = ("wanted [W/m²]", "caustic of the relief [W/m²]", "relief [mm]")
scales = ({"cmap": "magma", "vmin": 0, "vmax": target.max()},) * 2 + ({"cmap": "viridis"},)
for axis, panel, title, scale in zip(axes, panels, titles, scales, strict=True):
    shown = axis.imshow(panel, origin="upper", extent=extent, **scale)
    axis.set(title=title, xlabel="x [mm]")
    figure.colorbar(shown, ax=axis, shrink=0.8)
plt.show()

# %%
# The check: the caustic looks like the picture, and the relief keeps its height limit.

assert likeness > 0.9
assert np.ptp(found.heights_m) <= 1.001 * options.max_height_m
