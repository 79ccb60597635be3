"""
Inspect a plate against its design
==================================

Three fibres were to be printed and one is missing. The plate is measured from its caustic and compared with the design:
where it is out of tolerance, by how much, and whether it passes. A good plate is inspected too.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from nets import create
from warp_caustics import CausticImage, CausticSimulator, Line, Nominal, Scene, judge_plate, line_relief

TOLERANCE_M = 30e-6
scene = Scene(height_samples=32, image_pixels=128, plate_size_m=(0.02, 0.02))
ends_m = [((-7e-3, -5e-3), (6e-3, 4e-3)), ((-4e-3, 7e-3), (5e-3, -6e-3)), ((-7e-3, 3e-3), (-7e-3, 8e-3))]
fibres = [Line(start, end, width_m=2.5e-3, height_m=1.2e-4) for start, end in ends_m]
design = Nominal.of_lines(fibres, scene)


def measured_m(printed: list[Line]) -> np.ndarray:
    """Relief [m] that is found from the caustic of a printed plate, with 1 % of noise."""
    relief = torch.from_numpy(line_relief(printed, 32, scene.plate_size_m)).float()
    image = CausticSimulator(scene, n_photons=397**2)(relief).numpy()
    image += 0.01 * np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    return create("transport", scene).reconstruct(CausticImage(image, np.full(3, 0.01))).heights_m


# %%
# Both plates. The uncertainty of the measurement, here 3 um, belongs to the verdict: what it cannot decide is no pass.

uncertainty_m = np.full((32, 32), 3e-6)
good, bad = (
    judge_plate(measured_m(printed), design, scene, TOLERANCE_M, sigma_m=uncertainty_m)
    for printed in (fibres, fibres[:2])
)
for name, found in (("good plate", good), ("bad plate", bad)):
    print(f"{name}: {found.verdict}; {'; '.join(found.reasons)}")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.5), layout="constrained")
extent = [-10, 10, 10, -10]
shown = axes[0].imshow(1e6 * design.relief_m, origin="upper", extent=extent)
axes[0].set(title="design [um]", xlabel="x [mm]")
figure.colorbar(shown, ax=axes[0], shrink=0.8)
for axis, name, found in ((axes[1], "good plate", good), (axes[2], "bad plate", bad)):
    deviation_um = 1e6 * found.deviation_m
    shown = axis.imshow(deviation_um, origin="upper", extent=extent, cmap="RdBu_r", vmin=-120, vmax=120)
    axis.set(title=f"{name}: {found.verdict}", xlabel="x [mm]")
    for region in found.regions:
        x_mm, y_mm = (1e3 * value for value in region.centre_m)
        axis.annotate(f"{1e6 * region.peak_m:.0f} um", (x_mm, y_mm), (x_mm + 2, y_mm), va="center")
figure.colorbar(shown, ax=axes[1:], label="deviation [um]", shrink=0.8)
plt.show()

# %%
# The check: the good plate passes; of the bad one exactly the missing fibre is found, where it should have been, and
# named.

assert good.verdict == "pass"
assert bad.verdict == "fail"
(region,) = bad.regions
np.testing.assert_allclose(region.centre_m, np.mean(ends_m[2], axis=0), atol=3e-4)
assert -1.4e-4 < region.peak_m < -0.9e-4
assert [fibre.status for fibre in bad.fibres] == ["as designed", "as designed", "missing"]
