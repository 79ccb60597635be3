"""The bench that lines of a known section tell: its numbers and the evenness of the light, found with the lines.

Heights that are free make up for a wrong gap: lower by as much as light goes further, they explain the image alike.
Lines of one section do not: how wide they are and how they bend light at their crown hang together. What an image says
of a bench is found by linearising it about the bench so far,

    E(lines, theta + d) + field = E(lines, theta) + sum_k d_k dE/dtheta_k + E sum_j c_j P_j,

and descending in lines, d and c together; then again about the bench that was found. P_j are the brightness of each
channel and slopes and curvatures of the light over the picture.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence

import numpy as np
import torch

from nets.reconstruct.fibres.bench.bench_and_light import (
    BEND_LIGHT,
    SLANTS,
    Bench,
    field_modes_on,
    seen_on,
    stretched,
)
from nets.reconstruct.fibres.bench.line_posterior import (
    CORRELATED_PX,
    JointCovariance,
    joint_covariance,
    misfit_weight,
)
from nets.reconstruct.fibres.image.descent import Beside
from nets.reconstruct.fibres.image.descent_numbers import by_shape
from nets.reconstruct.fibres.image.image_fit import FINE_PHOTONS_PER_PIXEL, METRIC_PHOTONS_PER_PIXEL, WIDTH, ImageFit
from nets.reconstruct.fibres.image.one_wavelength import of_wavelength
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import VERGENCE, BenchNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices
from warp_caustics.types import FloatArray

TOLD_BY_LINES = (*SLANTS, *BEND_LIGHT)
"""Numbers that lines tell and heights that are free do not: light that comes from aside moves what is high by more than
what is low, and by crowns of one section how high is known."""
FIELD_WIDTH = 0.05
"""Standard deviation of each channel's brightness, and of what light differs by at the rim."""
ROUNDS = 10
"""Benches about which the image is linearised, as long as the misfit falls by LEAST_GAIN."""
MOST_ROUNDS = 12
"""The same as long as it falls by STILL_FALLING: a picture 1.5 px aside halves it in the fifth."""
ITERATIONS = 30
"""Of L-BFGS about each."""
LEAST_GAIN = 1e-3
"""Share by which the misfit must fall to go on: along that valley 5 um of heights are two hundredths of it."""
PARTS = 1.0, 0.5, 0.25
"""Of a step, the first that leaves less: the valley of gap, base and index with heights is bent."""
SETTLING = 5
"""Iterations of L-BFGS with lines alone after a step, before it is judged."""
STILL_FALLING = 0.1
"""The same after so many rounds that most have ended."""


def numbers_of_lines(numbers: BenchNumbers, *, is_smaller: bool = False) -> BenchNumbers:
    """With the numbers that lines tell besides those that heights do.

    Args:
        numbers: that heights tell.
        is_smaller: the picture was found to be too small; else it is not taken for that, since a picture that is
            brought back to its size by a part of a pixel is softer, which lines take for a wrong gap.
    """
    parameters = [
        dataclasses.replace(p, low=0.0) if p.name == VERGENCE and not (is_smaller or numbers.is_picture) else p
        for p in numbers.parameters
    ]
    more = tuple(p for p in numbers.not_told if p.name in TOLD_BY_LINES)
    rest = tuple(p for p in numbers.not_told if p.name not in TOLD_BY_LINES)
    return dataclasses.replace(numbers, parameters=(*parameters, *more), not_told=rest)


class BenchOfLines:
    """Finds bench and lines together.

    Args:
        numbers: what is looked for (:func:`numbers_of_lines`).
        image: as it was measured, at an exposure of 1 and with its channels together.
        model: renders lines.
        few: size of the image for the metric of descents; all else is at all pixels: fewer ones, simulated as such, are
            not quite the means of many, which looks like another bench (gap 30 um, lamp at 8 m).
        camera: that took it.
        with_section: the model's section is found with them.
        report: called after each evaluation with its loss; may raise.
    """

    def __init__(
        self,
        numbers: BenchNumbers,
        image: CausticImage,
        model: LineModel,
        few: int,
        camera: ChannelCamera,
        *,
        with_section: bool = False,
        report: Callable[[float], None] | None = None,
    ):
        self.numbers, self.image, self.model, self.few, self.camera = numbers, image, model, few, camera
        self.with_section, self.report = with_section, report
        self.correlated_px = CORRELATED_PX
        """Pixels that err together, by which what is believed of the bench weighs in a search."""
        scene, pixels = numbers.scene, numbers.scene.image_pixels
        blur = blur_matrices(pixels, camera.blur, model.device) if np.any(camera.blur) else None
        self._model = BenchModel(numbers, pixels, model.device, blur)
        self._field = field_modes_on(scene.n_wavelengths, pixels, torch.device(model.device))
        self._widths = np.array([*(p.prior for p in numbers.parameters), *[FIELD_WIDTH] * len(self._field)])

    @property
    def n_beside(self) -> int:
        """How many numbers of a bench and its light are found beside lines; in covariances they come last."""
        return len(self._widths)

    def fit_on(self, bench: Bench, channel: int | None = None, *, about: torch.Tensor | None = None) -> ImageFit:
        """The misfit on a bench, of all wavelengths or of one.

        Args:
            bench: that light is simulated on.
            channel: of the wavelength; None for all.
            about: lines about which the lattice's own error is taken off, shape [L, 6] [m]; None for none. It would be
                taken for another bench.

        Raises:
            InputError: values that make no bench.
        """
        scene, image = self.numbers.scene_of(bench.values), seen_on(self.image, self.numbers, bench)
        camera = dataclasses.replace(self.camera, size=image.size)
        if channel is not None:
            image, scene = of_wavelength(image, scene, channel)
            camera = camera.of_channel(channel)
        metric = ImageFit(scene, image, self.model, self.few, photons_per_pixel=METRIC_PHOTONS_PER_PIXEL, camera=camera)
        fit = ImageFit(
            scene,
            image,
            self.model,
            scene.image_pixels,
            photons_per_pixel=FINE_PHOTONS_PER_PIXEL,
            report=self.report,
            metric=metric,
            camera=camera,
            width=WIDTH * self._stretched(bench),
        )
        if about is not None:
            fit.correct_at(self.model.heights(about))
        return fit

    def __call__(self, lines: torch.Tensor, bench: Bench) -> tuple[torch.Tensor, Bench]:
        """Lines that explain the image better, shape [L, 6] [m], and the bench on which they do.

        What is left is compared as it is of the image that was measured. Of one without 3 % of stray light more is
        left, noise and all, so that it looked as if there were less: 1.8 % beside a base 30 um thinner, on a plate
        where that left 7 deviations more.
        """
        fit = self.fit_on(bench)
        for done in range(1, MOST_ROUNDS + 1):
            shape, heights = self.model.shape, self.model.heights(lines)
            # What the lattice is off by is that about these lines for all that is compared in a round.
            fit.correct_at(heights)
            loss = fit.loss(heights)
            moved, beside, sigma = self._descended(fit, lines, bench, loss)
            section = self.model.shape
            for part in PARTS:
                trial = self._moved(bench, part * beside, sigma)
                nearer = self.model.clamped(lines + part * (moved - lines))
                self.model.shape = section
                try:
                    on_trial = self.fit_on(trial)
                    on_trial.correct_by(fit.missing)
                    # What lines and bench change together is in no linear image of both.
                    settled = on_trial.descend(nearer, SETTLING, with_section=self.with_section)
                except InputError:
                    continue
                nearer = settled.lines
                found = settled.loss * self._stretched(bench) / self._stretched(trial)
                if found < loss:
                    break
            else:
                self.model.shape = shape
                break
            gain = 1 - found / loss
            lines, bench, fit = nearer, trial, on_trial
            if gain < (LEAST_GAIN if done < ROUNDS else STILL_FALLING):
                break
        return lines, bench

    def on(self, lines: torch.Tensor, bench: Bench) -> tuple[torch.Tensor, Bench]:
        """Lines that explain the image better on a bench, which stays; shape [L, 6] [m]."""
        return self.fit_on(bench, about=lines).descend(lines, ITERATIONS, with_section=self.with_section).lines, bench

    def _descended(
        self, fit: ImageFit, lines: torch.Tensor, bench: Bench, loss: float
    ) -> tuple[torch.Tensor, FloatArray, FloatArray]:
        """Lines after a descent with what is linear beside them, its amplitudes and their deviations [widths]."""
        beside = self._beside(fit, lines, bench, loss)
        found = fit.descend(lines, ITERATIONS, with_section=self.with_section, beside=beside)
        covariance = joint_covariance(fit, found.lines, beside, beside.weight, with_section=self.with_section)
        deviations = np.sqrt(np.maximum(np.diag(covariance.matrix)[-len(beside.modes) :], 0.0))
        return found.lines, found.beside, deviations

    def _beside(self, fit: ImageFit, lines: torch.Tensor, bench: Bench, loss: float) -> Beside:
        """What the image is linear in about a bench."""
        heights = self.model.heights(lines)
        model = self._model.in_size_of(bench.values)
        seen = model.image(heights, bench.values)
        by_numbers = model.by_numbers(heights, bench.values, seen)
        widths = torch.as_tensor(self._widths, dtype=torch.float32, device=seen.device)
        modes = torch.cat([by_numbers, self._field * seen]) * widths[:, None, None, None]
        count = len(self.numbers.parameters)
        at = np.array([bench.values[name] for name in self.numbers.names])
        told = np.array([self.numbers.before[name] for name in self.numbers.names])
        before = np.concatenate([(told - at) / self._widths[:count], -bench.field / self._widths[count:]])
        return Beside(modes, before, misfit_weight(fit, loss, self.correlated_px))

    def evidence(self, lines: torch.Tensor, bench: Bench, some: Sequence[Collection[str]]) -> list[float]:
        """For another bench: what that, and lines there, would take off the misfit, in squares of deviations.

        Twice Newton's decrement, in the units of :func:`~nets.reconstruct.fibres.bench.line_posterior.misfit_weight`:
        the score test (Rao 1948), which asks for no descent.

        Args:
            lines: that explain the image on a bench, or nearly, shape [L, 6] [m].
            bench: that.
            some: sets of numbers; the others of these stay where they are.
        """
        fit = self.fit_on(bench, about=lines)
        if self.model.device.type == "cuda":
            # Few pixels promise up to six times more than all of them keep; on a CPU those take half a minute.
            fit.metric = fit
        heights, derivatives = self.model.with_jacobian(lines)
        beside = self._beside(fit, lines, bench, fit.loss(heights))
        covariance = joint_covariance(fit, lines, beside, beside.weight, with_section=self.with_section)
        if covariance.places:
            derivatives = torch.cat([derivatives, by_shape(self.model, lines, covariance.places)])
        _, by_height, by_beside = fit.with_gradient(heights, beside, np.zeros(len(beside.modes)))
        by_lines = (derivatives.flatten(1) @ by_height.reshape(-1)).double().cpu().numpy()
        gradient = np.append(by_lines, by_beside)
        information, first = np.linalg.inv(covariance.matrix), len(by_lines)
        found = []
        for names in some:
            free = np.array([name in names for name in self.numbers.names], bool)
            kept = np.concatenate([np.full(first, True), free, np.full(len(by_beside) - len(free), True)])
            step = np.linalg.solve(information[np.ix_(kept, kept)], gradient[kept])
            found.append(float(gradient[kept] @ step) / beside.weight**2)
        return found

    def covariance(self, lines: torch.Tensor, bench: Bench) -> JointCovariance:
        """Of lines and bench together about where they were found; see :func:`joint_covariance`.

        Args:
            lines: shape [L, 6] [m].
            bench: on which they were found.
        """
        fit = self.fit_on(bench, about=lines)
        beside = self._beside(fit, lines, bench, fit.loss(self.model.heights(lines)))
        return joint_covariance(fit, lines, beside, beside.weight, with_section=self.with_section)

    def with_sigma(self, bench: Bench, covariance: JointCovariance) -> Bench:
        """A bench that knows how well it is known.

        Args:
            bench: where it was found.
            covariance: of :meth:`covariance`.
        """
        deviations = np.sqrt(np.maximum(np.diag(covariance.matrix)[-len(self._widths) :], 0.0)) * self._widths
        found = dict(zip(self.numbers.names, deviations.tolist(), strict=False))
        return dataclasses.replace(bench, sigma={**bench.sigma, **found})

    def _stretched(self, bench: Bench) -> float:
        """By how much what is left is larger on a bench than it is of the measured image, in the mean of channels."""
        return float(stretched(self.numbers, bench).mean())

    def _moved(self, bench: Bench, beside: FloatArray, sigma: FloatArray) -> Bench:
        names = self.numbers.names
        deviations = dict(zip(names, (sigma * self._widths)[: len(names)].tolist(), strict=True))
        moved = bench.moved(self.numbers, beside * self._widths)
        return dataclasses.replace(moved, sigma={**bench.sigma, **deviations})
