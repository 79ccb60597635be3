"""All that a report shows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from warp_caustics.capture.stage import CaptureStage
    from warp_caustics.inspection.findings import Inspection
    from warp_caustics.scene import Scene
    from warp_caustics.types import FloatArray


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Arrays and figures of one plate.

    Attributes:
        title: heading, for example the name of the image.
        scene: gives plate, wavelengths and window.
        record: ``result.json`` as a mapping: method, residual, settings, warnings, versions, hashes of the inputs.
        measured: calibrated input [W/m^2], shape [n_w, m, m].
        simulated: caustic of the recovered relief [W/m^2], shape [n_w, m, m].
        heights_m: recovered relief [m], shape [n, n].
        uncertainty_m: its standard uncertainty [m], shape [n, n], if known.
        reference_m: true relief [m], shape [n, n], if known.
        stages: what was done to the frame.
        inspection: comparison with a design, if there is one.
        mask: pixels of ``measured`` that hold a measurement, shape [n_w, m, m]; None if all do.
        samples_m: reliefs that explain the image about as well [m], shape [N, n, n], if they were asked for.
    """

    title: str
    scene: "Scene"
    record: Mapping[str, Any]
    measured: "FloatArray"
    simulated: "FloatArray"
    heights_m: "FloatArray"
    uncertainty_m: "FloatArray | None" = None
    reference_m: "FloatArray | None" = None
    stages: "Sequence[CaptureStage]" = ()
    inspection: "Inspection | None" = None
    mask: "npt.NDArray[np.bool_] | None" = None
    samples_m: "FloatArray | None" = None
