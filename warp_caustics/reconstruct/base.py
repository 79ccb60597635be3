"""What every reconstruction method takes and returns."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from warp_caustics.reconstruct.trust import Trust
from warp_caustics.types import FloatArray

StopReason = Literal["discrepancy", "converged", "max_iterations", "max_time", "interrupted"]


@dataclass(frozen=True)
class CausticImage:
    """A measured caustic, ready for reconstruction.

    Attributes:
        irradiance: [W/m^2], shape [n_w, m, m].
        noise_std: standard deviation of the noise where the irradiance is about 1, per
            wavelength [W/m^2], shape [n_w]; None if unknown.
        mask: False where a pixel must be ignored (saturated, dead), shape [n_w, m, m]; what it holds, no number even,
            does not matter (but a network is shown one that is brighter than its neighbours). None if all pixels count.
    """

    irradiance: FloatArray
    noise_std: FloatArray | None = None
    mask: npt.NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Progress:
    """State of a running reconstruction, handed to the caller after every iteration.

    Attributes:
        stage: human-readable stage, for example ``"level 2 of 4, 64 x 64"``.
        iteration: iterations done in all stages.
        total: iterations planned in all stages (an upper bound).
        residual: relative image residual ||S(h) - I|| / ||I|| at the present stage.
        elapsed_s: time since the start [s].
    """

    stage: str
    iteration: int
    total: int
    residual: float
    elapsed_s: float


ProgressCallback = Callable[[Progress], None]
"""May raise KeyboardInterrupt (Ctrl-C does): methods then return their best result so far."""


@dataclass(frozen=True)
class Reconstruction:
    """Result record, the same for all methods.

    Attributes:
        method: name of the method.
        heights_m: recovered relief above the base [m], shape [n, n].
        image: caustic of the recovered relief [W/m^2], shape [n_w, m, m]; at the exposure of the measured one where
            the method found that (``counters["exposure"]``). Never blurred, its channels never apart.
        residual: relative image residual ||image - measured|| / ||measured||, each wavelength in units of its light.
            Where the method found a camera (``counters["camera"]``), the image is blurred as the measured one is, and
            the measured channels are moved together.
        stop_reason: why the method stopped.
        history: one entry per iteration: stage, iteration, residual, loss, elapsed_s.
        timings_s: wall time per part [s].
        counters: what happened to the light (energy budget) and how often what ran.
        settings: everything needed to repeat the run.
        warnings: what the user should know.
        uncertainty_m: standard uncertainty of the heights [m], shape [n, n]; None where a method has none.
        no_uncertainty: why there is none; empty where there is one.
        trust: how far the result is to be believed, asked in the same way of every method.
        iterates_m: relief before the first and after every iteration [m], shape [K + 1, n, n]; None where
            they were not kept.
        fibres_m: printed lines that make up the relief, rows (x0, y0, x1, y1, width, height) [m], shape [L, 6]; None
            where a method finds none.
    """

    method: str
    heights_m: FloatArray
    image: FloatArray
    residual: float
    stop_reason: StopReason
    history: list[dict[str, Any]] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    counters: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    uncertainty_m: FloatArray | None = None
    iterates_m: FloatArray | None = None
    fibres_m: FloatArray | None = None
    no_uncertainty: str = ""
    trust: Trust | None = None


class Reconstructor(ABC):
    """A method that recovers heights from one caustic."""

    name: str

    @abstractmethod
    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief.

        Args:
            image: the measured caustic.
            initial: starting relief [m], shape [n, n]; flat if None.
            progress: called after every iteration.

        Raises:
            InputError: image or initial relief do not fit the scene.
        """
