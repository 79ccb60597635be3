"""What cameras cost: operator, derivative and a photo with its dark and flat frames.

On a CPU in seconds of one thread, which other work on the machine changes least; on a GPU by the clock.

python -m benchmarks.camera
python -m benchmarks.camera --device cuda
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch

from benchmarks.plot_cameras import CAMERAS, caustic
from warp_caustics.camera.config import CameraConfig, read_camera
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.camera.photographs import photographs
from warp_caustics.scene import Scene

REPEATS = 5


def from_the_side(pixels: int) -> CameraConfig:
    """A camera that looks from the side; 720 x 640 for pictures of 512 pixels."""
    corners = ((90, 40), (640, 52), (622, 600), (78, 580))
    places = tuple((x * pixels / 512, y * pixels / 512) for x, y in corners)
    frame = (round(720 * pixels / 512), round(640 * pixels / 512))
    return CameraConfig(psf_px=0.5, frame_px=frame, corners_px=places)


def main() -> None:
    """Print a table of milliseconds, medians of several runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--pixels", type=int, default=512)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    scene = Scene(image_pixels=arguments.pixels)
    image, flat = caustic(scene, arguments.device)
    cameras = {"perfect": CameraConfig()} | {name: read_camera(path) for name, path in CAMERAS.items()}
    cameras |= {"from the side": from_the_side(arguments.pixels)}
    print("| camera | operator | and derivative | photo, dark, flat |")
    print("|---|---|---|---|")
    for name, config in cameras.items():
        camera = Camera(config, scene, device=arguments.device)
        free = CameraParameters(*(value.clone().requires_grad_() for value in camera.parameters))
        light = image.clone().requires_grad_()

        def forward(camera: Camera = camera) -> None:
            with torch.no_grad():
                camera(image)

        def derivative(camera: Camera = camera, free: CameraParameters = free, light: torch.Tensor = light) -> None:
            camera(light, free).square().mean().backward()

        def frames(camera: Camera = camera) -> None:
            photographs(camera, image, flat, 0)

        times = [milliseconds(job, arguments.device) for job in (forward, derivative, frames)]
        print(f"| {name} | " + " | ".join(f"{value:.3g} ms" for value in times) + " |")


def milliseconds(job: Callable[[], None], device: str) -> float:
    """Median time of a job once it is warm [ms]."""
    taken = []
    clock = time.perf_counter if device.startswith("cuda") else time.process_time
    for _ in range(REPEATS + 1):
        start = clock()
        job()
        if device.startswith("cuda"):
            torch.cuda.synchronize(device)
        taken.append(1e3 * (clock() - start))
    return statistics.median(taken[1:])


if __name__ == "__main__":
    main()
