"""Lines searched for on an image: descents, lines more or less, and jumps on few pixels; then descents on all."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import FEW_PHOTONS_PER_PIXEL, FINE_PHOTONS_PER_PIXEL, ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.fibres.search.drops import with_drops_apart
from nets.reconstruct.fibres.search.each_end import with_each_end
from nets.reconstruct.fibres.search.ends import with_moved_ends
from nets.reconstruct.fibres.search.exchange import exchanged
from nets.reconstruct.fibres.search.growth import grown, pruned
from nets.reconstruct.fibres.search.joins import gaps_between, with_joins
from nets.reconstruct.fibres.search.moves import jump
from nets.reconstruct.fibres.search.rebuild import LINE_FACTOR, rebuilt
from nets.reconstruct.fibres.search.section import (
    with_caps,
    with_cut_bells,
    with_other_family,
    with_section_found,
)
from nets.reconstruct.fibres.search.shadows import grown_in_shadows
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.prints.model import HEIGHT, LineModel
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene

ITERATIONS = 40
"""Of L-BFGS between jumps; half as many on more pixels after a search."""

FINAL_ITERATIONS = 15
"""Of L-BFGS on all pixels. They bring six own plates, printed with some noise and seen by a model camera, from errors
of 0.2 to 3.3 um RMS at 256 pixels to 0.1 to 1.6 um at 512, and what is left of the image down to its noise."""

JUMPING_LINES_FIRST, JUMPING_LINES_LATER = 12, 6
"""Lines that may jump in the first round on few pixels and in others, those with the worst misfit under them; on more
pixels all may, whose ends may be far from the rest of the line and from where the image is explained worst."""

FINE_ROUNDS = 6
"""Rounds on more pixels, at most, while each is worth another."""

ROUND_FACTOR = 0.99
"""A round must lower the misfit by this factor to be followed by another."""

DOING_WELL = 0.75
"""Of what the network's relief leaves on few pixels, up to which lines do well: 0.13 to 0.15 on own plates, 0.35 to
0.72 on other benches than told; those of curves, meanders and drops leave 0.86 to 10."""

FAINT_M = 3e-5
"""Height of a line that may be none: a third of the lowest of Tab. 3, and three times the least that a fit allows."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a network says of the relief.

    Attributes:
        relief_m: shape [n, n] [m].
        spread_m: how far its answers lie apart, shape [n, n] [m].
        most: lines it may consist of.
    """

    relief_m: torch.Tensor
    spread_m: torch.Tensor
    most: int = 60

    @classmethod
    def of(cls, found: Reconstruction, most: int) -> "Answer":
        """What it says first, before its relief is refined."""
        heights = torch.as_tensor(found.heights_m)
        if found.uncertainty_m is None:
            return cls(heights, torch.zeros_like(heights), most)
        return cls(heights, torch.as_tensor(found.uncertainty_m) / DIRECT_CALIBRATION.scale, most)


class LineSearch:
    """A search from lines that are nearly right.

    Args:
        scene: the set-up.
        image: what was measured.
        model: renders lines.
        pixels: size of the image for most of the work; jumps are tried at half as many, where the heights allow it.
        jumps: rounds of growth and jumps, at most; 0 where lines are known to be nearly right.
        iterations: of L-BFGS between jumps.
        finds_section: the model's section and overlap are looked for first.
        moves_section: descents move the section; they do where another was found.
        answer: of the network, which tells where lines may be missing; None leaves their number.
        others: lines of another search [m], shape [M, 6], that may be better in places.
        view: the image and its bench; where lines leave more than noise of it, the search goes on with more pixels.
            None ends it.
        report: called after each evaluation with its loss; may raise.
        camera: whose blur is in the model; its channels lie together. None for a perfect one.
        evolves: places that stay wrong have lines evolve (:mod:`~nets.reconstruct.fibres.search.evolution`).
        gives_way: whether others would do better; asked where lines do not do well on few pixels.
    """

    def __init__(
        self,
        scene: Scene,
        image: CausticImage,
        model: LineModel,
        pixels: int,
        *,
        jumps: int,
        iterations: int = ITERATIONS,
        finds_section: bool = False,
        moves_section: bool = False,
        answer: Answer | None = None,
        others: torch.Tensor | None = None,
        view: LinesView | None = None,
        report: Callable[[float], None] | None = None,
        camera: ChannelCamera | None = None,
        evolves: bool = False,
        gives_way: Callable[[], bool] | None = None,
    ):
        self.jumps, self.iterations, self.answer, self.view = jumps, iterations, answer, view
        self.others, self.evolves, self.gives_way = others, evolves, gives_way
        self.finds_section, self.moves_section = finds_section, moves_section
        self.lines = torch.zeros(0, 6, dtype=torch.float64)
        """The best so far, shape [L, 6] [m]; stays when ``run`` is interrupted."""
        self.is_in_vain = False
        """Whether lines were left because they leave more of the image than the network's relief."""

        # One wavelength tells which lines there are, and nearly where; all of them tell better where.
        camera = camera or ChannelCamera.perfect(scene.n_wavelengths, scene.image_pixels)
        one = OneWavelength.clearest(image, scene, camera)
        is_halved = pixels % 2 == 0 and pixels // 2 >= scene.height_samples
        few = pixels // 2 if is_halved else pixels
        metric = one.metric(model, few)
        self.coarse = self.fine = one.fit(model, pixels, report=report, metric=metric)
        if is_halved:
            self.coarse = one.fit(model, few, photons_per_pixel=FEW_PHOTONS_PER_PIXEL, report=report, metric=metric)
        self.quick = self.coarse if model.device.type == "cpu" else self.fine
        """Ranks what is tried by the hundred; a GPU has time for more pixels."""
        self.last = ImageFit(
            scene,
            image,
            model,
            scene.image_pixels,
            photons_per_pixel=FINE_PHOTONS_PER_PIXEL,
            report=report,
            metric=metric,
            camera=camera,
        )
        """All there is, without the lattice's own error."""

    def run(self, start: torch.Tensor) -> torch.Tensor:
        """Lines that explain the image better, shape [L, 6] [m].

        Those that leave more of it on few pixels than the network's relief does are left as they are. On own plates
        lines that explained the image in the end had come down to 0.13 to 0.15 of that, to 0.35 to 0.72 on other
        benches than told; those of curves, meanders and drops to 0.86 to 10.

        Args:
            start: shape [L, 6] [m], float64.
        """
        self._find(start)
        if self.jumps and not self.is_in_vain:
            self._settle()
            self._rebuild()
        return self.lines

    def _find(self, start: torch.Tensor) -> None:
        """Search by descents and jumps; places where lines are wrong may be left."""
        if self.finds_section:
            start, self.moves_section = with_section_found(self.coarse, start, moves=self.moves_section)
        if self.others is not None and len(self.others):
            start = exchanged(self.coarse, start, self.others).lines
        # Losses at few and at many pixels do not compare: what is best at few is some micrometres off at many.
        if self.jumps:
            coarse, _ = self._searched(self.coarse, start)
            self.is_in_vain = self._is_in_vain(coarse)
            if self.is_in_vain:
                return
            self.fine.correct_at(self.fine.model.heights(coarse.lines))
            found = self.fine.descend(coarse.lines, self.iterations // 2, with_section=self.moves_section)
            start = found.lines
            if self.moves_section:
                start = with_other_family(self.fine, start, self.iterations // 2)
                start = with_caps(self.fine, start, self.iterations // 2)
                start = with_cut_bells(self.fine, start, self.iterations // 2)
            self.lines = start if self.answer is None else pruned(self.fine, start).lines
        else:
            self.fine.correct_at(self.fine.model.heights(start))
            self.lines = self.fine.descend(start, self.iterations, with_section=self.moves_section).lines
        for _ in range(FINE_ROUNDS if self.jumps and self.view is not None else 0):
            if self._is_solved():
                self._join()
                self._leave_faint()
                return
            # What is left is looked at line by line now, and a lattice's error may look like one.
            self.fine.correct_at(self.fine.model.heights(self.lines))
            _, has_gained = self._searched(self.fine, self.lines, rounds=1)
            if not has_gained:
                break
        self._finish()

    def _is_in_vain(self, found: Fitted) -> bool:
        """Whether lines leave more on few pixels than the network's relief, or not much less, and others would do."""
        if self.answer is None:
            return False
        of_relief = self.coarse.loss(self.answer.relief_m)
        if found.loss > of_relief:
            return True
        return self.gives_way is not None and found.loss > DOING_WELL * of_relief and self.gives_way()

    def _is_solved(self) -> bool:
        """Whether lines leave nothing but noise, after a descent on all pixels; far from that it would be wasted."""
        assert self.view is not None
        if not self.view.is_near(self.lines):
            return False
        self._finish()
        return self.view.is_explained(self.lines)

    def _join(self) -> None:
        """Take pieces for one line where the image does not mind: what lies between them shows too little to tell."""
        if self.answer is None or self.view is None or not gaps_between(self.lines):
            return
        model = self.fine.model
        kept = self.lines, model.shape
        found = with_joins(self.fine, self.lines, self.quick)
        if len(found.lines) == len(self.lines):
            return
        self.lines = found.lines
        self._finish()
        if not self.view.is_explained(self.lines):
            self.lines, model.shape = kept

    def _leave_faint(self) -> None:
        """Leave lines that hardly rise above the plate where the others tell the image as well without them.

        Two as wide as a line, and next to it, make up for what is wrong of it: each alone cannot go.
        """
        rises = self.lines[:, HEIGHT] > FAINT_M
        if self.answer is None or bool(rises.all()) or not bool(rises.any()):
            return
        fit = self.fine
        kept = self.lines, fit.model.shape
        iterations, moves = self.iterations // 2, self.moves_section
        as_they_are, fit.model.shape = fit.descend(self.lines, iterations, with_section=moves), kept[1]
        found = fit.descend(self.lines[rises], iterations, with_section=moves)
        if found.loss > as_they_are.loss * LINE_FACTOR ** (len(self.lines) - len(found.lines)):
            self.lines, fit.model.shape = kept
            return
        self.lines = found.lines
        self._finish()
        if self.view is not None and not self.view.is_explained(self.lines):
            self.lines, fit.model.shape = kept

    def _settle(self) -> None:
        """Take lines between two drops apart, and move ends that are hidden under other lines."""
        view, moves = self.view, {"with_section": self.moves_section}
        if view is None or not view.is_near(self.lines):
            return
        if not view.is_settled(self.lines):
            self._take(lambda: with_drops_apart(self.fine, self.lines, **moves))
        self._take(lambda: with_each_end(self.fine, self.lines, self.coarse, **moves))

    def _rebuild(self) -> None:
        """Build places anew where lines leave more than noise; what is better is seen at all pixels."""
        view, answer, fit = self.view, self.answer, self.fine
        if view is None or answer is None or not view.is_wrong_in_places(self.lines):
            return
        if not (self.evolves or view.is_near(self.lines)):
            return
        about = answer.relief_m, answer.spread_m, self.quick

        def is_enough(lines: torch.Tensor) -> bool:
            return not view.is_wrong_in_places(lines)

        self._take(lambda: rebuilt(fit, self.lines, *about, is_enough, evolves=self.evolves))

    def _take(self, search: Callable[[], Fitted | None]) -> None:
        """What a search finds, if it is better at all pixels."""
        assert self.view is not None
        model, is_better = self.fine.model, False
        kept, was = (self.lines, model.shape), self.view.left(self.lines)
        try:
            found = search()
            if found is None:
                return
            self.lines = found.lines
            self._finish()
            now = self.view.left(self.lines)
            is_better = was is not None and now is not None and now < was
        finally:
            if not is_better:
                self.lines, model.shape = kept

    def _jumped(self, fit: ImageFit, lines: torch.Tensor, is_first: bool) -> tuple[torch.Tensor, bool]:
        """Lines after jumps, of all of them on more pixels, and whether any jumped."""
        if fit is self.fine and self.answer is not None:
            return jump(fit, lines, quick=self.quick)
        return jump(fit, lines, JUMPING_LINES_FIRST if is_first else JUMPING_LINES_LATER)

    def _finish(self) -> None:
        iterations = min(FINAL_ITERATIONS, self.iterations)
        self.last.correct_at(self.last.model.heights(self.lines))
        self.lines = self.last.descend(self.lines, iterations, with_section=self.moves_section).lines

    def _searched(self, fit: ImageFit, start: torch.Tensor, rounds: int | None = None) -> tuple[Fitted, bool]:
        """After rounds of all there is: few pixels tell which lines there are, for a quarter of the time.

        Returns:
            Lines, and whether the last round was worth another.
        """
        best, has_gained = fit.descend(start, self.iterations), False
        self.lines = best.lines
        for number in range(self.jumps if rounds is None else rounds):
            before = best.loss
            if self.answer is not None:
                best = pruned(fit, best.lines)
                if fit is self.fine:
                    best = with_joins(fit, best.lines, self.quick)
                    best = with_moved_ends(fit, best.lines, self.quick)
                best = grown(fit, best.lines, self.answer.relief_m, self.answer.spread_m, self.answer.most)
                if fit is self.fine:
                    best = grown_in_shadows(fit, best.lines, self.answer.most, self.quick)
                self.lines = best.lines
            moved, has_jumped = self._jumped(fit, best.lines, number == 0 and rounds is None)
            if has_jumped or self.answer is not None:
                found = fit.descend(moved, self.iterations)
                best = found if found.loss < best.loss else best
                self.lines = best.lines
            has_gained = best.loss <= ROUND_FACTOR * before
            if not has_gained:
                break
        return best, has_gained
