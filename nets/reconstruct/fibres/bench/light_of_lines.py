"""Light that lines tell: what is lost of it on its way, what is stray, and how even it is; no other bench is needed."""

import dataclasses
from collections.abc import Collection
from functools import partial
from typing import Protocol

import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, field_modes_on, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.run_state import LinesRun, kept_if_less
from nets.reconstruct.fibres.image.image_fit import WIDTH, ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.losses_of_light import effects_of, with_losses
from warp_caustics.found_bench.bench_numbers import AMBIENT
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

LIGHT_GAIN = 0.98
"""What is left must fall by this factor, by least squares alone, for stray and uneven light to be asked: lines that are
wrong leave some, too."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    told: LinesView

    def on(self, bench: Bench) -> LinesView:
        """The image on a bench, with the camera that the lines tell there."""

    def together(self, names: Collection[str] | None = None) -> BenchOfLines:
        """Finds bench and lines with the camera so far, by some of the bench's numbers or all."""


def fit_with_losses(run: Run) -> None:
    """Lines with losses of light, where they explain the image better: left out they look like another gap.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    lossy = losses_shown(run)
    if lossy == run.numbers.scene:
        return

    def fit() -> float:
        run.numbers = dataclasses.replace(run.numbers, scene=lossy)
        run.lines, _ = run.together().on(run.lines, run.bench)
        run.view = run.on(run.bench)
        return 1.0

    kept_if_less(run, fit)


def fit_with_light(run: Run) -> None:
    """Lines with light that is uneven, and stray light: what needs no other bench.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    if not tells_light(run):
        return

    def fit() -> float:
        run.lines, run.bench = run.together((AMBIENT,))(run.lines, run.bench)
        run.view = run.on(run.bench)
        return 1.0

    kept_if_less(run, fit)


def losses_shown(run: Run) -> Scene:
    """The bench as it is told with the losses of light that leave least of the image by the lines so far."""
    image = seen_on(run.told.image, run.numbers, run.bench)
    scene = with_losses(run.view.scene, partial(_misfit, run, image))
    return run.numbers.scene.model_copy(update=effects_of(scene))


def tells_light(run: Run) -> bool:
    """Whether clearly less is left of the image with stray light and light that is uneven, by least squares alone."""
    view, seen = run.view, run.view.discrepancy.whole
    if seen.noise is None:
        return False
    picture = view.discrepancy.picture(view.relief(run.lines))
    modes = field_modes_on(picture.shape[0], picture.shape[-1], picture.device).to(picture)
    rows = torch.cat((modes * picture, torch.ones_like(picture)[None]))
    weight = seen.weight / (((seen.irradiance - picture) / WIDTH).square() + 1).sqrt()
    weighted = (rows * weight).flatten(1).double()
    normal, right = weighted @ rows.flatten(1).T.double(), weighted @ (seen.irradiance - picture).flatten().double()
    ridge = torch.diag(1e-9 * normal.diagonal())
    change = torch.tensordot(torch.linalg.solve(normal + ridge, right).to(rows), rows, 1)
    was, now = seen.discrepancy(picture), seen.discrepancy(picture + change)
    return was is not None and now is not None and now < LIGHT_GAIN * was


def _misfit(run: Run, image: CausticImage, scene: Scene) -> float:
    """Of the lines so far in a scene, at its exposure."""
    fit = ImageFit(scene, image, run.model, scene.image_pixels, camera=run.view.camera)
    return fit.loss(run.model.heights(run.lines), at_exposure=True)
