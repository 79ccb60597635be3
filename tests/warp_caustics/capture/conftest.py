"""A caustic with filaments and a flat field, as one model camera each sees them; rendered once."""

import numpy as np
import pytest

from warp_caustics.capture.distortion import Distortion
from warp_caustics.scene import Scene

from .pinhole_camera import BARREL, PERSPECTIVE, TILTED, PinholeCamera, caustic

M = 96


class View:
    """A camera with the frames that it took.

    Attributes:
        camera: the camera.
        scene: the scene.
        direct: irradiance in the window without any camera, shape [3, M, M].
        seen: light on each camera pixel, shape [3, H, W].
        lit: the same with a flat plate.
        lens: as a person would calibrate it, or None.
    """

    def __init__(self, camera: PinholeCamera, direct: np.ndarray, fine: np.ndarray) -> None:
        self.camera, self.direct, self.fine = camera, direct, fine
        self.scene = Scene(image_pixels=M)
        self.seen, self.lit = camera.expected(fine), camera.expected(1.0)
        self.lens = Distortion(**camera.intrinsics()) if any(camera.lens) else None
        self.photo = camera.record(self.seen, seed=1)
        self.flat = camera.record(self.lit, seed=2)
        self.dark = camera.record(0.0, seed=3)


@pytest.fixture(scope="package")
def light():
    """Irradiance in the window, and four times finer."""
    return caustic(M, 4)


CAMERAS = {"tilt": TILTED, "perspective": PERSPECTIVE, "lens": {**PERSPECTIVE, "lens": BARREL}}


@pytest.fixture(scope="package", params=CAMERAS)
def view(request, light):
    """Each camera in turn."""
    return View(PinholeCamera(width=340, height=300, hot=60, **CAMERAS[request.param]), *light)


@pytest.fixture(scope="package")
def tilted(light):
    """The camera at 5 deg."""
    return View(PinholeCamera(width=340, height=300, hot=60, **TILTED), *light)
