"""One capture of a known plate, and the same in larger pixels."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.calibration.plates import FLAT, KnownPlate
from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LEAST_PIXELS = 32
"""Coarser images than this tell nothing of a plate."""
MOST_MISSING = 0.5
"""Share of a large pixel whose small ones may be missing."""
DIVIDED_BRIGHTNESS, RAW_BRIGHTNESS = 0.05, 0.3
"""Prior widths of each channel's brightness: of a lamp that drifts between two frames; of a photo without flat
frame."""


@dataclass(frozen=True, eq=False)
class View:
    """A capture of a plate that is known.

    Attributes:
        name: for people, and of its own parameters.
        plate: what was photographed.
        image: irradiance as a capture has it [W/m^2], shape [n_w, m, m].
        noise: standard deviation of pixels where light is flat [W/m^2], shape [n_w].
        mask: pixels that hold a measurement, shape [n_w, m, m]; None is all.
        is_divided: a flat frame was divided out, and with it uneven light and gains.
    """

    name: str
    plate: KnownPlate
    image: FloatArray
    noise: FloatArray
    mask: npt.NDArray[np.bool_] | None = None
    is_divided: bool = True

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[1] != self.image.shape[2]:
            raise InputError(f"{self.name} has shape {list(self.image.shape)}; give a window, [n_w, m, m]")
        if self.noise.shape != (len(self.image),) or not (np.isfinite(self.noise) & (self.noise > 0)).all():
            raise InputError(
                f"{self.name}: noise {np.round(self.noise, 6).tolist()} W/m^2 is not above 0 for each channel; "
                f"give the "
                "camera's, such as --noise 0.01"
            )
        if self.mask is not None and self.mask.shape != self.image.shape:
            raise InputError(f"{self.name}: mask has shape {list(self.mask.shape)}, its image {list(self.image.shape)}")
        if self.is_divided and self.plate.kind == FLAT:
            raise InputError(
                f"{self.name} is a flat plate divided by a flat frame, which tells nothing; leave the flat frame out"
            )

    @property
    def brightness_prior(self) -> float:
        """Of each channel's brightness, relative."""
        return DIVIDED_BRIGHTNESS if self.is_divided else RAW_BRIGHTNESS

    def binned(self, factor: int) -> "View":
        """The same in pixels ``factor`` times as large; a pixel is the mean of those that count.

        Args:
            factor: divides m.
        """
        if factor == 1:
            return self
        channels, m, _ = self.image.shape
        shape = (channels, m // factor, factor, m // factor, factor)
        counts = np.ones(self.image.shape) if self.mask is None else self.mask.astype(np.float64)
        share = counts.reshape(shape).mean((2, 4))
        mean = (np.where(counts > 0, self.image, 0.0) * counts).reshape(shape).mean((2, 4)) / np.maximum(share, 1e-9)
        kept = share > 1 - MOST_MISSING
        return View(self.name, self.plate, mean, self.noise / factor, kept, self.is_divided)


def factors(pixels: int, finest: int) -> tuple[int, ...]:
    """By how much pixels are enlarged from level to level, coarsest first: powers of 2.

    Args:
        pixels: m of the captures.
        finest: pixels per side that the last level has at most.
    """
    last = 1
    while pixels / last > finest and pixels % (2 * last) == 0:
        last *= 2
    found = [last]
    while pixels % (2 * found[-1]) == 0 and pixels // (2 * found[-1]) >= LEAST_PIXELS and len(found) < 3:
        found.append(2 * found[-1])
    return tuple(reversed(found))


def enlarged_scene(scene: Scene, factor: float) -> Scene:
    """The scene in pixels ``factor`` times as large."""
    return Scene.model_validate(scene.model_dump() | {"image_pixels": round(scene.image_pixels / factor)})


def enlarged_camera(camera: CameraConfig, factor: float) -> CameraConfig:
    """The camera in pixels ``factor`` times as large."""

    def less(value: object) -> object:
        if isinstance(value, tuple):
            return tuple(less(item) for item in value)
        return None if value is None else value / factor  # type: ignore[operator]

    moved = {name: less(getattr(camera, name)) for name in ("psf_px", "box_px", "shift_px", "colour_shift_px")}
    return CameraConfig.model_validate(camera.model_dump() | moved)


def as_tensors(view: View, border: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Image [W/m^2] with 0 where nothing was measured, and which pixels count, shape [n_w, m, m].

    Args:
        view: in its pixels.
        border: pixels on all sides that do not count.
        device: where to compute.
    """
    known = np.isfinite(view.image) if view.mask is None else view.mask & np.isfinite(view.image)
    inner = np.zeros_like(known)
    m = known.shape[-1]
    inner[:, border : m - border, border : m - border] = True
    image = torch.as_tensor(np.where(known, view.image, 0.0), dtype=torch.float64, device=device)
    return image, torch.as_tensor(known & inner, device=device)
