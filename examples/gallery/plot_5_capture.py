"""
A capture and the shipped network
=================================

The example capture (16 bit, noise, vignetting, dark offset) is calibrated with its dark and flat frames and handed to
``direct``, here without its last step, sixty iterations of refinement take longer than an example should.
``make demo`` does all of it.
"""

import inspect
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from nets import create
from warp_caustics import CausticImage, Scene, height_errors, read_heights, read_image
from warp_caustics.capture.radiometric import capture_to_irradiance

FILES = Path(inspect.getsourcefile(lambda: None)).resolve().parents[1] / "data"
scene = Scene(exit_medium="glass")  # the screen touches the plate

# %%
# Counts of a camera become irradiance.

frames = [read_image(FILES / name) for name in ("capture.tif", "dark.tif", "flat.tif")]
capture = capture_to_irradiance(frames[0], scene=scene, dark=frames[1], flat=frames[2])
for step in capture.steps:
    print(step)

# %%
# One network, asked eight times: the plate turned and mirrored. The spread of its answers is the uncertainty.

image = CausticImage(capture.irradiance, capture.noise_std, capture.mask)
result = create("direct", scene, refine=False).reconstruct(image)
truth_m = read_heights(FILES / "true_heights.npy")
errors = height_errors(result.heights_m, truth_m, scene.plate_size_m)
print(f"RMSE {errors['rmse_um']:.2f} um; flat guess {errors['reference_rms_um']:.1f} um")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.5), layout="constrained")
extent = [-25, 25, 25, -25]
error_um = 1e6 * (result.heights_m - truth_m)
panels = (1e3 * result.heights_m, error_um, 1e6 * result.uncertainty_m)
titles = ("recovered heights [mm]", "error [um]", "its own uncertainty [um]")
scales = ({"cmap": "viridis"}, {"cmap": "RdBu_r", "vmin": -20, "vmax": 20}, {"cmap": "magma", "vmax": 20})
for axis, panel, title, scale in zip(axes, panels, titles, scales, strict=True):
    shown = axis.imshow(panel, origin="upper", extent=extent, **scale)
    axis.set(title=title, xlabel="x [mm]")
    figure.colorbar(shown, ax=axis, shrink=0.8)
plt.show()

# %%
# The check: the network alone is within 6 um of the print, and its uncertainty is large where its error is.

assert errors["rmse_um"] < 6 < 80 < errors["reference_rms_um"]
assert np.corrcoef(np.abs(error_um).ravel(), result.uncertainty_m.ravel())[0, 1] > 0.3
