r"""
A wedge against Snell's law
===========================

A plane face inclined by :math:`\theta` bends light towards its thick side. Inside the glass light runs at
:math:`\theta - \arcsin(\sin \theta / n)` from the vertical, so on a screen below :math:`t` metres of glass it arrives
:math:`t \tan(\theta - \arcsin(\sin \theta / n))` metres away. The simulator must find that, at every wavelength.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.height_field import cell_centres

scene = Scene(height_samples=32, image_pixels=64, exit_medium="glass")
simulator = CausticSimulator(scene, n_photons=1024, dtype=torch.float64)
x_m = cell_centres(32, scene.plate_size_m[0])

# %%
# Light paths through wedges of several angles, and where Snell's law puts them.

angles_deg = np.linspace(0.5, 4.0, 8)
found_m = np.zeros((len(angles_deg), scene.n_wavelengths))
expected_m = np.zeros_like(found_m)
engine = simulator.engine
((chunk, positions),) = engine.chunks(1)
path = int(np.argmin(np.abs(positions[:, 0].numpy())))  # next to the middle of the plate
start_m = float(positions[path, 0])
for i, angle_deg in enumerate(angles_deg):
    theta = math.radians(angle_deg)
    heights = torch.from_numpy(np.tile(math.tan(theta) * x_m, (32, 1)))
    maps = engine.maps(engine.coefficients(heights[None]), chunk, positions)
    landings_px = engine.land(maps, positions)[0][0, :, 0, path].numpy()
    found_m[i] = landings_px * scene.pixel_size_m[0] - scene.plate_size_m[0] / 2 - start_m
    glass_m = scene.base_thickness_m - scene.screen_position_m[2] + math.tan(theta) * start_m
    expected_m[i] = [glass_m * math.tan(theta - math.asin(math.sin(theta) / n)) for n in scene.glass_indices]

# %%
# Blue light (430 nm) is bent most: glass disperses.

colours = ("tab:red", "tab:green", "tab:blue")
for channel, wavelength_m in enumerate(scene.wavelengths_m):
    plt.plot(
        angles_deg, 1e6 * expected_m[:, channel], color=colours[channel], label=f"{1e9 * wavelength_m:.0f} nm, Snell"
    )
    plt.plot(angles_deg, 1e6 * found_m[:, channel], "o", color=colours[channel], mfc="none")
plt.xlabel("angle of the wedge [degrees]")
plt.ylabel("sideways shift on the screen [um]")
plt.legend()
plt.show()

# %%
# The check: a tenth of a nanometre.

assert np.abs(found_m - expected_m).max() < 1e-10
assert (np.diff(found_m, axis=1) > 0).all()
