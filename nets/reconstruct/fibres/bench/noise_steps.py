r"""Steps to where lines, bench, light and lens together leave least, by nothing but the noise of an image.

Gauss-Newton (Nocedal & Wright, Numerical Optimization, section 10.3) of all that was found,

$$\sum_i \rho(W (y(\theta) - y) / s)_i + \sum_k ((\theta_k - told_k) / w_k)^2, \qquad
\rho(r) = 2 c^2 (\sqrt{1 + r^2 / c^2} - 1),$$

of deviations that :mod:`~nets.reconstruct.fibres.bench.noise_misfit` tells. Pictures are those through the camera's
point spread, without the error of the fits' lattice. So an image tells of a bench what its noise lets it, where a
search, whose lines are not yet right, has a hundred pixels err together: five lines left as told, 6.8 um off, end
1.1 um off.

What pictures are simulated wrong by, e, is no noise: it changes with every number, and of two benches either leaves up
to 2 |W e / s| less by it. So pictures that are compared with the image are on three times as many fine pixels along the
image as others; those on two times as many tell how much they are off by, and to gain less is no reason for a step.

Cost: two pictures for each number of lines, section and bench, up to eight times. What is left bends along a valley
where its derivatives hardly change, so steps go on by the same ones and a new picture each (the chord method; Kelley,
Iterative Methods for Linear and Nonlinear Equations, section 5.4). A GPU takes 0.5 to 5 s for the derivatives of 5 to
28 lines; two cores half a minute for five, of which they trace no light but that a line's change touches, once for the
bench (:mod:`~nets.reconstruct.fibres.bench.noise_bench`).
"""

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Protocol

import numpy as np
import torch

from nets.reconstruct.fibres.bench import lens_numbers
from nets.reconstruct.fibres.bench.bench_and_light import Bench, ShownLight, field_modes_on
from nets.reconstruct.fibres.bench.bench_of_lines import FIELD_WIDTH
from nets.reconstruct.fibres.bench.bounded_least import BoundedLeast
from nets.reconstruct.fibres.bench.gap_fits import pulled_aside
from nets.reconstruct.fibres.bench.line_posterior import CORRELATED_PX, SHAPE_WIDTHS
from nets.reconstruct.fibres.bench.noise_bench import ByBench
from nets.reconstruct.fibres.bench.noise_effort import EFFORTS
from nets.reconstruct.fibres.bench.noise_misfit import NoiseMisfit
from nets.reconstruct.fibres.bench.noise_place import Nearer, Place, Ways
from nets.reconstruct.fibres.bench.noise_slopes import Slopes
from nets.reconstruct.fibres.bench.run_state import LinesRun
from nets.reconstruct.fibres.image.descent_numbers import DescentNumbers
from nets.reconstruct.fibres.image.image_fit import DIFFERENCE_M, FINE_PHOTONS_PER_PIXEL
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE
from warp_caustics.prints.model import HEIGHT, WIDTH
from warp_caustics.reconstruct.pyramid import simulator_at
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.reconstruct.seen_camera.point_spread import fine_pixels
from warp_caustics.types import FloatArray

CONVERGED = 1.0
"""Squared deviations that steps must gain for derivatives to be taken again: 1 is 0.2 um along the valley of gap and
heights."""
CHORDS, CHORD_GAIN = 4, 0.3
"""Further steps by the same derivatives, and what each must promise, and the one before have gained."""
PARTS, CHORD_PARTS = (1.0, 0.5, 0.25, 0.1), (1.0, 0.5)
"""Of a step, the first that leaves less; new derivatives lead further than small parts of a step by old ones."""
NOISE_ROUNDS = 2
"""In which noise and lens are asked: what is left by lines that are not yet right is in the first one."""
STEP_M = 1e-4
"""By which a line's number may move in a step at the price of one squared deviation: ends that hide are not told."""
NOTED = 6
"""Numbers between two times that people are told."""
MOST_COMPARED_PIXELS = 8192
"""Fine pixels along an image of pictures that are compared with it; but at least twice as many as usual."""
LINE_STEP_M = 3 * DIFFERENCE_M
"""Differences of heights by which derivatives are taken. Light that moves by less than a fine pixel changes what these
fold back: beside sixteen lines by the height of a line 6 to 13 % of the derivative. Of differences several times as
large that is 3 to 9 %."""
SURE = 5.0
"""Times 2 |W e / s| that steps must gain: a lamp's disc and channels that mix are simulated wrong, too. Of nine own
plates seven that asked for 7 to 100 times it came nearer, two that asked for 5 and 9 did not."""
HINTED = 0.25
"""Of what steps must gain, that a bench must promise beside lines that move alike for all numbers to be asked. That is
a quarter to four fifths of what these promise of gaps and bases other by 10 to 30 um; of benches as told it was 0.04 to
0.15 of what steps must gain, on six own plates."""


@dataclasses.dataclass
class Told:
    """What an image told, in squared deviations of its noise.

    Attributes:
        asked: that lines and bench would gain beside light and lens, to second order.
        least: that steps must gain to be no error of simulation.
        gained: by all steps.
        steps: that were made.
    """

    asked: float = 0.0
    least: float = 0.0
    gained: float = 0.0
    steps: int = 0

    @property
    def is_more(self) -> bool:
        """Whether steps gained more than simulations are wrong by."""
        return self.steps > 0 and self.gained > self.least


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    def note(self, loss: float) -> None:
        """Told after each evaluation; may raise."""

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on a bench, with a camera or the one that the lines tell there."""


class NoiseSteps:
    """Steps from lines that leave nothing but noise.

    Args:
        run: whose lines, on their bench and through their camera.

    Attributes:
        effort: of the run's device.
        told: what the image told so far.
        information: of all numbers about the last place, beliefs and all, shape [N, N]; None before the first.

    Raises:
        ValueError: the noise of the image is unknown.
    """

    def __init__(self, run: Run):
        self.run, self.model, self.numbers = run, run.model, run.numbers
        self._pixels, view = self.numbers.scene.image_pixels, run.view
        self.device = view.discrepancy.whole.irradiance.device
        self.effort = EFFORTS[self.device.type]
        self._finer = max(2, min(self.effort.finer, MOST_COMPARED_PIXELS // fine_pixels(self._pixels)))
        self._misfit = NoiseMisfit(view, ShownLight.by(self.numbers, run.bench, self.device))
        channels = self.numbers.scene.n_wavelengths
        self._field = field_modes_on(channels, self._pixels, self.device).to(self._misfit.measured)
        self._widths = np.array([*(p.prior for p in self.numbers.parameters), *[FIELD_WIDTH] * len(self._field)])
        self._before = np.array([self.numbers.before[name] for name in self.numbers.names])
        self.told = Told()
        self.information: FloatArray | None = None
        self._lost: torch.Tensor | None = None
        self._by_bench = ByBench(self.effort.renews_bench)
        self._begun: tuple[Place, torch.Tensor] | None = None

    @property
    def is_within_reach(self) -> bool:
        """Whether an image of so many pixels takes this device no longer than people wait."""
        return self._pixels <= self.effort.most_pixels

    def __call__(self) -> Place:
        """Where lines, bench, light and lens leave less, or as they are; the model keeps its section."""
        shape = self.model.shape
        here, picture = self._begin()
        try:
            for count in range(self.effort.rounds):
                if count < NOISE_ROUNDS:
                    here, picture = self._with_lens(here, picture)
                    self._ask_noise(picture, here.bench)
                slopes = self._slopes(here, picture)
                linear = self._about(here, picture, self._ways(here), slopes)
                if not count:
                    self.told.asked, self.told.least = self._asked(linear), self._least(here, picture)
                    if self.told.asked <= self.told.least:
                        break
                here, picture, gain = self._nearer_by(here, picture, slopes, linear)
                if gain < CONVERGED:
                    break
        finally:
            self.model.shape = shape
        return here

    def is_hinted(self) -> bool:
        """Whether the bench promises a good part of what steps must gain, if all lines move alike.

        In two pictures for each number of the bench, and four for the lines, however many there are.
        """
        here, picture = self._begin()
        self._ask_noise(picture, here.bench)
        alike = self._asked(self._linear_alike(here, picture))
        return alike > HINTED * self._least(here, picture)

    def _begin(self) -> tuple[Place, torch.Tensor]:
        """The run's own place, and what it shows; kept for the second question."""
        if self._begun is None:
            here = Place(self.run.lines, self.model.shape, self.run.bench, self.run.view.camera)
            self._follow(here)
            self._begun = here, self._at(here)
        return self._begun

    def shown(
        self, heights: torch.Tensor, bench: Bench, camera: ChannelCamera, finer: int = 1, *, follows_light: bool = True
    ) -> torch.Tensor:
        """What a relief [m], shape [n, n], shows on a bench as it would be measured, shape [n_w, m, m]."""
        lit = ShownLight.by(self.numbers, bench, self.device)
        picture = self._picture(bench, camera, finer, follows_light=follows_light)
        return picture(heights.float()).double() * lit.factor + lit.added

    def _at(self, place: Place) -> torch.Tensor:
        return self._compared(place, self._finer)

    def _compared(self, place: Place, finer: int) -> torch.Tensor:
        """What a place shows, for comparison with the image."""
        self.model.shape = place.shape
        heights, follows = self.model.heights(place.lines), self.effort.follows_light
        shown = self.shown(heights, place.bench, place.camera, finer, follows_light=follows)
        return shown if self._lost is None else shown + self._lost

    def _follow(self, here: Place) -> None:
        """What light that meets the relief again makes of pictures that do not follow it: steps hardly move that."""
        if self.effort.follows_light or self._lost is not None or self.numbers.scene.second_hits != "lost":
            return
        self.model.shape = here.shape
        about = self.model.heights(here.lines), here.bench, here.camera
        self._lost = self.shown(*about) - self.shown(*about, follows_light=False)

    def _picture(
        self, bench: Bench, camera: ChannelCamera, finer: int = 1, *, follows_light: bool = True
    ) -> ExactPicture:
        scene = self.numbers.scene_of(bench.values)
        if not follows_light:
            scene = scene.model_copy(update={"second_hits": "ignored"})
        simulator = simulator_at(scene, self._pixels, self.device, FINE_PHOTONS_PER_PIXEL)
        return ExactPicture(simulator, camera, finer=finer)

    def _ask_noise(self, picture: torch.Tensor, bench: Bench) -> None:
        self._misfit.ask_noise(picture, ShownLight.by(self.numbers, bench, self.device))

    def _with_lens(self, here: Place, picture: torch.Tensor) -> tuple[Place, torch.Tensor]:
        """With the lens that lines tell where they are, whose form steps do not change, if that leaves less."""
        if here.camera.spread is None:
            return here, picture
        view = self.run.on(here.bench, here.camera)
        there = here._replace(camera=view.resimulation.with_spread(view.relief(here.lines)))
        if there.camera.spread is None or not there.camera.spread.is_plausible:
            return here, picture
        shown = self._at(there)
        return (there, shown) if self._misfit.left(shown) < self._misfit.left(picture) else (here, picture)

    def _believed(self, bench: Bench) -> FloatArray:
        """Deviations of a bench and its light from what was told, shape [K]."""
        values = np.array([bench.values[name] for name in self.numbers.names])
        apart: FloatArray = np.concatenate([values - self._before, bench.field]) / self._widths
        return apart

    def _least(self, here: Place, picture: torch.Tensor) -> float:
        """Squared deviations by which either of two places may leave less for no reason."""
        coarser = self._compared(here, self._finer - 1)
        of_size = CORRELATED_PX * pulled_aside(self.run) ** 2
        return SURE * 2 * float(self._misfit.deviations(coarser - picture).norm()) + of_size

    def _asked(self, linear: BoundedLeast) -> float:
        """What lines and bench would gain beside light and lens."""
        others = len(linear.at) + len(self.numbers.parameters)  # light and lens come last
        return linear.gain(linear.step()) - linear.gain(linear.step(others))

    def _ways(self, here: Place) -> Ways:
        model = self.model
        model.shape = here.shape
        numbers = DescentNumbers(model, len(here.lines), self.run.moves_section)
        at = numbers.of(here.lines, here.shape)
        own = np.full(numbers.size, STEP_M)
        own[6 * len(here.lines) :] = [SHAPE_WIDTHS[place] for place in numbers.of_shape]
        least, most = numbers.ends(at)
        return Ways(at, own, least - at, most - at)

    def _slopes(self, here: Place, picture: torch.Tensor) -> Slopes:
        model = self.model
        model.shape = here.shape
        heights, by_line = model.with_jacobian(here.lines)
        numbers = DescentNumbers(model, len(here.lines), self.run.moves_section)
        return self._slopes_by(here, picture, heights, numbers.derivatives(here.lines, by_line))

    def _linear_alike(self, here: Place, picture: torch.Tensor) -> BoundedLeast:
        """As if all lines were higher by the same share, or wider."""
        self.model.shape = here.shape
        heights, by_line = self.model.with_jacobian(here.lines)
        by_line = by_line.reshape(len(here.lines), -1, *heights.shape)
        share = here.lines.to(by_line)
        alike = torch.stack([torch.einsum("l,lij->ij", share[:, k], by_line[:, k]) for k in (HEIGHT, WIDTH)])
        ways = Ways(np.zeros(2), np.ones(2), np.full(2, -np.inf), np.full(2, np.inf))
        return self._about(here, picture, ways, self._slopes_by(here, picture, heights, alike))

    def _slopes_by(self, here: Place, picture: torch.Tensor, heights: torch.Tensor, by_number: torch.Tensor) -> Slopes:
        """By ways in which a relief [m] moves, shape [P, n, n], and by bench, light and lens."""
        misfit = self._misfit.as_of_fits(picture)

        def rows() -> Iterator[torch.Tensor]:
            for number, change in enumerate(self._by_all(here, heights, by_number, picture)):
                yield self._misfit.deviations(change)
                if number % NOTED == 0:
                    self.run.note(misfit)

        size = len(by_number) + len(self._widths) + lens_numbers.count_of(here.camera)
        return Slopes.of(rows(), size, self._misfit.weight(self._misfit.rest(picture)))

    def _about(self, here: Place, picture: torch.Tensor, ways: Ways, slopes: Slopes) -> BoundedLeast:
        """The least of what is left, about a place, of ways in which lines move, and of bench, light and lens."""
        believed, count, size = self._believed(here.bench), len(ways.at), len(slopes.information)
        rest = self._misfit.rest(picture)
        information = slopes.information + np.diag(np.append(ways.own**-2.0, np.ones(size - count)))
        gradient = slopes.gradient(rest, self._misfit.weight(rest))
        gradient[count : count + len(believed)] += believed
        self.information = information
        return BoundedLeast(ways.at, information, gradient, *self._ends(ways, here.bench, size))

    def _nearer_by(self, here: Place, picture: torch.Tensor, slopes: Slopes, linear: BoundedLeast) -> Nearer:
        """Where steps by the same derivatives lead, what it shows and leaves less, 0 where there is no such place."""
        gained = 0.0
        for count in range(1 + CHORDS):
            there = self._nearer(here, linear, picture, CHORD_PARTS if count else PARTS)
            if there is None:
                break
            here, picture, gain = there
            self.told.gained, self.told.steps, gained = self.told.gained + gain, self.told.steps + 1, gained + gain
            linear = self._about(here, picture, self._ways(here), slopes)
            if min(gain, linear.gain(linear.step())) < CHORD_GAIN:
                break
        return Nearer(here, picture, gained)

    def _nearer(
        self, here: Place, linear: BoundedLeast, picture: torch.Tensor, parts: tuple[float, ...] = PARTS
    ) -> Nearer | None:
        """A place that leaves less by a part of a step; None where there is none."""
        believed, count = self._believed(here.bench), len(linear.at)
        was, step = self._misfit.left(picture) + float(believed @ believed), linear.step()
        for part in parts:
            self.model.shape = here.shape
            numbers = DescentNumbers(self.model, len(here.lines), self.run.moves_section)
            lines = numbers.put(linear.at + part * step[:count])
            bench = here.bench.moved(self.numbers, part * step[count : count + len(believed)] * self._widths)
            camera = lens_numbers.moved(here.camera, part * step[count + len(believed) :])
            if camera.spread is not None and not camera.spread.is_plausible:
                continue
            there = Place(lines, self.model.shape, bench, camera)
            try:
                shown = self._at(there)
            except InputError:
                continue
            apart = self._believed(bench)
            gain = was - self._misfit.left(shown) - float(apart @ apart)
            if gain > 0:
                return Nearer(there, shown, gain)
        return None

    def _by_all(
        self, here: Place, heights: torch.Tensor, by_number: torch.Tensor, picture: torch.Tensor
    ) -> Iterator[torch.Tensor]:
        """Derivatives of what is shown: by the lines' numbers, and by bench, light and lens in their widths."""
        bench, camera = here.bench, here.camera
        follows = self.effort.follows_light
        exact = self._picture(bench, camera, follows_light=follows)
        lit = ShownLight.by(self.numbers, bench, self.device)
        for some in by_number.split(self.effort.changes) if len(by_number) else ():
            steps = LINE_STEP_M / some.abs().amax((1, 2)).double().clamp_min(1e-6)[:, None, None]
            low, high = ((heights + side * steps / 2 * some).float() for side in (-1, 1))
            for change, step in zip(exact.change(low, high), steps, strict=True):
                yield change.double() * lit.factor / step
        light = torch.tensor(bench.light(self._pixels), device=self.device)
        by_stray_light = (light - picture) / (1 + bench.values[AMBIENT]) if AMBIENT in self.numbers.names else None
        shown = partial(self.shown, heights, camera=camera, follows_light=follows)
        yield from self._by_bench(self.numbers, bench, self._pixels, shown, by_stray_light)
        for mode in self._field:
            yield FIELD_WIDTH * mode * picture / light
        yield from self._by_lens(here, heights.float(), lit.factor)

    def _by_lens(self, here: Place, heights: torch.Tensor, factor: torch.Tensor) -> Iterator[torch.Tensor]:
        """Derivatives of what is shown by the numbers of a lens, if one is known."""
        if not lens_numbers.count_of(here.camera):
            return
        ends = (lens_numbers.widened(here.camera, 1 + side * lens_numbers.LENS_STEP) for side in (-1, 1))
        cameras = lens_numbers.sharpened(here.camera), *ends
        follows = self.effort.follows_light
        seen = (self._picture(here.bench, each, follows_light=follows)(heights).double() for each in cameras)
        for channel, change in lens_numbers.derivatives(*seen):
            row = torch.zeros_like(factor)
            row[channel] = change * factor[channel]
            yield row

    def _ends(self, ways: Ways, bench: Bench, size: int) -> tuple[FloatArray, FloatArray]:
        """How far numbers may move downwards and upwards, shape [P + K]."""
        lowest, highest, count = np.full(size, -np.inf), np.full(size, np.inf), len(ways.at)
        lowest[:count], highest[:count] = ways.lowest, ways.highest
        for k, p in enumerate(self.numbers.parameters, start=count):
            if p.name == VERGENCE and self.numbers.is_picture:
                # Of a picture of another size that is its size, and the image has been brought back already.
                lowest[k] = highest[k] = 0.0
            else:
                value = bench.values[p.name]
                lowest[k], highest[k] = (p.low - value) / p.prior, (p.high - value) / p.prior
        return np.minimum(lowest, 0.0), np.maximum(highest, 0.0)
