"""The lens of an image or its stray light, which pass for each other.

A point spread with wide tails takes light from bright lines and lays it over everything, as stray light does. On a
bench that was found with 8 % of stray light, of 20, lines and a lens of tails left 0.98 times the noise, were 1.4 um
off and stated 0.8: once there was that lens no stray light was missing any more, nor did any other number of the bench
help. So where light alone would explain clearly more, both are asked, each by itself, and that which leaves less has
the first word; light where they leave as much, which is fewer numbers: a point spread of 24 a channel took 5 % of stray
light upon itself by weights that sharpen, 0.8 % below what light and a lens left, with lines three times as far off.
"""

from collections.abc import Collection
from typing import Protocol

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.camera_of_lines import Run as RunWithCamera
from nets.reconstruct.fibres.bench.camera_of_lines import fit_through_lens
from nets.reconstruct.fibres.bench.light_of_lines import Run as RunWithLight
from nets.reconstruct.fibres.bench.light_of_lines import fit_with_light, tells_light
from nets.reconstruct.fibres.bench.run_state import RunState
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera

AS_MUCH = 1.01
"""Of what a lens leaves, that light may leave to have the first word."""


class Run(RunWithLight, RunWithCamera, Protocol):
    """Lines of one image so far."""

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera or the one that the lines tell there."""

    def together(self, names: Collection[str] | None = None) -> BenchOfLines:
        """Finds bench and lines with the camera so far, by some of the bench's numbers or all."""


def fit_through_lens_or_with_light(run: Run) -> None:
    """Lines with the camera that they tell, with stray and uneven light, or both, as the image has it.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those so far.
    """
    before = RunState.of(run)
    fit_through_lens(run)
    if run.view is before.view:
        return
    by_lens, is_light = RunState.of(run), False
    before.put(run)
    try:
        if not tells_light(run):
            return
        fit_with_light(run)
        if run.bench is before.bench:
            return
        fit_through_lens(run)
        by_light, left = run.view.left(run.lines), by_lens.left
        is_light = by_light is not None and left is not None and by_light < AS_MUCH * left
    finally:
        if not is_light:
            by_lens.put(run)
