"""The bench that lines of a known section tell: its numbers and the evenness of the light, found with the lines.

Heights that are free make up for a wrong gap: lower by as much as light goes further, they explain the image alike.
Lines of one section do not: how wide they are and how they bend light at their crown hang together. What an image says
of a bench is found by linearising it about the bench so far,

    E(lines, theta + d) + field = E(lines, theta) + sum_k d_k dE/dtheta_k + E sum_j c_j P_j,

and descending in lines, d and c together; then again about the bench that was found. P_j are the brightness of each
channel and slopes and curvatures of the light over the picture.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from nets.reconstruct.fibres.image_fit import FINE_PHOTONS_PER_PIXEL, METRIC_PHOTONS_PER_PIXEL, Beside, ImageFit
from nets.reconstruct.fibres.line_posterior import JointCovariance, joint_covariance, misfit_weight
from nets.reconstruct.fibres.one_wavelength import of_wavelength
from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber
from warp_caustics.found_bench.picture_size import enlarged
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity
from warp_caustics.reconstruct.seen_camera.aligned_channels import of_size
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

TOLD_BY_LINES = ("gap_m", "base_thickness_m", "index_offset")
"""Numbers that heights make up for and lines do not."""
FIELD_WIDTH = 0.05
"""Standard deviation of each channel's brightness, and of what light differs by at the rim."""
ROUNDS = 10
"""Benches about which the image is linearised, as long as the misfit falls by LEAST_GAIN."""
MOST_ROUNDS = 12
"""The same as long as it falls by STILL_FALLING: a picture 1.5 px aside halves it in the fifth."""
ITERATIONS = 30
"""Of L-BFGS about each."""
LEAST_TOLD = 5e-3
"""Change of how far light is bent, relative to it, that people are told of: 5 um of a line 1 mm high."""
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


@dataclass(frozen=True)
class Bench:
    """A bench and its light.

    Attributes:
        values: of its numbers, by name.
        field: brightness of each channel less 1, then slopes along x and y and curvatures x^2, xy, y^2 of all
            channels, x and y from -1 to 1 over the picture, shape [n_w + 5].
        sigma: standard deviations of values, by name; empty of the told one.
        rounds: benches about which the image was linearised on the way to it.
    """

    values: Mapping[str, float]
    field: FloatArray
    sigma: Mapping[str, float] = dataclasses.field(default_factory=dict)
    rounds: int = 0

    @classmethod
    def told(cls, numbers: BenchNumbers) -> "Bench":
        """As it is told, evenly lit."""
        values = {name: numbers.before[name] for name in numbers.names}
        return cls(values, np.zeros(numbers.scene.n_wavelengths + 5))

    @classmethod
    def found(cls, numbers: BenchNumbers, record: Mapping[str, Any], told_stray: float) -> "Bench":
        """As a record of :class:`~warp_caustics.found_bench.bench_record.FoundBench` has it, evenly lit.

        Args:
            numbers: of a bench whose told stray light has been taken off the image.
            record: of a search on the image as it was.
            told_stray: that was taken off, of flat light.
        """
        used = {number["name"]: number for number in record["numbers"] if number["name"] in numbers.names}
        values = {name: number["found"] for name, number in used.items()}
        if AMBIENT in values:
            values[AMBIENT] = (values[AMBIENT] - told_stray) / (1 + told_stray)
        sigma = {name: number["sigma"] for name, number in used.items()}
        told = cls.told(numbers)
        return dataclasses.replace(told, values={**told.values, **values}, sigma=sigma)

    def is_told(self, numbers: BenchNumbers) -> bool:
        """Whether nothing of it is other than told."""
        return all(value == numbers.before[name] for name, value in self.values.items()) and not self.field.any()

    def light(self, pixels: int) -> FloatArray:
        """What each pixel is brighter by than on the even bench [1], shape [n_w, m, m]."""
        channels = len(self.field) - 5
        own, shared = 1 + self.field[:channels, None, None], self.field[channels:]
        light: FloatArray = own + np.tensordot(shared, shared_modes(pixels), 1) if shared.any() else own
        return np.broadcast_to(light, (channels, pixels, pixels))


def field_modes(channels: int, pixels: int) -> FloatArray:
    """Patterns of :attr:`Bench.field`, shape [n_w + 5, n_w, m, m]."""
    own = np.eye(channels)[:, :, None, None] * np.ones((pixels, pixels))
    modes: FloatArray = np.concatenate([own, np.repeat(shared_modes(pixels)[:, None], channels, axis=1)])
    return modes


def shared_modes(pixels: int) -> FloatArray:
    """Patterns that channels have in common, shape [5, m, m]."""
    x = (np.arange(pixels) + 0.5) * (2 / pixels) - 1
    along_x, along_y = np.broadcast_to(x, (pixels, pixels)), np.broadcast_to(x[:, None], (pixels, pixels))
    return np.stack([along_x, along_y, along_x**2 - 1 / 3, along_x * along_y, along_y**2 - 1 / 3])


def seen_on(
    image: CausticImage, numbers: BenchNumbers, bench: Bench, exposure: FloatArray | None = None
) -> CausticImage:
    """An image as it would be on the bench's own flat plate, evenly lit, without stray light and of its scene's size.

    Args:
        image: as it was measured.
        numbers: that the bench's are.
        bench: that it was taken on.
        exposure: of the image, shape [n_w]; 1 if None.
    """
    scene, stray = numbers.scene, bench.values.get(AMBIENT, numbers.before[AMBIENT])
    level = np.asarray(scene.radiosity_W_m2, np.float64) * (1.0 if exposure is None else exposure)
    irradiance = np.asarray(image.irradiance, np.float64) / bench.light(scene.image_pixels)
    irradiance = (irradiance * (1 + stray) - stray * level[:, None, None]) * flat_ratio(numbers, bench)
    noise = None if image.noise_std is None else np.asarray(image.noise_std) * (1 + stray)
    seen = dataclasses.replace(image, irradiance=irradiance, noise_std=noise)
    return of_size(seen, 1 / numbers.picture_size(bench.values), "cpu")


def as_measured(shown: FloatArray, numbers: BenchNumbers, bench: Bench, exposure: FloatArray) -> FloatArray:
    """The inverse of :func:`seen_on` for irradiance [W/m^2], shape [n_w, m, m]."""
    scene, stray = numbers.scene, bench.values.get(AMBIENT, numbers.before[AMBIENT])
    level = np.asarray(scene.radiosity_W_m2, np.float64) * exposure
    shown = enlarged(torch.as_tensor(shown), numbers.picture_size(bench.values)).numpy()
    light = (shown / flat_ratio(numbers, bench) + stray * level[:, None, None]) / (1 + stray)
    measured: FloatArray = light * bench.light(scene.image_pixels)
    return measured


def bench_record(numbers: BenchNumbers, bench: Bench) -> FoundBench:
    """What was found, number by number; all of it is used."""
    found = []
    for p in numbers.parameters:
        value = bench.values[p.name]
        number = FoundNumber.of(p, numbers.before[p.name], value, bench.sigma.get(p.name), is_used=True)
        found.append(dataclasses.replace(number, found=value))
    untold = [FoundNumber.not_told(p, numbers.before[p.name]) for p in numbers.not_told]
    return FoundBench((*found, *untold), True, "lines explain the image better on it", bench.rounds, numbers.is_picture)


def bench_warnings(numbers: BenchNumbers, bench: Bench, record: FoundBench) -> list[str]:
    """What the user should know, also where gap, base and index are other together and none of them by itself."""
    told, found = (ThinRelief.of(each).linear for each in (numbers.scene, numbers.scene_of(bench.values)))
    names = {number.name for number in record.numbers if number.verdict == "found"}
    if names & set(TOLD_BY_LINES) or abs(found / told - 1) < LEAST_TOLD:
        return record.warnings()
    together = (
        f"lines tell of a bench with {100 * (found / told - 1):+.1f} % on base, gap and index together, which of them "
        "the image hardly says; heights are those on that bench: check it, or take --set-up known"
    )
    return [*record.warnings(), together]


def flat_ratio(numbers: BenchNumbers, bench: Bench) -> FloatArray:
    """Light of a flat plate on the bench over that on the told one, shape [n_w, m, m]; 1 for parallel light."""
    told, found = numbers.scene, numbers.scene_of(bench.values)
    if found.is_collimated and told.is_collimated:
        return np.ones((told.n_wavelengths, told.image_pixels, told.image_pixels))
    return _level(found) / _level(told)


def _level(scene: Scene) -> FloatArray:
    level: FloatArray = flat_light(in_units_of_radiosity(scene, scene.image_pixels), scene.image_pixels).numpy()
    return np.maximum(level, 1e-3)


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
        scene, pixels = numbers.scene, numbers.scene.image_pixels
        blur = blur_matrices(pixels, camera.blur, model.device) if np.any(camera.blur) else None
        self._model = BenchModel(numbers, pixels, model.device, blur)
        self._field = torch.from_numpy(field_modes(scene.n_wavelengths, pixels)).to(model.device, torch.float32)
        self._widths = np.array([*(p.prior for p in numbers.parameters), *[FIELD_WIDTH] * len(self._field)])

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
        camera = self.camera
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
        )
        if about is not None:
            fit.correct_at(self.model.heights(about))
        return fit

    def __call__(self, lines: torch.Tensor, bench: Bench) -> tuple[torch.Tensor, Bench]:
        """Lines that explain the image better, shape [L, 6] [m], and the bench on which they do."""
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
                try:
                    on_trial = self.fit_on(trial)
                except InputError:
                    continue
                on_trial.correct_by(fit.missing)
                self.model.shape = section
                # What lines and bench change together is in no linear image of both.
                settled = on_trial.descend(nearer, SETTLING, with_section=self.with_section)
                nearer, found = settled.lines, settled.loss
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
        return Beside(modes, before, misfit_weight(fit, loss))

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
        return dataclasses.replace(bench, sigma=dict(zip(self.numbers.names, deviations.tolist(), strict=False)))

    def _moved(self, bench: Bench, beside: FloatArray, sigma: FloatArray) -> Bench:
        names, count = self.numbers.names, len(self.numbers.parameters)
        step = beside * self._widths
        values = {name: bench.values[name] + float(d) for name, d in zip(names, step[:count], strict=True)}
        deviations = dict(zip(names, (sigma * self._widths)[:count].tolist(), strict=True))
        return Bench(self.numbers.within(values), bench.field + step[count:], deviations, bench.rounds + 1)
