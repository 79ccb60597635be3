"""A frame with all that is known of how it was taken, and what becomes of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.mixing import Mixing
from warp_caustics.capture.registration import Registration
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import BoolImage
from warp_caustics.reconstruct.base import CausticImage

if TYPE_CHECKING:
    from warp_caustics.scene import Scene


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame of a caustic and what calibrates it.

    Attributes:
        image: the frame, shape [C, H, W]; exactly the window, [n_w, m, m], without registration.
        scene: gives wavelengths, their L_i [W/m^2] and the number of pixels.
        dark: the same camera and exposure with the light off, shape [C, H, W].
        flat: the same camera with a flat plate, shape [C, H, W].
        flat_dark: dark frame of the flat field's exposure; ``dark`` if not given.
        wavelength_order: wavelength of each file channel, as text in nanometres ("610,530,430") or as numbers in
            metres. Not given: as the file records, else longest first.
        exposure: with a flat field, exposure of the image divided by that of the flat; without one, value in the
            file per W/m^2. One number, or one per wavelength of the scene.
        registration: where the window lies in the frame; the frame is then taken to the window's pixels.
        mixing: how camera channels see the wavelengths; channels are then unmixed, and their order is the matrix's.
        hot_pixels: look for pixels that stand out of the dark frame or of all their neighbours; they are replaced and
            masked.
        blur_px: standard deviation of the blur of lens and sensor [pixels of the window], to be divided out.
        is_dark_subtracted: the image holds no offset any more; ``dark`` is for the flat field only.
        stages: what was done before, to go first on record.
    """

    image: ImageFile
    scene: "Scene"
    dark: ImageFile | None = None
    flat: ImageFile | None = None
    flat_dark: ImageFile | None = None
    wavelength_order: str | Sequence[float] | None = None
    exposure: float | Sequence[float] | None = None
    registration: Registration | None = None
    mixing: Mixing | None = None
    hot_pixels: bool = False
    blur_px: float | None = None
    is_dark_subtracted: bool = False
    stages: Sequence[CaptureStage] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width [px]."""
        height, width = self.image.values.shape[1:]
        return height, width

    def calibration_frames(self) -> dict[str, ImageFile]:
        """The frames beside the image, by what people call them."""
        named = (("dark frame", self.dark), ("flat field", self.flat), ("dark frame of the flat field", self.flat_dark))
        return {kind: frame for kind, frame in named if frame is not None}

    def part(self, channels: Sequence[int] | slice, rows: slice, columns: slice) -> "Shot":
        """The same of some channels, rows and columns of all frames; the registration stays as it is."""

        def of(frame: ImageFile) -> ImageFile:
            return replace(frame, values=frame.values[:, rows, columns][channels])

        dark, flat, flat_dark = (frame and of(frame) for frame in (self.dark, self.flat, self.flat_dark))
        return replace(self, image=of(self.image), dark=dark, flat=flat, flat_dark=flat_dark)


@dataclass(frozen=True, eq=False)
class Capture:
    """A calibrated capture, channels in the order of the scene's wavelengths.

    Attributes:
        irradiance: light on the screen [W/m^2], float32, shape [n_w, m, m]; noise around 0 may be negative.
        noise_std: standard deviation of the pixel noise where the irradiance is near L_i [W/m^2], shape [n_w];
            NaN where the image is too small to tell.
        saturated_fraction: share of the pixels at full scale, shape [n_w].
        mask: pixels that hold a measurement, shape [n_w, m, m].
        warnings: one line for each thing a person should know.
        steps: what was done, one line each.
        stages: the same with pictures and numbers.
    """

    irradiance: npt.NDArray[np.float32]
    noise_std: npt.NDArray[np.float64]
    saturated_fraction: npt.NDArray[np.float64]
    mask: BoolImage
    warnings: tuple[str, ...]
    steps: list[str]
    stages: tuple[CaptureStage, ...] = ()

    @property
    def caustic(self) -> CausticImage:
        """The image as methods of reconstruction take it."""
        is_known = bool(np.isfinite(self.noise_std).all())
        return CausticImage(self.irradiance, self.noise_std if is_known else None, self.mask)
