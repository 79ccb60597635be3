"""The camera that lines tell, better than the network's first heights did."""

from typing import Protocol

import numpy as np
import torch

from nets.reconstruct.fibres.bench_of_lines import Bench
from nets.reconstruct.fibres.image_fit import FINE_PHOTONS_PER_PIXEL, ImageFit
from nets.reconstruct.fibres.lines_view import LinesView
from warp_caustics.prints.model import LineModel

LEAST_BLUR_PX = 0.005
"""By which lines tell a camera of another blur for anything to be made of it [px]."""
ITERATIONS = 20
"""Of L-BFGS with that camera."""


class Run(Protocol):
    """Lines of one image so far."""

    model: LineModel
    lines: torch.Tensor
    view: LinesView
    bench: Bench
    moves_section: bool

    def note(self, loss: float) -> None:
        """Told after each evaluation; may raise."""

    def on(self, bench: Bench) -> LinesView:
        """The image on a bench, with the camera that the lines tell there."""


def fit_with_camera(run: Run) -> None:
    """Lines and view with the camera that they tell, where that leaves less of the image.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    lines, view, shape = run.lines, run.view, run.model.shape
    seen = run.on(run.bench)
    if np.abs(seen.blur_px - view.blur_px).max() < LEAST_BLUR_PX:
        return
    about = seen.scene, seen.image, run.model, seen.scene.image_pixels
    fit = ImageFit(*about, photons_per_pixel=FINE_PHOTONS_PER_PIXEL, report=run.note, blur_px=seen.blur_px)
    fit.correct_at(run.model.heights(lines))
    try:
        found = fit.descend(lines, ITERATIONS, with_section=run.moves_section).lines
    except KeyboardInterrupt:
        run.model.shape = shape
        raise
    was, now = view.left(lines), seen.left(found)
    if was is None or now is None or not now < was:
        run.model.shape = shape
        return
    run.lines, run.view = found, seen
