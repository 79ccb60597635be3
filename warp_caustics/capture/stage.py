"""What one step between camera and irradiance did, for people to look at."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt


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
