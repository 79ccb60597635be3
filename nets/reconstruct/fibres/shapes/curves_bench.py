"""How far light goes from the relief to the screen, as lines with corners and curves tell it.

Free heights make up for gap, base and index, and lines of one section do not, whether they are straight
(:mod:`nets.reconstruct.fibres.bench.gap_of_lines`) or not. Curves that were fitted to the image on a bench that is not
theirs have bent for it, though, and stay bent on others. So on every bench that is asked they begin anew: heights of
the relief that they were found in follow in closed form, curves are fitted to these, and then for a few iterations to
the image, at few pixels and one wavelength, without what the lattice is off by there: three seconds on a core. Two
rings behind 0.1 mm of air, told as none, leave 128, 45, 27, 46 (in 1e-5) with light that goes -10, 0, 4.8, 10 %
farther, where it goes 4.9 %; a word behind 1 mm leaves 83, 63, 45, 51 with 0, 10, 30, 70 %, where it goes 49.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.far_gap import mapped
from nets.reconstruct.fibres.bench.gap_fits import unlikely
from nets.reconstruct.fibres.bench.gap_of_lines import FARTHER, along
from nets.reconstruct.fibres.bench.least_of_valley import bracketed, vertex
from nets.reconstruct.fibres.bench.line_posterior import misfit_weight
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.fibres.search.line_search import Answer
from nets.reconstruct.fibres.shapes.curves_fit import curved_heights, fitted_to_image
from nets.reconstruct.fibres.shapes.curves_of_image import CurvesOfImage, CurvesOnImage
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.vectorise.curved import refitted_curves
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene

STEP = 0.1
"""Of (n - 1) D, to either side of the bench that curves were found on: 0.2 mm of gap behind 3 mm of glass."""
FINE_STEP = STEP / 3
"""To either side of the least: farther away what curves leave is no parabola."""
ITERATIONS = 20, 20
"""Of L-BFGS at each bench, before each of which the lattice's own error is taken off where curves are by then."""
MOST_MOVES = 3
"""To benches that curves tell, on each of which they are begun anew."""


class Run(Protocol):
    """What of an image is known."""

    method: FibresOf
    told: LinesView
    view: LinesView
    model: LineModel
    bench: Bench
    numbers: BenchNumbers
    way_sigma: float | None

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera."""

    def note(self, loss: float) -> None:
        """Told after each evaluation."""


@dataclass(frozen=True)
class Trial:
    """Curves on one bench.

    Attributes:
        share: by which (n - 1) D is larger than on the bench that the search started from.
        bench: with that.
        loss: that curves leave there, and what is believed of the bench, in its units.
    """

    share: float
    bench: Bench
    loss: float


@dataclass(frozen=True)
class ToldWay:
    """A bench that curves tell.

    Attributes:
        bench: on which light goes so far.
        share: by which that is farther than on the bench before.
        sigma: its standard deviation.
    """

    bench: Bench
    share: float
    sigma: float


def way_told(run: Run, curves: CurvedLines, said: Answer, significant: float = SIGNIFICANT) -> ToldWay | None:
    """The bench that curves tell, where that is significantly another; None where it is not.

    Args:
        run: with the bench they were found on; it stays as it is.
        curves: that explain the image as well as the relief they were found in, or nearly.
        said: that relief, and how far it may be wrong, at the model's samples.
        significant: standard deviations that another bench must be away.
    """
    if not len(curves) or not set(BEND_LIGHT) & set(run.numbers.names):
        return None
    shape = run.model.shape
    try:
        return _Valley(run, curves, said).least(significant)
    finally:
        run.model.shape = shape


class _Valley:
    """Trials along the valley from one bench."""

    def __init__(self, run: Run, curves: CurvedLines, said: Answer):
        self.run, self.curves, self.said, self.shape = run, curves, said, run.model.shape
        self.weight = 0.0

    def least(self, significant: float) -> ToldWay | None:
        """Where it is least, if that is so many standard deviations elsewhere."""
        here = self.trial(0.0)
        sides = [self.trial(side * STEP) for side in (-1, 1)]
        best = min(here, *sides, key=lambda each: each.loss)
        three: Sequence[Trial] | None = (sides[0], here, sides[1])
        if best is not here:
            three = bracketed(lambda _, share: self.trial(share), here, best)
        found = None if three is None else self.vertex(three)
        if three is None or found is None or abs(found[0]) <= significant * found[1]:
            return None
        middle = min(three[1], self.trial(found[0]), key=lambda each: each.loss)
        near = [self.trial(middle.share + side * FINE_STEP) for side in (-1, 1)]
        found = self.vertex((near[0], middle, near[1])) or found
        gain = here.loss - min(middle.loss, *(each.loss for each in near))
        share, sigma = found
        if abs(share) <= significant * sigma or gain <= self.weight * significant**2 / 2:
            return None
        return ToldWay(along(self.run.numbers, self.run.bench, share), share, sigma)

    def vertex(self, three: Sequence[Trial]) -> tuple[float, float] | None:
        """Share at which a parabola is least, and its standard deviation; None where there is none."""
        left, middle, right = three
        if not math.isfinite(left.loss + middle.loss + right.loss):
            return None
        least, curvature = vertex(left, middle, right)
        return (least, math.sqrt(self.weight / curvature)) if curvature > 0 else None

    def trial(self, share: float) -> Trial:
        """Curves begun anew on a bench; where there is none with an infinite loss."""
        run, numbers = self.run, self.run.numbers
        try:
            bench = along(numbers, run.bench, share) if share else run.bench
            scene = numbers.scene_of(bench.values)
            said = mapped(self.said, numbers.scene_of(run.bench.values), scene)
        except InputError:
            return Trial(share, run.bench, math.inf)
        run.model.shape = self.shape
        relief, spread = (each.cpu().float() for each in (said.relief_m, said.spread_m))
        begun, _ = refitted_curves(run.model, self.curves, relief, spread)
        one = OneWavelength.clearest(run.view.image, scene, run.view.camera)
        fit = one.fit(run.model, usual_pixels(scene), report=run.note)
        lines, loss = begun, math.inf
        for iterations in ITERATIONS:
            fit.correct_at(curved_heights(ChainModel(run.model), lines))
            lines, loss = fitted_to_image(fit, lines, iterations, run.view.noise)
        if not self.weight:
            self.weight = misfit_weight(fit, loss)
        return Trial(share, bench, loss + self.weight / 2 * unlikely(numbers, bench))


def curves_on_their_bench(run: Run, found: Reconstruction) -> CurvesOnImage | None:
    """Lines with corners and curves along the ridges of a result, on the bench that they tell; None for none.

    Where they are begun at few pixels they tell it; there they are begun anew, and tell it better, for their section
    was not theirs before. The run has their bench and view where they are taken.

    Args:
        run: on the bench of the result.
        found: the result.

    Raises:
        KeyboardInterrupt: the time is over.
    """
    here, there, shape, significant = found, found, run.model.shape, SIGNIFICANT
    view, bench, sigma = run.view, run.bench, None
    curves, moves = None, 0
    while True:
        network = network_on(run.method, run.view, run.view is run.told)
        search = CurvesOfImage(run.method, run.view, run.model, run.note, network)
        begun = search.begun(there)
        if begun is None or run.method.takes_bench_as_told or moves == MOST_MOVES:
            break
        told = way_told(run, begun[0], search.said(there), significant)
        if told is None:
            break
        scenes = (run.numbers.scene_of(each.values) for each in (run.bench, told.bench))
        there, run.bench, sigma = as_shown(there, *scenes), told.bench, told.sigma
        run.view, run.model.shape, significant, moves = run.on(run.bench, view.camera), shape, FARTHER, moves + 1
    if begun is not None:
        curves = search.ended(begun, there, (here, view))
    if curves is None:
        run.view, run.bench = view, bench
        return None
    run.view, run.way_sigma = search.view, sigma
    return curves


def as_shown(found: Reconstruction, here: Scene, there: Scene) -> Reconstruction:
    """A result whose heights show on another bench what they do on this one."""
    spread = np.zeros_like(found.heights_m) if found.uncertainty_m is None else found.uncertainty_m
    moved = mapped(Answer(torch.as_tensor(found.heights_m), torch.as_tensor(spread)), here, there)
    spread_m = None if found.uncertainty_m is None else moved.spread_m.numpy()
    return dataclasses.replace(found, heights_m=moved.relief_m.numpy(), uncertainty_m=spread_m)


def network_on(method: FibresOf, view: LinesView, is_told: bool) -> Direct | None:
    """The network on the bench of a view; None beyond its family."""
    try:
        return method.network if is_told else method.network.on_bench(view.scene)
    except MismatchError:
        return None
