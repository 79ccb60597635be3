"""The relief of lines, or a network's, after the steps that ``direct`` ends with."""

from typing import Protocol

from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.refinement import Refinement, SettledRelief, outcome
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.reconstruct.base import Reconstruction, StopReason
from warp_caustics.reconstruct.run_log import RunLog, following
from warp_caustics.types import FloatArray


class ImageRun(Protocol):
    """One image, so far."""

    method: FibresOf
    answer: Reconstruction
    told: LinesView
    log: RunLog
    reason: StopReason
    refined_steps: int


def refined(run: ImageRun, view: LinesView, heights: FloatArray, *, is_trusted: bool = False) -> SettledRelief:
    """A relief refined; says in the run why it ended, if before its time.

    Args:
        run: whose log, time and method.
        view: what it is compared with.
        heights: where to start [m], shape [n, n].
        is_trusted: the image is trusted everywhere, also where the network is sure.
    """
    if run.reason == "interrupted":  # whoever interrupts one refinement does not want another
        return SettledRelief(heights, None, "interrupted")
    answer, log = run.answer, run.log
    spread = None
    if answer.uncertainty_m is not None and not is_trusted:
        spread = answer.uncertainty_m / DIRECT_CALIBRATION.scale
    progress = following(log.progress, len(log.history) + run.refined_steps, log.started, "refinement, ")
    refinement = run.method.refinement
    if view is not run.told:
        refinement = Refinement(view.scene, refinement.options, run.method.device, refinement.scale)
    found = refinement(view.resimulation, heights, log.elapsed_s, progress, spread)
    if found is None:
        run.reason = "max_time"
        return SettledRelief(heights, None, outcome(found))
    run.refined_steps += len(found.history)
    if found.reason in ("interrupted", "max_time"):
        run.reason = found.reason
    return SettledRelief(found.heights, found.found_at, outcome(found))
