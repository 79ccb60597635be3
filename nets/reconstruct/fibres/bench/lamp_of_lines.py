"""A lamp that is seen as large: lines tell it from a lens.

Both blur. A lens blurs all of a picture alike; a lamp of half angle a by R = D sin(a), where D is the way of the light
to the screen, which is longer from the crown of a line than from the plate, and longer the steeper it is. What is left
of that where a lens stands for the lamp is a quarter more than noise under a lamp of 1 degree, and passes for another
gap: 4.9 um off. Of a blur that was found each share may be the lamp's; that which leaves least is asked of the lines.

A lamp is a disc, too, and a lens need not be what it is taken for: behind a lens of tails a lamp of 5 degrees left less
than a Gaussian, where there was one of 1 degree, and sent a gap 0.5 mm away. So what a lamp leaves is compared with
what the best point spread leaves, which is alike everywhere; and must be noise, or much less.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.camera_of_lines import spread_asked
from nets.reconstruct.fibres.bench.less_believed import MUCH_LESS
from nets.reconstruct.fibres.bench.run_state import LinesRun, RunState
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import MAX_LAMP_HALF_ANGLE_RAD, Scene
from warp_caustics.way_of_light import way_of_light_m

LEAST_BLUR_PX = 0.1
"""Of the camera so far, below which no lamp is asked for: 0.3 degrees on the default bench."""
SHARES = (0.0, 0.3, 0.7, 1.0)
"""Of the blur's square, that may be the lamp's: asked in turn while each leaves less than the one before."""
FEW = 8
"""Iterations of L-BFGS with each: lines that have made up for a lens leave more under the right lamp at first."""
LIKELY = 1.2
"""Times what the lens leaves, above which no lamp is looked at further: on a plate blurred by 1 px they leave 1.3 to
1.8 times that, under a lamp of 2 degrees the nearest 0.9."""
RESTS = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
"""Of what a lamp leaves of the blur, that may be the lens's: a lamp blurs crowns of lines more than a flat plate."""
GAIN, CLEAR = 0.97, 1.2
"""What lines leave must fall by this factor for a lamp to be taken in place of a lens, if that is then below so many
times the noise; by ``MUCH_LESS`` where more is left: under lamps of 1 and 2 degrees 1.09 and 1.16 are left, and 1.24 to
1.35 through a lens."""
LEAST_LEFT = 1.05
"""Discrepancy below which a lens explains the image, and no lamp is asked for."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera or the one that the lines tell there."""

    def together(self) -> BenchOfLines:
        """Finds bench and lines with the camera so far."""


def half_angle_of(blur_px: float, scene: Scene) -> float:
    """Of the lamp that blurs a flat plate's picture by so much [rad]: a disc's standard deviation is half its radius.

    Args:
        blur_px: standard deviation on the screen [px].
        scene: the bench; its lamp is parallel but for its size.
    """
    return math.asin(min(1.0, 2 * blur_px * max(scene.pixel_size_m) / way_of_light_m(scene)))


def with_lamp(scene: Scene, half_angle_rad: float) -> Scene:
    """The scene under a lamp of that half angle."""
    return scene.model_copy(update={"lamp_half_angle_rad": half_angle_rad})


def fit_with_lamp(run: Run) -> None:
    """Lines under a lamp of a size, where that leaves clearly less of the image than any lens.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    blur_px, told = run.view.camera.blur.copy(), run.numbers.scene
    if blur_px.max() < LEAST_BLUR_PX or not told.is_collimated or told.lamp_half_angle_rad:
        return
    kept, is_taken = RunState.of(run), False
    was = left_where_moved(kept)
    if was < LEAST_LEFT or math.isinf(was):
        return
    try:
        tried = _of_shares(run, kept)
        best = min(tried, key=lambda share: left_where_moved(tried[share]))
        if best == 0 or left_where_moved(tried[best]) > LIKELY * was:
            return
        lens = was if kept.view.camera.spread is not None else min(was, _through_spread(run, kept))
        between = least_between({share: left_where_moved(state) ** 2 for share, state in tried.items()})
        tried[between] = _under(run, kept, between)
        min(tried.values(), key=left_where_moved).put(run)
        run.lines, _ = run.together().on(run.lines, run.bench)
        now = left_where_moved(RunState.of(run))
        is_taken = now < (GAIN if now <= CLEAR else MUCH_LESS) * lens
    finally:
        if not is_taken:
            kept.put(run)


def left_where_moved(state: RunState) -> float:
    """Discrepancy where light was moved: a point spread of many weights makes up for a lamp nearly everywhere else.

    Infinite where the noise of the image is unknown.
    """
    left = state.view.discrepancy(state.view.relief(state.lines))
    return math.inf if left is None else left


def least_between(values: Mapping[float, float]) -> float:
    """Where the parabola through the least of some values and its neighbours is least; at an end, the end.

    Args:
        values: by where they are; three at least, of which the first is not the least.
    """
    places = sorted(values)
    least = min(max(1, min(range(len(places)), key=lambda k: values[places[k]])), len(places) - 2)
    near = places[least - 1 : least + 2]
    second, first, _ = np.polyfit(near, [values[place] for place in near], 2)
    return float(np.clip(-first / (2 * second), near[0], near[-1])) if second > 0 else near[-1]


def _of_shares(run: Run, kept: RunState) -> dict[float, RunState]:
    """Lines under lamps of shares from none to all, while each leaves less than the one before, and one more.

    The first is a Gaussian lens, for the rest of a lens is one to all lamps.
    """
    tried: dict[float, RunState] = {}
    for share in SHARES:
        tried[share] = _under(run, kept, share)
        if share and left_where_moved(tried[share]) > min(map(left_where_moved, list(tried.values())[:-1])):
            break
    return tried


def _through_spread(run: Run, kept: RunState) -> float:
    """What lines leave after as many steps through the point spread that they tell; infinite where they tell none."""
    kept.put(run)
    camera = spread_asked(run.view, run.view.relief(run.lines))
    if camera is None:
        return math.inf
    run.view = LinesView(run.view.resimulation.blurred_by(camera), run.model)
    return left_where_moved(_after_few(run))


def _under(run: Run, kept: RunState, share: float) -> RunState:
    """Lines after a few steps under a lamp of a share of the blur's square, seen through the rest of the lens."""
    kept.put(run)
    camera, numbers = kept.view.camera, kept.numbers
    lamps_px = math.sqrt(share) * float(camera.blur.max())
    angle = min(half_angle_of(lamps_px, numbers.scene), MAX_LAMP_HALF_ANGLE_RAD)
    run.numbers = dataclasses.replace(numbers, scene=with_lamp(numbers.scene, angle))
    rest_px = np.sqrt(np.maximum(camera.blur**2 - lamps_px**2, 0.0))
    sharp = run.on(run.bench, camera.sharp())
    views = [
        LinesView(sharp.resimulation.blurred_by(dataclasses.replace(sharp.camera, blur=factor * rest_px)), run.model)
        for factor in RESTS
    ]
    run.view = _clearest(views, run)
    _after_few(run)
    run.view = _clearest(views, run)
    return RunState.of(run)


def _clearest(views: Sequence[LinesView], run: Run) -> LinesView:
    """Of views that differ in their lens alone that which lines leave least of: the relief is simulated once."""
    heights = views[0].relief(run.lines)
    return min(views, key=lambda view: view.discrepancy(heights) or math.inf)


def _after_few(run: Run) -> RunState:
    """A run whose lines have made a few steps on its bench."""
    together = run.together()
    fit = together.fit_on(run.bench, about=run.lines)
    run.lines = fit.descend(run.lines, FEW, with_section=together.with_section).lines
    return RunState.of(run)
