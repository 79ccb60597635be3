"""A lamp that is seen as large: lines tell it from a lens.

Both blur. A lens blurs all of a picture alike; a lamp of half angle a by R = D sin(a), where D is the way of the light
to the screen, which is longer from the crown of a line than from the plate, and longer the steeper it is. What is left
of that where a lens stands for the lamp is a quarter more than noise under a lamp of 1 degree, and passes for another
gap: 4.9 um off. Of a blur that was found each share may be the lamp's; that which leaves least is asked of the lines.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.picture_size import way_of_light_m
from warp_caustics.prints.model import LineModel, Shape
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import MAX_LAMP_HALF_ANGLE_RAD, Scene

LEAST_BLUR_PX = 0.1
"""Of the camera so far, below which no lamp is asked for: 0.3 degrees on the default bench."""
SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Of the blur's square, that may be the lamp's."""
FEW = 8
"""Iterations of L-BFGS with each: lines that have made up for a lens leave more under the right lamp at first."""
NEAR = (0.94, 1.06)
"""Of the half angle that leaves least, which are tried, too."""
LIKELY = 1.2
"""Times what the lens leaves, above which no lamp is looked at further: on a plate blurred by 1 px they leave 1.3 to
1.8 times that, under a lamp of 2 degrees the nearest 0.9."""
GAIN = 0.97
"""What lines leave must fall by this factor for a lamp to be taken in place of a lens."""
LEAST_LEFT = 1.05
"""Discrepancy below which a lens explains the image, and no lamp is asked for."""


class Run(Protocol):
    """Lines of one image so far."""

    model: LineModel
    lines: torch.Tensor
    view: LinesView
    bench: Bench
    numbers: BenchNumbers

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
    """Lines under a lamp of a size, where that leaves clearly less of the image than the lens that was found.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    blur, told = float(np.max(run.view.camera.blur)), run.numbers.scene
    if blur < LEAST_BLUR_PX or not told.is_collimated or told.lamp_half_angle_rad:
        return
    kept = _State(run.lines, run.view, run.numbers, run.model.shape)
    was, is_taken = kept.left, False
    if was < LEAST_LEFT or math.isinf(was):
        return
    try:
        best = _least(run, kept, [half_angle_of(math.sqrt(share) * blur, told) for share in SHARES])
        if best is None or best.left > LIKELY * was:
            return
        near = [factor * best.numbers.scene.lamp_half_angle_rad for factor in NEAR]
        nearer = _least(run, kept, near)
        (best if nearer is None else min(best, nearer, key=lambda each: each.left)).put(run)
        run.lines, _ = run.together().on(run.lines, run.bench)
        is_taken = _State(run.lines, run.view, run.numbers, run.model.shape).left < GAIN * was
    finally:
        if not is_taken:
            kept.put(run)


class _State(NamedTuple):
    """What a lamp changes of a run."""

    lines: torch.Tensor
    view: LinesView
    numbers: BenchNumbers
    shape: Shape

    @property
    def left(self) -> float:
        """Discrepancy where light was moved: a point spread of many weights makes up for a lamp nearly everywhere."""
        left = self.view.discrepancy(self.view.relief(self.lines))
        return math.inf if left is None else left

    def put(self, run: Run) -> None:
        run.lines, run.view, run.numbers, run.model.shape = self


def _least(run: Run, kept: _State, half_angles_rad: Sequence[float]) -> _State | None:
    """Of lamps that which leaves least after a few steps; None where none is possible."""
    found = [_under(run, kept, angle) for angle in half_angles_rad if angle < MAX_LAMP_HALF_ANGLE_RAD]
    return min(found, key=lambda each: each.left) if found else None


def _under(run: Run, kept: _State, half_angle_rad: float) -> _State:
    """Lines after a few steps under a lamp, seen through what is left of the lens."""
    kept.put(run)
    numbers = kept.numbers
    run.numbers = dataclasses.replace(numbers, scene=with_lamp(numbers.scene, half_angle_rad))
    sharp = run.on(run.bench, ChannelCamera.perfect(numbers.scene.n_wavelengths, numbers.scene.image_pixels))
    run.view = run.on(run.bench, sharp.resimulation.found_camera(sharp.relief(run.lines), exactly=True))
    together = run.together()
    fit = together.fit_on(run.bench, about=run.lines)
    lines = fit.descend(run.lines, FEW, with_section=together.with_section).lines
    return _State(lines, run.view, run.numbers, run.model.shape)
