"""The state of one calibration, and what each of its steps did, for people to look at."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.preview import preview
from warp_caustics.io.noise import BoolImage, FloatImage


@dataclass(frozen=True, eq=False)
class CaptureStage:
    """One step from frame to irradiance.

    Attributes:
        name: a word or two, for example ``"dark frame"``.
        text: one line of what was done, with numbers and units.
        before: the image going in, counts or W/m^2, shape [C, H, W]; None if there is nothing to see.
        after: the image coming out, likewise.
        marks_px: points to draw on ``before``, (x, y) from the centre of its first pixel, shape [N, 2].
        figures: numbers of this step by name, their unit in the name.
    """

    name: str
    text: str
    before: npt.NDArray[np.floating[Any]] | None = None
    after: npt.NDArray[np.floating[Any]] | None = None
    marks_px: npt.NDArray[np.float64] | None = None
    figures: dict[str, float] = field(default_factory=dict)


@dataclass
class Work:
    """State of one calibration: channels in scene order, counts turning into W/m^2.

    Attributes:
        signal: what became of the image so far, shape [n_w, H, W]; camera channels until they are unmixed.
        mask: pixels that hold a measurement, same shape.
        level: L_i [W/m^2], shape [n_w].
        labels: name of each wavelength.
        light: flat field without the camera's offset, in the same channels, shape [n_w, H, W]; None if there is none.
        region: pixels whose centre lies in the window, shape [H, W]; None if the frame is the window.
        warnings: one line for each thing a person should know.
        steps: what was done, one line each.
        stages: the same with pictures.
    """

    signal: FloatImage
    mask: BoolImage
    level: FloatImage
    labels: list[str]
    light: FloatImage | None = None
    region: BoolImage | None = None
    warnings: list[str] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    stages: list[CaptureStage] = field(default_factory=list)

    def done(self, name: str, text: str, before: npt.NDArray[np.floating[Any]] | None = None, **figures: float) -> None:
        """Put a step on record; ``before`` is a preview taken before it."""
        self.steps.append(text)
        self.stages.append(CaptureStage(name, text, before, preview(self.signal), None, figures))

    def in_window(self, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values [..., N] of those pixels of images [..., H, W] that lie in the window."""
        if self.region is None:
            return image.reshape(*image.shape[:-2], -1)
        return image[..., self.region]
