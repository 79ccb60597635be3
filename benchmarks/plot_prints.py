"""Plates and caustics of the designs in examples/designs: docs/prints.png.

python -m benchmarks.plot_prints docs/prints.png
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import torch

from warp_caustics.prints.design_file import design_relief, read_design
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

FOLDER = Path(__file__).parents[1] / "examples" / "designs"
NAMES = {
    "sections": "cap, ellipse, parabola,\nquarter, cosine, Gaussian",
    "contact_angles": "contact angles\n20, 35, 50, 70, 90 degrees",
    "passes": "1 to 6 passes\nof a 0.4 mm fibre",
    "overlap_sum": "overlaps:\nadded up",
    "overlap_max": "overlaps:\nthe highest",
    "overlap_merge": "overlaps:\nmerged, p = 3",
    "polyline": "polylines",
    "curves": "Bezier curves",
    "meander": "a meander",
    "rings_drops": "rings and drops",
    "text": "text",
    "waves": "waves: thickness 2 to 16 %,\naside 0.1 and 0.4 mm",
    "ends": "ends thicker by\n0, 20, 40, 60 %",
    "base": "bow of 50 um,\nwave of 10 um",
    "fibre": "fibre.yaml:\npasses, waves, ends, base",
    "shapes": "shapes.yaml:\nsections mixed, the highest",
}
"""Designs in the order of the picture, and what is to be seen in them."""
COLUMNS = 4
SHOWN_W_M2 = 2.5
"""White: brighter than that is cut off."""


def main(target: Path) -> None:
    """Four designs a row, plate (with its highest point) and caustic of each side by side, y upwards."""
    scene = Scene()
    simulator = CausticSimulator(scene)
    rows = -(-len(NAMES) // COLUMNS)
    figure, axes = plt.subplots(rows, 2 * COLUMNS, figsize=(16, 2.45 * rows), layout="constrained")
    for axis in axes.flat:
        axis.axis("off")
    for number, (name, title) in enumerate(NAMES.items()):
        heights = design_relief(read_design(FOLDER / f"{name}.yaml"), scene.height_samples, scene.plate_size_m)
        image = simulator(torch.tensor(heights, dtype=torch.float32)).numpy()
        row, column = divmod(number, COLUMNS)
        plate, caustic = axes[row, 2 * column : 2 * column + 2]
        plate.imshow(1e6 * heights, origin="upper", cmap="viridis")
        plate.set_title(title, fontsize=9)
        plate.text(2, 3, f"{1e6 * heights.max():.0f} um", color="white", fontsize=8)
        caustic.imshow((image.transpose(1, 2, 0) / SHOWN_W_M2).clip(0, 1), origin="upper")
    figure.savefig(target, dpi=100, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
