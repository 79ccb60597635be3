"""The image of a case as a method gets it: a photo brought to irradiance, or irradiance as it was measured."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from data_gen.dataset_config import sample_seed
from data_gen.suites.case import Case
from data_gen.suites.conditions import seen
from data_gen.suites.lens import behind_lens
from data_gen.suites.light import ImageArray, Light, bench_angles, true_heights
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import FULL_SCALE, Photographs, photographs
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import estimate_noise_std
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LEAST_LIGHT = 0.5
"""Of a flat plate's light, below which a pixel is masked: at the window's rim, on a screen that was moved."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What there is of a case once it was measured.

    Attributes:
        heights_m: the truth [m], float64, shape [n, n].
        image: what a method gets.
        frames: photo, dark and flat frame, of a case with a camera.
        warnings: what reading the photo had to say.
    """

    heights_m: FloatArray
    image: CausticImage
    frames: Photographs | None = None
    warnings: tuple[str, ...] = ()


def measured(case: Case, light: Light) -> Measured:
    """Print, light and measure a case: the same numbers on one kind of device, whatever came before.

    Args:
        case: the case.
        light: simulates.
    """
    return measured_relief(case, true_heights(case), light)


def measured_relief(case: Case, heights: FloatArray, light: Light) -> Measured:
    """The same of any relief on the case's bench.

    Args:
        case: gives bench and camera.
        heights: what was printed, with the base's bow [m], shape [n, n].
        light: simulates.
    """
    image = light.behind_plate(case, heights)
    if case.camera is None:
        return Measured(heights, _measured_light(case, image, light))
    frames = photographed(case, image, light.behind_flat(case))
    capture = capture_to_irradiance(
        as_file(frames.photo, case.told),
        scene=case.told,
        dark=as_file(frames.dark, case.told),
        flat=as_file(frames.flat, case.told),
    )
    return Measured(heights, capture.caustic, frames, capture.warnings)


def photographed(case: Case, image: ImageArray, flat: ImageArray) -> Photographs:
    """Frames of the case's camera, drawn on the CPU, where they are the same for every device.

    Args:
        case: with a camera.
        image: irradiance behind the plate, as the camera's lens shows it [W/m^2], shape [n_w, m, m].
        flat: the same without relief.
    """
    assert case.camera is not None
    camera = Camera(behind_lens(case.camera), case.scene)
    seed = sample_seed(case.plate.fingerprint, "camera", case.plate.number)
    return photographs(camera, torch.from_numpy(image), torch.from_numpy(flat), seed)


def as_file(counts: npt.NDArray[np.uint16], scene: Scene) -> ImageFile:
    """Counts as a file of them is read."""
    return ImageFile(counts.astype(np.float32), float(FULL_SCALE), 16, "tiff", (), scene.wavelengths_m, None)


def _measured_light(case: Case, image: ImageArray, light: Light) -> CausticImage:
    """Irradiance of a case without a camera, relative to that of its flat plate as a flat frame tells it."""
    told, mask = case.told, None
    level = np.array(told.radiosity_W_m2, np.float32)[:, None, None]
    relative = image / level
    if case.scene != told:
        flat = light.behind_flat(case) / level
        is_lit = flat >= LEAST_LIGHT
        relative = np.where(is_lit, relative / np.maximum(flat, LEAST_LIGHT), 1.0).astype(np.float32)
        mask = None if is_lit.all() else is_lit
    white = case.plate.rng("noise").standard_normal(image.shape)
    values = seen(relative, case.condition, float(bench_angles(case)[-1]), white) * level
    return CausticImage(values, _noise_std(values, told, mask), mask)


def _noise_std(image: ImageArray, scene: Scene, mask: npt.NDArray[np.bool_] | None) -> FloatArray | None:
    """Noise as ``nsfc reconstruct`` finds it, from the image alone [W/m^2], shape [n_w]; None if it cannot tell."""
    valid = np.ones(image.shape, bool) if mask is None else mask
    found = np.array(
        [
            estimate_noise_std(signal.astype(np.float64), level, good)
            for signal, level, good in zip(image, scene.radiosity_W_m2, valid, strict=True)
        ]
    )
    return found if bool(np.isfinite(found).all()) else None
