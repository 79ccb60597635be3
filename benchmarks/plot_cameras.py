"""The same plate through four cameras, as they write it: docs/cameras.png.

python -m benchmarks.plot_cameras docs/cameras.png
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.patches import Rectangle

from warp_caustics.camera.config import CameraConfig, read_camera
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import FULL_SCALE, photographs
from warp_caustics.io.heights import read_heights
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

ROOT = Path(__file__).parents[1]
CAMERAS = {name: ROOT / "configs" / "cameras" / f"{name}.yaml" for name in ("careful", "ordinary", "poor")}
DETAIL = (slice(222, 302), slice(204, 284))
"""Rows and columns that are shown enlarged."""
WHITE = 4.0
"""Brightness, of flat light, that is shown white."""


def caustic(scene: Scene, device: str = "cpu") -> tuple[torch.Tensor, torch.Tensor]:
    """Irradiance of the example's plate, and of one without relief, simulated where it is wanted."""
    simulator = CausticSimulator(scene, device=device)
    truth = read_heights(ROOT / "examples" / "data" / "true_heights.npy")
    heights = torch.tensor(truth, dtype=torch.float32, device=simulator.device)
    return simulator(heights), simulator(torch.zeros_like(heights))


def shown(frame: np.ndarray, dark: np.ndarray, exposure: float) -> np.ndarray:
    """Colours of a frame for the eye: offset off, gamma of sRGB."""
    light = (frame.astype(float) - dark.mean()) / (FULL_SCALE * exposure * WHITE)
    return np.moveaxis(np.clip(light, 0, 1) ** (1 / 2.2), 0, -1)


def main(target: Path) -> None:
    """Photos side by side; below each a part, enlarged."""
    scene = Scene()
    image, flat = caustic(scene)
    configs = {"perfect": CameraConfig()} | {name: read_camera(path) for name, path in CAMERAS.items()}
    figure, rows = plt.subplots(2, len(configs), figsize=(12, 6.2), layout="constrained")
    for (name, config), whole, part in zip(configs.items(), *rows, strict=True):
        frames = photographs(Camera(config, scene), image, flat, seed=0)
        picture = shown(frames.photo, frames.dark, config.sensor.exposure)
        whole.imshow(picture, interpolation="antialiased")
        whole.set_title(name)
        part.imshow(picture[DETAIL], interpolation="nearest")
        top, left = DETAIL[0].start, DETAIL[1].start
        size = DETAIL[0].stop - top
        whole.add_patch(Rectangle((left, top), size, size, fill=False, color="white", lw=0.8))
        for axes in (whole, part):
            axes.set(xticks=[], yticks=[])
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
