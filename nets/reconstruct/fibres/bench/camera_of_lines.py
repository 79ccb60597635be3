"""The camera that lines tell, better than the network's first heights did."""

import dataclasses
from typing import Protocol

import numpy as np
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.run_state import LinesRun, RunState
from nets.reconstruct.fibres.image.image_fit import FINE_PHOTONS_PER_PIXEL, ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.types import FloatArray

LEAST_BLUR_PX = 0.005
"""By which lines tell a camera of another blur for anything to be made of it [px]."""
ITERATIONS = 20
"""Of L-BFGS with that camera."""
TELLING_SHARE = 0.15
"""Of an image, that lines may leave of it at most to be asked for the lens that it was seen through."""
SPREAD_ROUNDS, SPREAD_GAIN = 5, 0.997
"""In which a point spread and lines are found in turn, while what they leave falls by this factor."""
UNSEEN_GAIN = 0.9
"""The same of an image that spectra do not call blurred: what wrong lines leave is blunter or sharper, too."""
CLEAR_GAIN = 0.8
"""The same of all rounds, for a point spread with which more than noise is left."""
WIDER, WIDER_PX = 1.3, 0.35
"""Times the blur before is the widest that is believed, and so much more than what spectra say, which tell none below
0.3 px: of eight cameras spectra said 0.86 to 1.14 times what their point spread is as wide as. Heights that are wrong
everywhere are explained by a camera out of focus, too."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    def note(self, loss: float) -> None:
        """Told after each evaluation; may raise."""

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera or the one that the lines tell there."""

    def search(self, start: torch.Tensor, jumps: int) -> None:
        """Lines searched for from others, shape [L, 6] [m]."""

    def together(self) -> BenchOfLines:
        """Finds bench and lines with the camera so far."""


def _tells_camera(run: Run) -> bool:
    """Whether lines are near enough to the plate's to tell a lens; that may leave many times the noise."""
    return run.view.resimulation(run.view.relief(run.lines)).residual < TELLING_SHARE


def fit_through_lens(run: Run) -> None:
    """Lines with the camera that they tell; what had made up for its lens, lines or a bench, is looked at again.

    A point spread is kept where lines leave nothing but noise with it. Wrong lines, or a picture that lies aside, look
    spread, too: where any that left less was kept, one plate of lines ended 10 um off in place of 3.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those so far.
    """
    is_near = run.view.is_near(run.lines)
    if is_near:
        fit_with_blur(run)
    if run.view.camera.spread is not None:
        fit_with_spread(run)
        return
    if not is_near and not _tells_camera(run):
        return
    kept, is_kept = RunState.of(run), False
    try:
        fit_with_spread(run)
        if run.view.camera.spread is None:
            return
        if run.is_elsewhere:
            fit_on_told(run)
        if not run.view.is_explained(run.lines) and run.view.is_near(run.lines):
            run.search(run.lines, 1)
            fit_with_spread(run)
        is_kept = run.view.is_explained(run.lines)
    finally:
        if not is_kept:
            kept.put(run)


def fit_through_blurring_lens(run: Run) -> None:
    """The same on the last bench, of an image that spectra call blurred.

    Kept of lines that leave more than noise where they leave clearly less, of others where they leave less: behind a
    lens of 0.7 px a Gaussian leaves 1.2 to 1.4 times the noise of bright crowded lines, which passes for noise, and the
    lens 1.05.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those so far.
    """
    if run.view.camera.spread is not None or not run.view.camera.blurs:
        return
    kept, is_kept = RunState.of(run), False
    enough = 1.0 if run.view.is_explained(run.lines) else CLEAR_GAIN
    try:
        fit_with_spread(run)
        was, now = kept.left, run.view.left(run.lines)
        is_kept = was is not None and now is not None and now < enough * was
    finally:
        if not is_kept:
            kept.put(run)


def fit_with_blur(run: Run) -> None:
    """Lines and view with the Gaussian blur that they tell, where that leaves less of the image.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    seen = run.on(run.bench)
    if np.abs(seen.camera.blur - run.view.camera.blur).max() >= LEAST_BLUR_PX:
        _is_taken(run, seen)


def fit_with_spread(run: Run) -> None:
    """Lines and view with the point spread that they tell, in turn, while that leaves less of the image.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those so far.
    """
    for _ in range(SPREAD_ROUNDS):
        camera = spread_asked(run.view, run.view.relief(run.lines))
        if camera is None:
            return
        seen = LinesView(run.view.resimulation.blurred_by(camera), run.model)
        if not run.view.camera.blurs and not _leaves_less(seen, run.lines, run.view):
            return
        if not _is_taken(run, seen, gain_of_spread(run.view)):
            return


def _leaves_less(seen: LinesView, lines: torch.Tensor, view: LinesView) -> bool:
    """Whether a lens that spectra do not see explains lines as they are: no descent is needed to tell."""
    was, now = view.left(lines), seen.left(lines)
    return was is not None and now is not None and now < UNSEEN_GAIN * was


def gain_of_spread(view: LinesView) -> float:
    """Factor by which what is left of a view must fall for a point spread to be taken."""
    return SPREAD_GAIN if view.camera.blurs else UNSEEN_GAIN


def spread_asked(view: LinesView, heights_m: FloatArray) -> ChannelCamera | None:
    """The camera with the point spread that a relief tells [m], shape [n, n]; None where that would change nothing.

    It is asked of images that are blurred, or not explained: what a Gaussian leaves of a lens hides in blunter lines.
    """
    if not view.camera.blurs and view.is_relief_explained(heights_m):
        return None
    camera, known = view.resimulation.with_spread(heights_m), view.camera.spread
    spread, wider = camera.spread, float((camera.blur - WIDER * view.camera.blur).max())
    if spread is None or not spread.is_plausible or wider > (0.0 if known is not None else WIDER_PX):
        return None
    return None if known is not None and spread.is_like(known) else camera


def fit_on_told(run: Run) -> None:
    """Lines on the bench that was told, where another one was found before the camera's point spread was.

    What lies in the halo of a lens looks like stray light to heights, and that like another index to lines: 0.7 and
    1.6 % of flat light, and 0.002 and 0.009, behind diffraction discs of 0.8 and 1.5 px.

    Raises:
        KeyboardInterrupt: the run's time is over; lines and bench are as they were.
    """
    kept, is_nearer = RunState.of(run), False
    told = Bench.told(run.numbers)
    try:
        run.view, run.bench = run.on(told, run.view.camera), told
        run.lines, _ = run.together().on(run.lines, told)
        fit_with_spread(run)
        was, now = kept.left, run.view.left(run.lines)
        is_nearer = was is not None and now is not None and now < was
    finally:
        if is_nearer:
            run.is_elsewhere = False
        else:
            kept.put(run)


def with_spread_of(camera: ChannelCamera, known: ChannelCamera) -> ChannelCamera:
    """A camera that was found anew, with the point spread of one that lines told; as it is where they told none."""
    if known.spread is None:
        return camera
    return dataclasses.replace(camera, spread=known.spread, blur=known.blur)


def _is_taken(run: Run, seen: LinesView, factor: float = 1.0) -> bool:
    """Lines fitted to another view; both are kept if what is left of the image falls below so much of what was."""
    lines, shape = run.lines, run.model.shape
    was = run.view.left(lines)
    about = seen.scene, seen.image, run.model, seen.scene.image_pixels
    fit = ImageFit(*about, photons_per_pixel=FINE_PHOTONS_PER_PIXEL, report=run.note, camera=seen.camera)
    fit.correct_at(run.model.heights(lines))
    try:
        found = fit.descend(lines, ITERATIONS, with_section=run.moves_section).lines
    except KeyboardInterrupt:
        run.model.shape = shape
        raise
    now = seen.left(found)
    if was is None or now is None or not now < factor * was:
        run.model.shape = shape
        return False
    run.lines, run.view = found, seen
    return True
