"""A bench on which light goes much farther than was told, or much less far: few pixels tell that of lines.

A gap that nobody measured, or a plate that was said to lie on the screen and does not: heights that are found on the
told bench send light where it goes, and the network's relief explains such an image as well on any bench. Lines of one
section do not. On twelve lines behind 1 mm of air, told as none, at the fewest pixels and one wavelength, they leave
97, 56, 30, 14, 28 in 1e-4 with light that goes 0, 15, 30, 50, 80 % farther, where it goes 49 % farther; and 21 and 30,
15 % farther and 20 % less far, where they leave 10 on the bench that is as told. Steps along that valley
(:mod:`nets.reconstruct.fibres.bench.gap_of_lines`) are for lines that are nearly right, and start too near.
"""

import dataclasses
from typing import Protocol

import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.gap_fits import BENCH_GAIN
from nets.reconstruct.fibres.bench.gap_of_lines import along, on_other_bench
from nets.reconstruct.fibres.bench.run_state import LinesRun, kept_if_less
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.fibres.search.line_search import Answer
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_uncertainty import DISPERSION
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene

ASKED_FROM = 2.0
"""Times the noise of the whole image, that lines leave, from which the bench may be quite another."""
STEP = 1.25
"""Of (n - 1) D: 0.5 mm of gap behind 3 mm of glass."""
MOST_STEPS = 8
"""To one side: to six times the way."""
ITERATIONS = 20
"""Of L-BFGS at each."""
MUCH_LESS = 0.7
"""Of the misfit on the bench they are on, at most, for the first step to be taken; later ones need leave less. Lines on
their own bench leave two and three times as much a step away, and such as are no lines (text, before it is followed)
0.98 to 1.03 of it."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    method: FibresOf
    said: Answer
    is_in_vain: bool

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera."""

    def search(self, start: torch.Tensor, jumps: int, *, is_first: bool = False) -> None:
        """Lines searched for from others, shape [L, 6] [m], by what the network said."""


@dataclasses.dataclass(frozen=True)
class Farther:
    """What lines are on a bench far away.

    Attributes:
        bench: that.
        lines: after a short descent at few pixels, shape [L, 6] [m].
        loss: that they leave there.
    """

    bench: Bench
    lines: torch.Tensor
    loss: float


def fit_far_away(run: Run) -> None:
    """Lines searched for anew on a bench on which light goes much farther, or less far, where few pixels tell it.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    method = run.method
    left = run.view.left(run.lines) if len(run.lines) and not method.takes_bench_as_told else None
    if left is None or left <= ASKED_FROM:
        return
    given = run.said, run.is_in_vain

    def fit() -> float:
        pixels = method.options.pixels_on(method.device.type, method.scene)
        is_halved = pixels % 2 == 0 and pixels // 2 >= method.scene.height_samples
        found = farther(run, pixels // 2 if is_halved else pixels)
        if found is None:
            return 0.0
        scenes = (run.numbers.scene_of(each.values) for each in (run.bench, found.bench))
        run.said, run.bench, run.lines = mapped(run.said, *scenes), found.bench, found.lines
        run.view = run.on(run.bench, run.view.camera)
        run.search(run.lines, method.options.jumps, is_first=True)
        return BENCH_GAIN

    is_kept = False
    try:
        is_kept = kept_if_less(run, fit)
    finally:
        if not is_kept:
            run.said, run.is_in_vain = given


def farther(run: Run, pixels: int) -> Farther | None:
    """The bench on which lines leave least, by steps of :data:`STEP` to either side; None where that is their own.

    The run stays as it is.

    Args:
        run: with lines that do not explain the image.
        pixels: at which they are compared.
    """
    if not len(run.lines) or not set(BEND_LIGHT) & set(run.numbers.names):
        return None
    # Dispersion is what heights on a bench that is too near are told as; from there it is as told.
    glass = {DISPERSION: run.numbers.before[DISPERSION]} if DISPERSION in run.bench.values else {}
    start = dataclasses.replace(run.bench, values={**run.bench.values, **glass})
    here = Farther(run.bench, run.lines, _settled(run, run.bench, run.lines, pixels).loss)
    for factor in (STEP, 1 / STEP):
        near, way = here, 1.0
        for _ in range(MOST_STEPS):
            way *= factor
            try:
                bench = _known_to_half_a_step(along(run.numbers, start, way - 1), near.bench)
                scenes = (run.numbers.scene_of(each.values) for each in (near.bench, bench))
                trial = _settled(run, bench, run.model.clamped(on_other_bench(near.lines, *scenes)), pixels)
            except InputError:  # beyond what a bench may be
                break
            if trial.loss > (MUCH_LESS if near is here else 1.0) * near.loss:
                break
            near = trial
        if near is not here:
            return near
    return None


def _known_to_half_a_step(bench: Bench, nearer: Bench) -> Bench:
    """A bench whose gap, base and index are as uncertain as steps are long, until the valley tells more."""
    apart = {name: abs(bench.values[name] - nearer.values[name]) for name in BEND_LIGHT if name in bench.values}
    return dataclasses.replace(bench, sigma={**bench.sigma, **{name: by / 2 for name, by in apart.items() if by}})


def mapped(answer: Answer, here: Scene, there: Scene) -> Answer:
    """What a network says on one bench as it would look on another: heights that send light as far, F(h') = F(h)."""
    relief, bent = ThinRelief.of(there), ThinRelief.of(here)
    heights = answer.relief_m.double().cpu().numpy()
    moved = relief.unbent(bent.bent(heights))
    share = bent.bending(heights) / relief.bending(moved)
    relief_m, by = (torch.as_tensor(each).to(answer.relief_m) for each in (moved, share))
    return Answer(relief_m, answer.spread_m * by, answer.most)


def _settled(run: Run, bench: Bench, lines: torch.Tensor, pixels: int) -> Farther:
    """Lines, shape [L, 6] [m], after a descent on a bench; their section stays.

    Raises:
        InputError: values that make no bench.
    """
    scene = run.numbers.scene_of(bench.values)
    one = OneWavelength.clearest(run.view.image, scene, run.view.camera)
    found = one.fit(run.model, pixels, metric=one.metric(run.model, pixels)).descend(lines, ITERATIONS)
    return Farther(bench, found.lines, found.loss)
