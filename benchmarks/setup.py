"""What an image fixes of a set-up, for three plates: tables and a picture of docs/setup.md.

python -m benchmarks.setup docs/setup.png
"""

import sys
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.height_field import cell_centres
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.setup.knowledge import Knowledge, knowledge
from warp_caustics.setup.model import SetUpJacobian, SetUpModel
from warp_caustics.setup.set_up import SetUp
from warp_caustics.setup.unknown_heights import line_heights, smooth_heights

SCENE = Scene(height_samples=256, image_pixels=512, screen_position_m=(0.0, 0.0, -1e-3), lamp_half_angle_rad=3e-3)
"""A screen 1 mm below the plate, a lamp of 0.17 degrees."""
PHOTONS = 512**2
CAMERA = CameraConfig(psf_px=0.7, ambient=0.01, frame_px=(256, 256), magnification=0.5)
"""Its pixels are two by two of the simulation's: a picture that it shifts is not one of pixels already."""
NOISE = 0.01
BORDER = 8
PICTURED = ("gap_m", "base_thickness_m", "index_offset", "tilt_x_rad", "vergence_per_m", "shift_x_px", "psf_px.1")
UNITS = {"m": (1e6, "um"), "rad": (1e3, "mrad")}


def lines(count: int, seed: int) -> list[Line]:
    """Lines across the plate, 1 to 3 mm wide and 0.05 to 0.3 mm high."""
    random = np.random.default_rng(seed)
    drawn = []
    for _ in range(count):
        start, end = random.uniform(-0.022, 0.022, (2, 2)).tolist()
        drawn.append(Line(tuple(start), tuple(end), random.uniform(1e-3, 3e-3), random.uniform(5e-5, 3e-4)))
    return drawn


def bump(scene: Scene) -> np.ndarray:
    """One smooth hill of 1.5 mm, 3.5 mm in standard deviation along x."""
    x, y = (cell_centres(scene.height_samples, size) for size in scene.plate_size_m)
    return 1.5e-3 * np.exp(-((x[None, :] - 2e-3) ** 2 + 1.4 * (y[:, None] + 3e-3) ** 2) / (2 * 3.5e-3**2))


def main(target: Path) -> None:
    """Tables on stdout, the picture in a file."""
    torch.set_num_threads(1)
    few, many = lines(3, 5), lines(15, 6)
    n, size = SCENE.height_samples, SCENE.plate_size_m
    plates = {
        "3 lines": (line_relief(few, n, size), line_heights(SCENE, few)),
        "15 lines": (line_relief(many, n, size), line_heights(SCENE, many)),
        "bump": (bump(SCENE), smooth_heights(SCENE, 6)),
    }
    setup = SetUp.of(SCENE, CAMERA)
    model, found, pictures = SetUpModel(setup, n_photons=PHOTONS), {}, {}
    for name, (relief, unknown) in plates.items():
        heights = torch.from_numpy(relief)
        model.image(heights)
        begun = time.process_time()
        jacobian = model.derivatives(heights)
        seconds = time.process_time() - begun
        inner = (..., slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        seen = jacobian._replace(values=jacobian.values[inner])
        told = knowledge(setup, seen, NOISE, unknown, model.by_heights(heights, unknown.modes)[inner])
        found[name], pictures[name] = told, (model.image(heights), jacobian)
        print(
            f"{name}: {len(jacobian.names)} derivatives in {seconds:.1f} s of one thread, steps disagree by at most "
            f"{float(jacobian.disagreement.max()):.1e}; {straightness(model, heights, told)}"
        )
    print_table(found)
    draw(pictures, setup, target)


def straightness(model: SetUpModel, heights: torch.Tensor, told: Knowledge) -> str:
    """How far the image is from a straight line in a parameter after one standard deviation of what is not known."""
    parts = []
    for name in ("gap_m", "index_offset", "psf_px.1"):
        (known,) = [k for k in told.parameters if k.parameter.name == name]
        (slope,) = model.jacobian(heights, [name])
        at, image = model.setup.nominal, model.image(heights)
        for width, when in ((known.parameter.prior, "before"), (known.with_heights, "after")):
            theta = at.clone()
            theta[model.setup.names.index(name)] += width
            change = model.image(heights, theta) - image
            parts.append(f"{name} {when} {float((change - width * slope).norm() / change.norm()):.2g}")
    return "off the tangent after one deviation: " + ", ".join(parts)


def print_table(found: dict[str, Knowledge]) -> None:
    """Deviations before and after, with heights known and unknown; then what trades off."""
    rows = {name: {k.parameter.name: k for k in told.parameters} for name, told in found.items()}
    heads = [f"{name}: known / unknown" for name in rows]
    print("| parameter | before | " + " | ".join(heads) + " |\n|---|---|" + "---|" * len(heads))
    first = next(iter(rows.values()))
    for name, known in first.items():
        factor, unit = UNITS.get(known.parameter.unit, (1.0, known.parameter.unit))
        unit = "" if unit == "1" else f" {unit}"
        cells = [
            f"{factor * row[name].together:.2g} / {'**' * (row[name].verdict == 'fixed')}"
            f"{factor * row[name].with_heights:.2g}{'**' * (row[name].verdict == 'fixed')}"
            for row in rows.values()
        ]
        print(f"| `{name}` | {factor * known.parameter.prior:.2g}{unit} | " + " | ".join(cells) + " |")
    for name, row in rows.items():
        print(f"\n{name}")
        for known in row.values():
            if known.trades:
                print(f"  {known.parameter.name}: " + ", ".join(f"{other} {c:+.2f}" for other, c in known.trades))
        worst = found[name].directions[-1]
        print("  least told:", ", ".join(
            f"{w:+.2f} {p}" for p, w in zip(row, worst.weights.tolist(), strict=True) if abs(w) > 0.3
        ), f"{worst.remaining:.2f}")  # fmt: skip


def draw(pictures: dict[str, tuple[torch.Tensor, SetUpJacobian]], setup: SetUp, target: Path) -> None:
    """Images of the plates in green, beside their derivatives for one prior width of each parameter."""
    columns = 1 + len(PICTURED)
    figure, axes = plt.subplots(len(pictures), columns, figsize=(1.75 * columns, 5.9), layout="constrained")
    priors = dict(zip(setup.names, setup.parameters, strict=True))
    for number, (plate, (image, jacobian)) in enumerate(pictures.items()):
        row = axes[number]
        row[0].imshow(image[1], cmap="gray", vmin=0, vmax=2.5, origin="upper")
        row[0].set_ylabel(plate)
        row[0].set_title("" if number else "image", fontsize=8)
        for panel, name in zip(row[1:], PICTURED, strict=True):
            parameter = priors[name]
            change = (parameter.prior * jacobian.values[jacobian.names.index(name)])[1, BORDER:-BORDER, BORDER:-BORDER]
            most = max(float(change.abs().quantile(0.995)), 1e-9)
            panel.imshow(change, cmap="RdBu_r", vmin=-most, vmax=most, origin="upper")
            factor, unit = UNITS.get(parameter.unit, (1.0, "" if parameter.unit == "1" else parameter.unit))
            if number == 0:
                panel.set_title(f"{name}\n{factor * parameter.prior:.3g} {unit}", fontsize=8)
            panel.set_xlabel(f"$\\pm${most:.2g}", fontsize=7, labelpad=1)
    for panel in axes.flat:
        panel.set(xticks=[], yticks=[])
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
