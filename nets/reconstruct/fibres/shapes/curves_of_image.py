"""Lines with corners and curves of one image, where straight ones do not tell it.

Ridges of the relief that ``direct`` found are followed, through crossings, and told by few nodes each; these are fitted
to the image. What they leave is shown to the network, which sees more in the rest, and they are found anew.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.bench.camera_of_lines import CLEAR_GAIN, SPREAD_ROUNDS, gain_of_spread, spread_asked
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.descent_numbers import reshaped_widths
from nets.reconstruct.fibres.image.discrepancy import FAR_OF_NOISE
from nets.reconstruct.fibres.image.image_fit import FINE_PHOTONS_PER_PIXEL, ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.fibres.search.line_search import Answer
from nets.reconstruct.fibres.search.starting_lines import MANY, WELL_TOLD
from nets.reconstruct.fibres.shapes.curves_fit import curved_heights, fitted_to_image
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.smooth_chains import Track
from warp_caustics.prints.vectorise import unexplained
from warp_caustics.prints.vectorise.curved import (
    curved_lines_of_relief,
    curved_unexplained,
    refitted_curves,
    straight_lines,
)
from warp_caustics.prints.vectorise.curved_ends import meetings
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.prints.vectorise.rings import with_rings
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

FEW_ITERATIONS, ALL_ITERATIONS = 60, 25
"""Of L-BFGS at few pixels, and at all."""
LOOKS = 2
"""How often a network is shown what lines leave."""
LOOK_FACTOR = 0.98
"""By which the misfit must fall for lines after a look, as rings, or begun with straight ones, to be taken."""
RING_ROUNDS = 3
"""In which pieces of rings become rings, at most: what was found in place of one shows when the others are."""
SHORT_M, SHORT_LINES = 5e-3, 3
"""Open lines shorter than this, and how many of them, are left out by turns: such a one makes up for what is wrong of
another. Beside a narrow ring told 0.02 mm off a piece 1.2 mm long and 0.4 mm high did, 8.5 um of a plate."""
FEWER_FACTOR = 1.01
"""By which the misfit may rise then: of lines that explain an image alike the fewest are the plate's."""
IN_VAIN = 3.0
"""Times the misfit of the relief that lines were found in, from which on they are given up at few pixels."""
BETTER = 0.9
"""Share of the discrepancy of that relief that lines must leave, at most,"""
AT_NOISE = 1.5
"""or of this, where it leaves less: true reliefs of nine own plates leave 0.88 to 0.95."""
MEETING_SHARE = 0.2
"""Of straight lines that end where another one begins, which is about as wide and high."""
ENOUGH = 2.0
"""Times what a plate of straight lines leaves."""
CURVED_FACTOR = 0.85
"""Share of what straight lines leave of a relief that curved ones leave where they are the plate's: 0.55 to 0.80 of
four own plates with curves, meanders and text, 1.02 and 1.07 of two with waves along straight lines."""
OTHER_SECTIONS = (Shape(0.5), Shape(1.0, 1.0), Shape(0.5, 1.0), Shape(1.6), Shape(8.0))
"""That are tried beside the cosine."""
OTHER_FACTOR = 0.96
"""Another one must lower the misfit by this factor."""


@dataclass(frozen=True, eq=False)
class CurvesOnImage:
    """Lines with corners and curves that were taken.

    Attributes:
        lines: all.
        heights: their relief [m], shape [n, n], float32, on the model's device.
    """

    lines: CurvedLines
    heights: torch.Tensor

    @property
    def record(self) -> dict[str, int]:
        """For a result's counters."""
        return {
            "lines": len(self.lines),
            "nodes": sum(len(track.nodes_m) for track in self.lines.tracks),
            "corners": sum(len(track.corners) for track in self.lines.tracks),
            "closed": sum(track.is_closed for track in self.lines.tracks),
        }


class CurvesOfImage:
    """A search for them.

    Args:
        method: whose image it is.
        view: the image on its bench.
        model: of straight lines; its section is that of these.
        report: called after each evaluation with its loss; may raise.
        network: that can be shown what lines leave; None for none.
    """

    def __init__(
        self,
        method: FibresOf,
        view: LinesView,
        model: LineModel,
        report: Callable[[float], None],
        network: Direct | None = None,
    ):
        self.view, self.model, self.report, self.network = view, model, report, network
        self.chains = ChainModel(model)
        self.most = method.options.most_lines
        self.finds_section = method.finds_section
        self.noise = view.noise
        image, scene = view.image, view.scene
        one = OneWavelength.clearest(image, scene, view.camera)
        self.few = one.fit(model, usual_pixels(scene), report=report)
        self.moves_section = False

    def _fit(self, scene: Scene, image: CausticImage, pixels: int, camera: ChannelCamera) -> ImageFit:
        about = scene, image, self.model, pixels
        return ImageFit(*about, photons_per_pixel=FINE_PHOTONS_PER_PIXEL, report=self.report, camera=camera)

    def __call__(self, found: Reconstruction) -> CurvesOnImage | None:
        """Lines that explain the image better than a relief does, in whose ridges they are looked for; None for none.

        Raises:
            KeyboardInterrupt: the time is over.
        """
        begun = self.begun(found)
        return None if begun is None else self.ended(begun, found)

    def said(self, found: Reconstruction) -> Answer:
        """A result's relief at the samples of the model, and how far it may be wrong."""
        relief = self._on_grid(found.heights_m)
        if found.uncertainty_m is None:
            return Answer(relief, torch.zeros_like(relief), self.most)
        return Answer(relief, self._on_grid(found.uncertainty_m) / DIRECT_CALIBRATION.scale, self.most)

    def begun(self, found: Reconstruction) -> tuple[CurvedLines, float] | None:
        """Lines in the ridges of a relief, after a descent at few pixels, and their misfit; None where that is in vain.

        Raises:
            KeyboardInterrupt: the time is over.
        """
        said = self.said(found)
        before = self.few.loss(said.relief_m.to(self.model.device))
        begun = self._begun(said.relief_m, said.spread_m)
        return None if begun is None or begun[1] > IN_VAIN * before else begun

    def ended(
        self,
        begun: tuple[CurvedLines, float],
        found: Reconstruction,
        judged_by: tuple[Reconstruction, LinesView] | None = None,
    ) -> CurvesOnImage | None:
        """Lines that were begun, at all pixels and through their lens; None where they do not explain the image better.

        Args:
            begun: of :meth:`begun`.
            found: the result in whose ridges they were looked for.
            judged_by: what they have to explain the image better than, and the bench it is on, where that is another.

        Raises:
            KeyboardInterrupt: the time is over.
        """
        lines, loss = begun
        for _ in range(LOOKS):
            if self._is_settled(lines):
                break
            again = self._seen_again(lines)
            if again is None:
                break
            again = self._round(*again)
            if again[1] > LOOK_FACTOR * loss:
                break
            lines, loss = again
        fine = self._fit(self.view.scene, self.view.image, self.view.scene.image_pixels, self.view.camera)
        fine.correct_at(curved_heights(self.chains, lines))
        lines, _ = fitted_to_image(fine, lines, ALL_ITERATIONS, self.noise, with_section=self.moves_section)
        before, told = judged_by or (found, self.view)
        lines = self._with_spread(lines)
        are_lines = found.fibres_m is not None
        relief = self._on_grid(before.heights_m).double().numpy()
        if not self._is_better(self._relief(lines), relief, told, are_lines=are_lines):
            return None
        return CurvesOnImage(lines, curved_heights(self.chains, lines))

    def _starts(self, relief: torch.Tensor, spread: torch.Tensor) -> Iterator[CurvedLines | None]:
        """Where lines may begin; None with ridges."""
        yield None
        yield straight_lines(self.model, relief, spread, self.most)

    def _begun(self, relief: torch.Tensor, spread: torch.Tensor) -> tuple[CurvedLines, float] | None:
        """Lines that tell a relief, begun with its ridges and with straight lines, after a descent, and their misfit.

        The latter where they explain the image better; the model has their section. None where there are none.
        """
        given, best = self.model.shape, None
        for start in self._starts(relief, spread):
            self.model.shape, self.moves_section = given, False
            lines = curved_lines_of_relief(self.model, relief, spread, most=self.most, start=start)
            if not len(lines):
                continue
            if self.finds_section:
                lines = self._with_section(lines, relief, spread)
            found = self._round(*self._fitted(lines))
            if best is None or found[1] < LOOK_FACTOR * best[0][1]:
                best = found, self.model.shape, self.moves_section
                if self._is_settled(found[0]):
                    break
        if best is None:
            return None
        found, self.model.shape, self.moves_section = best
        return found

    def _with_spread(self, lines: CurvedLines) -> CurvedLines:
        """Lines with the point spread that they tell of the camera, where that leaves less of the image."""
        left = self.view.discrepancy(self._relief(lines))
        if left is None or left > FAR_OF_NOISE:
            return lines
        enough = CLEAR_GAIN * left if self.view.camera.blurs else 0.0
        told = lines, self.view, self.model.shape
        for _ in range(SPREAD_ROUNDS):
            camera = spread_asked(self.view, self._relief(lines))
            if camera is None:
                break
            before, view, shape = lines, self.view, self.model.shape
            fine = self._fit(view.scene, view.image, view.scene.image_pixels, camera)
            fine.correct_at(curved_heights(self.chains, lines))
            lines, _ = fitted_to_image(fine, lines, ALL_ITERATIONS, self.noise, with_section=self.moves_section)
            self.view = LinesView(view.resimulation.blurred_by(camera), self.model)
            now = self.view.discrepancy(self._relief(lines))
            if now is None or now > gain_of_spread(view) * left:
                lines, self.view, self.model.shape = before, view, shape
                break
            left = now
        if left > enough and not self._is_explained(lines):
            lines, self.view, self.model.shape = told
        return lines

    def _is_better(self, found: FloatArray, before: FloatArray, told: LinesView, *, are_lines: bool = False) -> bool:
        """Whether a relief of lines is taken for one that was found without them [m], shape [n, n] each.

        That one is judged through the camera that lines tell, and ``told``, the one it was found through. ``are_lines``
        if that is one of straight lines, which have few numbers, too.
        """
        was, left = told.discrepancy(before), self.view.discrepancy(found)
        if was is not None and told is not self.view:
            was = min(was, self.view.discrepancy(before) or was)
        if self.view.image.noise_std is None or was is None or left is None:
            simulated = self.view.resimulation
            return simulated(found).residual < simulated(before).residual
        # Free heights may leave less than noise: few numbers that leave no more than it tell more of the plate.
        return left < BETTER * (was if are_lines else max(was, AT_NOISE))

    def _on_grid(self, values_m: FloatArray) -> torch.Tensor:
        """Values on the user's grid, at the samples of the model, shape [n, n] [m], float32."""
        values = torch.as_tensor(values_m, dtype=torch.float32)
        if len(values) == self.model.n:
            return values
        size = (self.model.n, self.model.n)
        return torch.nn.functional.interpolate(values[None, None], size, mode="bilinear", antialias=True)[0, 0]

    def _fitted(self, lines: CurvedLines) -> tuple[CurvedLines, float]:
        """Lines after a descent at few pixels, and their misfit."""
        return fitted_to_image(self.few, lines, FEW_ITERATIONS, self.noise, with_section=self.moves_section)

    def _round(self, lines: CurvedLines, loss: float) -> tuple[CurvedLines, float]:
        """Lines with rings in place of those that are nearly ones, where the image says so, and their misfit."""
        for _ in range(RING_ROUNDS):
            if self._is_settled(lines):
                break
            tried = [self._fitted(rings) for rings in with_rings(lines, self.view.scene.plate_size_m)]
            best = min(tried, key=lambda each: each[1], default=(lines, loss))
            if best[1] > LOOK_FACTOR * loss:
                break
            lines, loss = best
        return self._without_short(lines, loss)

    def _without_short(self, lines: CurvedLines, loss: float) -> tuple[CurvedLines, float]:
        """Lines without those short ones that others tell the image as well without, and their misfit."""
        short = [k for k, track in enumerate(lines.tracks) if not track.is_closed and track.length_m < SHORT_M]
        short = sorted(short, key=lambda k: lines.tracks[k].length_m)[:SHORT_LINES]
        if not short or len(short) == len(lines) or self._is_settled(lines):
            return lines, loss
        for k in reversed(sorted(short)):
            found = self._fitted(lines.kept([m for m in range(len(lines)) if m != k]))
            if found[1] < FEWER_FACTOR * loss:
                lines, loss = found
        return lines, loss

    def _relief(self, lines: CurvedLines) -> FloatArray:
        return self.view.glass(curved_heights(self.chains, lines))

    def _is_settled(self, lines: CurvedLines) -> bool:
        return self.view.is_relief_settled(self._relief(lines))

    def _is_explained(self, lines: CurvedLines) -> bool:
        return self.view.is_relief_explained(self._relief(lines))

    def _seen_again(self, lines: CurvedLines) -> tuple[CurvedLines, float] | None:
        """Lines in what a network says that is shown what these leave, and their misfit; None where it says nothing."""
        said = None if self.network is None else self.network.looked_again(self.view.resimulation, self._relief(lines))
        if said is None:
            return None
        relief, spread = (values.cpu() for values in said)
        tried = []
        for start in (None, lines):
            found = curved_lines_of_relief(self.model, relief, spread, most=self.most, start=start)
            if len(found):
                tried.append(self._fitted(found))
        return min(tried, key=lambda each: each[1]) if tried else None

    def _with_section(self, lines: CurvedLines, relief: torch.Tensor, spread: torch.Tensor) -> CurvedLines:
        """Lines of the section that tells the relief best; the model has it afterwards."""
        model, given = self.model, self.model.shape
        best, left = refitted_curves(model, lines, relief, spread)
        least, shape = OTHER_FACTOR * left, given
        for other in OTHER_SECTIONS:
            model.shape = given.with_section(other)
            widened = CurvedLines(lines.tracks, lines.sizes * [reshaped_widths(given, model.shape), 1.0])
            found, left = refitted_curves(model, widened, relief, spread)
            if left < least:
                best, least, shape = found, left, model.shape
        model.shape, self.moves_section = shape, shape != given
        return best


class Curved:
    """Whether lines with corners and curves tell a relief clearly better than straight ones do, nodes counted.

    Straight lines are looked for on an image for a minute and more on a CPU, in vain where they are none. Asked where
    some of few lines end where others begin, which a crowd does by chance; or much is left, and straight lines do not
    do well on the image either: it takes a CPU longer than to see that.

    Args:
        model: of straight lines, with their section.
        lines: straight ones, shape [L, 6] [m].
        relief_m: that both tell, shape [n, n] [m].
        spread_m: how far it may be wrong, shape [n, n] [m].

    Attributes:
        may_be: whether it is worth while to ask.
        meet: whether some lines end where others begin.
        are_rather: whether lines were asked, and are.
    """

    def __init__(self, model: LineModel, lines: torch.Tensor, relief_m: torch.Tensor, spread_m: torch.Tensor):
        self._model, self._shape, self._relief, self._spread = model, model.shape, relief_m, spread_m
        self._straight = unexplained(model, lines, relief_m, spread_m)
        much = ENOUGH * WELL_TOLD * relief_m.numel()
        self.meet = share_that_meet(lines) >= MEETING_SHARE
        self.may_be = len(lines) <= MANY and (self.meet or self._straight >= much)
        self.are_rather = False

    def __call__(self) -> bool:
        """Whether they are; the model keeps its section."""
        if not self.may_be:
            return False
        model, shape = self._model, self._model.shape
        model.shape = self._shape
        try:
            curved = curved_lines_of_relief(model, self._relief, self._spread)
            left = curved_unexplained(model, curved, self._relief, self._spread)
        finally:
            model.shape = shape
        self.are_rather = left < CURVED_FACTOR * self._straight
        return self.are_rather


def are_crowd(lines: torch.Tensor) -> bool:
    """Whether straight lines of a relief, shape [L, 6] [m], are many that end where no other begins.

    In a crowd ridges are followed for minutes, in vain; rings, told by two dozen straight lines, are none.
    """
    return len(lines) > MANY and share_that_meet(lines) < MEETING_SHARE


def share_that_meet(lines: torch.Tensor) -> float:
    """How many pairs of straight lines, shape [L, 6] [m], end in one place and are about as wide and high, of L."""
    rows = lines.double().numpy()
    tracks = [Track(row[:4].reshape(2, 2)) for row in rows]
    return len(meetings(CurvedLines(tracks, rows[:, 4:]))) / max(len(rows), 1)
