"""Frames of the model camera as files, to try the command line with.

    PYTHONPATH=. python tests/warp_caustics/capture/photo_example.py FOLDER
    cd FOLDER
    nsfc capture photo.tif --dark dark.tif --flat flat.tif --corners auto --distortion lens.yaml \
        -o irradiance.tif --stages steps.png
    nsfc reconstruct photo.tif --dark dark.tif --flat flat.tif --corners auto --distortion lens.yaml -o result \
        --reference heights.npy

``direct.npy`` is the irradiance itself, without any camera.
"""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np

from warp_caustics.io import write_image
from warp_caustics.prints.line import line_relief


def write_frames(folder: Path, pixels: int = 512, width: int = 1500, height: int = 1300) -> None:
    """photo.tif, dark.tif, flat.tif, corners.yaml (clicked with 0.3 px error), lens.yaml, direct.npy and heights.npy."""
    spec = importlib.util.spec_from_file_location("pinhole_camera", Path(__file__).with_name("pinhole_camera.py"))
    camera_module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = camera_module
    spec.loader.exec_module(camera_module)

    folder.mkdir(parents=True, exist_ok=True)
    direct, fine = camera_module.caustic(pixels, 3)
    # The brightest line is 46 times as bright as the flat plate and must not saturate.
    camera = camera_module.PinholeCamera(
        width=width,
        height=height,
        finer=3,
        hot=400,
        gain=(1200.0, 1300.0, 1100.0),
        lens=camera_module.BARREL,
        **camera_module.PERSPECTIVE,
    )
    for name, light, seed in (("photo", camera.expected(fine), 1), ("flat", camera.expected(1.0), 2), ("dark", 0.0, 3)):
        write_image(folder / f"{name}.tif", camera.record(light, seed=seed).values.astype(np.uint16))
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    clicks = camera.project(signs * 0.025) + np.random.default_rng(5).normal(0, 0.3, (4, 2))
    named = ", ".join(
        f"{name}: [{x:.2f}, {y:.2f}]" for name, (x, y) in zip(("-x-y", "+x-y", "+x+y", "-x+y"), clicks, strict=True)
    )
    (folder / "corners.yaml").write_text(f"corners: {{{named}}}\n")
    (folder / "lens.yaml").write_text(json.dumps({**camera.intrinsics(), "image_px": [width, height]}) + "\n")
    np.save(folder / "direct.npy", direct.astype(np.float32))
    np.save(folder / "heights.npy", line_relief(camera_module.LINES, 128, (0.05, 0.05)))


if __name__ == "__main__":
    write_frames(Path(sys.argv[1]))
