"""Plate and bench together: the network's heights and the numbers of the bench found in turn.

    theta_0 = told;   h_k = network(image as the bench of theta_k shows it);   theta_k+1 = theta_k + step(h_k, theta_k)

The step moves heights along (:mod:`warp_caustics.found_bench`), and the network finds them again on the new bench. It
is asked for heights before they are refined: refined ones have made up for the bench already, and nothing is left of
the image that would tell of it. Afterwards heights are refined on the bench that was found, and kept if that explains
the image better than those on the bench that was told.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import torch

from nets.reconstruct.bench_method import BenchMethod
from nets.reconstruct.far_pictures import far_start
from nets.reconstruct.secant import lengthened
from nets.reconstruct.tried_bench import TriedBench
from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.errors import CausticsError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber, deviation, verdict_of
from warp_caustics.found_bench.bench_step import BenchStep, bench_step
from warp_caustics.found_bench.picture_size import enlarged
from warp_caustics.reconstruct.base import CausticImage, Progress, ProgressCallback, Reconstruction
from warp_caustics.reconstruct.exposure import light_ratio
from warp_caustics.reconstruct.image_noise import estimated_noise
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity, measurement_at
from warp_caustics.reconstruct.run_log import following
from warp_caustics.reconstruct.seen_camera.aligned_channels import channels_together, of_size
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

ROUNDS = 8
"""Networks asked on benches that were found, at most."""
BORDER_PX = 4
"""Of the image on all sides, that do not count: a picture that is moved has half pixels there."""
UNKNOWN_NOISE = 0.02
"""Of flat light, where an image does not tell its own."""
WORTH = 2.0
"""Standard deviations from what was told, after the first step, at which others are worth taking."""
LEAST_GAIN = 0.02
"""Share by which what is left of the image beyond its noise must fall for a found bench to be kept."""


class BenchSearch:
    """Looks for the bench of one image.

    Args:
        method: ``direct`` on the bench that is told.
        numbers: what is looked for.
    """

    def __init__(self, method: BenchMethod, numbers: BenchNumbers):
        self.method, self.numbers = method, numbers

    def __call__(
        self, image: CausticImage, told: Reconstruction, answer: FloatArray, progress: ProgressCallback | None
    ) -> Reconstruction:
        """The better of what was found on the told bench and on the one that the image tells of, with a record.

        Args:
            image: as it was measured.
            told: what was found on the bench that was told, refined.
            answer: heights of the network there, not refined [m], shape [n, n].
            progress: called after every round, and every step of the second refinement.

        Raises:
            KeyboardInterrupt: by ``progress``, before there are heights on another bench.
        """
        whole = time.perf_counter() - (told.history[-1]["elapsed_s"] if told.history else 0.0)
        found = self._tried(image, told, answer, self.before, _Run(whole, len(told.history), progress))
        pictures = self.of_pictures()
        if found.is_kept and pictures is not None and found.used.get(VERGENCE, 0.0) > 0:
            # As of a lamp nearby, or of a picture that is too large: what is left of the image decides.
            begun = found.record.rounds + len(found.kept.history)
            other = pictures._tried(image, told, answer, found.used, _Run(whole, begun, progress))
            found = found.or_better(other)
        return found.recorded()

    def _tried(
        self,
        image: CausticImage,
        told: Reconstruction,
        answer: FloatArray,
        start: Mapping[str, float],
        run: "_Run",
    ) -> TriedBench:
        """What a search from some values comes to.

        Args:
            image: as it was measured.
            told: what was found on the bench that was told, refined.
            answer: heights of the network there [m], shape [n, n].
            start: values of the numbers; heights are asked for anew where they are not the told ones.
            run: so far.
        """
        started = time.perf_counter()
        rounds = following(run.progress, run.told, run.began)
        values, why = dict(start), "the image is explained as well by what was told"
        steps: list[BenchStep] = []
        try:
            values, steps, sigma = self._searched(image, told, answer, start, rounds)
        except CausticsError as error:
            why = f"the search ended where no bench is: {error}"
            sigma = {}
        found = self._significant(values, sigma)
        timings = {"bench": time.perf_counter() - started}
        kept, is_kept, now = told, False, math.inf
        if any(found[name] != self.before[name] for name in found):
            try:
                later = following(run.progress, run.told + len(steps), run.began, "found bench, ")
                other = self._on(found).found(self._as_on(image, found, _exposure(told)), None, later)
            except CausticsError as error:
                why = f"no heights can be found on that bench: {error}"
            else:
                was, now = self._left(image, told, self.before), self._left(image, other, found)
                is_kept = is_less(now, was, self._noise_left(image, told))
                why = f"what is left of the image {'fell' if is_kept else 'did not fall'} from {was:.3g} to {now:.3g}"
                kept = self._as_measured(other, found) if is_kept else told
                if other.stop_reason == "interrupted":
                    kept = dataclasses.replace(kept, stop_reason="interrupted")
                timings |= {f"{name} on the found bench": value for name, value in other.timings_s.items()}
        record = self._record(values, sigma, is_kept, why, len(steps))
        return TriedBench(told, kept, record, found, now, timings)

    def on_found(self, image: CausticImage, kept: Reconstruction) -> CausticImage:
        """The image as the bench shows it that was found for a result, and kept; as for a call."""
        return self._of(kept)._as_on(image, self._of_record(kept), _exposure(kept))

    def method_on(self, kept: Reconstruction) -> BenchMethod:
        """The method on that bench."""
        return self._of(kept)._on(self._of_record(kept))

    def simulator_of(self, kept: Reconstruction) -> CausticSimulator:
        """Of that bench, with the losses of light that were found there."""
        return self.method_on(kept).simulator_of(kept)

    def glance(self, image: CausticImage, told: Reconstruction, answer: FloatArray) -> "Glance":
        """What the image shows of the bench by one step; arguments as for a call."""
        try:
            step = self._step_of(image, told)(answer, self.before)
        except CausticsError:
            return Glance(is_other=False, has_other_size=False)
        is_other = self._is_off(step.values, step.sigma)
        apart = abs(step.values.get(VERGENCE, 0.0) - self.before.get(VERGENCE, 0.0))
        return Glance(is_other, is_other and apart > WORTH * step.sigma.get(VERGENCE, 0.0))

    def is_far(self, image: CausticImage, told: Reconstruction, answer: FloatArray) -> bool:
        """Whether the picture is of quite another size, which one step may not show; arguments as for a call."""
        self.method.far = None  # the image may be the last one, changed
        self.method.far = image, (far := self._far_start(image, told, answer))
        return far is not None

    def cleared(self, image: CausticImage) -> CausticImage:
        """The image without the stray light that is told."""
        if not self.numbers.before[AMBIENT]:
            return image
        scene = self.method.scene
        ratio = light_ratio(measurement_at(image, scene, scene.image_pixels, self.method.device, made_up=True))
        return self._as_on(image, self.before, ratio)

    def answer(self, image: CausticImage, told: Reconstruction, values: Mapping[str, float]) -> FloatArray:
        """Heights of the network on the bench of some values, not refined [m], shape [n, n]; as for a call."""
        return self._on(values).answer(self.as_on(image, told, values))

    def as_on(self, image: CausticImage, told: Reconstruction, values: Mapping[str, float]) -> CausticImage:
        """The image as that bench shows it to networks; as for a call."""
        return self._as_on(image, values, _exposure(told))

    def of_pictures(self) -> "BenchSearch | None":
        """For which a vergence is that of a picture; None where the picture's size is told."""
        pictures = self.numbers.of_picture()
        return None if pictures is None else BenchSearch(self.method, pictures)

    def _of(self, kept: Reconstruction) -> "BenchSearch":
        """The search that a result is of."""
        return (self.of_pictures() if kept.counters["bench"]["is_picture"] else None) or self

    def _of_record(self, kept: Reconstruction) -> dict[str, float]:
        """Values of a result's bench."""
        numbers = kept.counters["bench"]["numbers"]
        return {number["name"]: number["found"] for number in numbers if number["name"] in self.before}

    @property
    def before(self) -> dict[str, float]:
        """Values that are told, by name."""
        return {name: self.numbers.before[name] for name in self.numbers.names}

    def _searched(
        self,
        image: CausticImage,
        told: Reconstruction,
        answer: FloatArray,
        start: Mapping[str, float],
        progress: ProgressCallback | None,
    ) -> tuple[dict[str, float], list[BenchStep], dict[str, float]]:
        """Values, the steps to them from the start, and their deviations."""
        stepped = self._step_of(image, told)
        values, heights, steps = dict(start), answer, []
        if values != self.before:
            heights = self.answer(image, told, values)
        sigma: dict[str, float] = {}
        was: dict[str, tuple[float, float]] = {}
        for turn in range(ROUNDS):
            step = stepped(heights, values)
            steps.append(step)
            if progress is not None:
                progress(Progress("looking for the bench", turn + 1, ROUNDS, math.nan, 0.0))
            move = {name: step.values[name] - values[name] for name in values}
            sigma = {name: math.hypot(step.sigma[name], abs(move[name]) / 2) for name in values}
            is_there = not step.gain or all(abs(move[name]) < step.sigma[name] for name in values)
            is_near = not turn and not self._is_off(step.values, step.sigma)
            far = self._far_start(image, told, answer) if not turn and start == self.before else None
            if far is not None:
                values = far
                heights = self.answer(image, told, values)
                continue
            if is_there or is_near:
                return step.values, steps, sigma
            further = {n: values[n] + lengthened(values[n], move[n], step.sigma[n], was.get(n)) for n in values}
            was = {name: (values[name], move[name]) for name in values}
            values = self.numbers.within(further if turn + 1 < ROUNDS else step.values)
            if turn + 1 < ROUNDS:
                heights = self.answer(image, told, values)
        return values, steps, sigma

    def _far_start(self, image: CausticImage, told: Reconstruction, answer: FloatArray) -> dict[str, float] | None:
        """Where to begin instead with a picture of quite another size; arguments as for a call."""
        pictures, known, self.method.far = self.of_pictures(), self.method.far, None
        if pictures is None:
            return None
        if known is not None and known[0] is image:  # two sizes are asked for 12 s on two cores
            return known[1]
        shown = _Shown(pictures, image, told)
        return far_start(shown, self.numbers, self.method.simulator_of(told), _exposure(told), answer)

    def _step_of(
        self, image: CausticImage, told: Reconstruction
    ) -> Callable[[FloatArray, Mapping[str, float]], BenchStep]:
        """What an image says of the bench at heights [m], shape [n, n], and values of its numbers."""
        scene, device = self.method.scene, self.method.device
        pixels = self.method.refinement.pixels
        camera = ChannelCamera.of_record(told.counters["camera"], scene.image_pixels)
        blur = blur_matrices(pixels, camera.blur_at(pixels), device) if camera.blurs else None
        together = channels_together(image, camera, device) if camera.displaces else image
        factor = scene.image_pixels // pixels
        model, noise = BenchModel(self.numbers, pixels, device, blur), self._noise(image) / factor

        def step(heights: FloatArray, values: Mapping[str, float]) -> BenchStep:
            shown = of_size(together, 1 / self.numbers.picture_size(values), device)
            measurement = measurement_at(shown, scene, pixels, device, -(-BORDER_PX // factor))
            relief = torch.tensor(heights, dtype=torch.float32, device=device)
            return bench_step(model.in_size_of(values), relief, values, measurement, noise)

        return step

    def _noise(self, image: CausticImage) -> torch.Tensor:
        """Standard deviation where light is flat, in units of the radiosity, shape [n_w]."""
        scene = self.method.scene
        noise = image.noise_std if image.noise_std is not None else estimated_noise(image, scene)
        level = np.maximum(np.asarray(scene.radiosity_W_m2), 1e-30)
        relative = np.full(len(level), UNKNOWN_NOISE) if noise is None else np.asarray(noise) / level
        return torch.as_tensor(np.maximum(relative, 1e-3), dtype=torch.float64)

    def _is_off(self, values: Mapping[str, float], sigma: Mapping[str, float]) -> bool:
        """Whether another round is worth its time."""
        return any(
            abs(values[p.name] - self.before[p.name]) > WORTH * deviation(p, sigma[p.name])
            for p in self.numbers.parameters
        )

    def _significant(self, values: Mapping[str, float], sigma: Mapping[str, float]) -> dict[str, float]:
        """Values that differ from what was told by more than they are uncertain; of others what was told."""
        return {
            name: values[name] if verdict_of(p, was, values[name], sigma.get(name)) == "found" else was
            for p, (name, was) in zip(self.numbers.parameters, self.before.items(), strict=True)
        }

    def _on(self, values: Mapping[str, float]) -> BenchMethod:
        return self.method.on_bench(self._user_scene(values))

    def _user_scene(self, values: Mapping[str, float]) -> Scene:
        """The bench with as many samples as the user asked for."""
        user = self.method.network.seen.user
        return self.numbers.scene_of(values).model_copy(update={"height_samples": user.height_samples})

    def _as_on(self, image: CausticImage, values: Mapping[str, float], exposure: FloatArray) -> CausticImage:
        """The image as it would be without stray light, divided by the flat frame of the found bench, in its size."""
        scene, stray = self.method.scene, values.get(AMBIENT, self.numbers.before[AMBIENT])
        level = np.asarray(scene.radiosity_W_m2)[:, None, None]
        irradiance = np.asarray(image.irradiance, np.float64)
        if stray:
            irradiance = irradiance * (1 + stray) - stray * (level * exposure[:, None, None])
        irradiance = irradiance * self._flat_ratio(values)
        noise = None if image.noise_std is None else image.noise_std * (1 + stray)
        seen = dataclasses.replace(image, irradiance=irradiance, noise_std=noise)
        return of_size(seen, 1 / self.numbers.picture_size(values), self.method.device)

    def _noise_left(self, image: CausticImage, told: Reconstruction) -> float:
        """What noise leaves of the image at the exposure of the told result, in the units of :meth:`_left`."""
        noise = self._noise(image).numpy() * np.asarray(self.method.scene.radiosity_W_m2) / _exposure(told)
        return float(np.sqrt(np.mean(np.square(noise))))

    def _as_measured(self, result: Reconstruction, values: Mapping[str, float]) -> Reconstruction:
        """With its caustic as the image has it: stray light and all, divided by the flat frame of its bench."""
        scene, stray = self.method.scene, values.get(AMBIENT, self.numbers.before[AMBIENT])
        light = np.asarray(scene.radiosity_W_m2) * _exposure(result)
        ratio, size = self._flat_ratio(values), self.numbers.picture_size(values)

        def as_measured(shown: FloatArray, size: float = 1.0) -> FloatArray:
            seen = (shown / ratio + stray * light[:, None, None]) / (1 + stray)
            measured: FloatArray = enlarged(torch.as_tensor(seen), size).numpy().astype(shown.dtype)
            return measured

        shown = None if result.shown is None else as_measured(result.shown)
        return dataclasses.replace(result, image=as_measured(result.image, size), shown=shown)

    def _flat_ratio(self, values: Mapping[str, float]) -> FloatArray:
        """Light of a flat plate on the bench of these values over that on the told one, shape [n_w, m, m]."""
        scene, found = self.method.scene, self.numbers.scene_of(values)
        if found.is_collimated and scene.is_collimated:
            return np.ones((scene.n_wavelengths, scene.image_pixels, scene.image_pixels))
        return _flat(found) / _flat(scene)

    def _left(self, image: CausticImage, result: Reconstruction, values: Mapping[str, float]) -> float:
        """What a result leaves of the image, in units that do not depend on the stray light that was taken off."""
        stray = values.get(AMBIENT, self.numbers.before[AMBIENT])
        exposure = _exposure(result)
        measured = self._as_on(image, values, exposure)
        shown = np.asarray(measured.irradiance, np.float64) / exposure[:, None, None]
        counted = shown if measured.mask is None else shown[measured.mask]
        return result.residual * float(np.sqrt(np.mean(np.square(counted)))) / (1 + stray)

    def _record(
        self, values: Mapping[str, float], sigma: Mapping[str, float], is_kept: bool, why: str, rounds: int
    ) -> FoundBench:
        found = [
            FoundNumber.of(p, self.before[p.name], values[p.name], sigma.get(p.name), is_used=is_kept)
            for p in self.numbers.parameters
        ]
        untold = [FoundNumber.not_told(p, self.numbers.before[p.name]) for p in self.numbers.not_told]
        return FoundBench((*found, *untold), is_kept, why, rounds, self.numbers.is_picture)


class Glance(NamedTuple):
    """What an image shows by one step: another bench than told; and a picture of another size, or a lamp nearby."""

    is_other: bool
    has_other_size: bool


class _Run(NamedTuple):
    """When a run began, by ``time.perf_counter``, how many iterations it has told of, and whom it tells."""

    began: float
    told: int
    progress: ProgressCallback | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Shown:
    """One image on benches of a search; see :class:`~nets.reconstruct.far_pictures.Pictures`."""

    search: BenchSearch
    image: CausticImage
    told: Reconstruction

    def seen(self, values: Mapping[str, float]) -> CausticImage:
        return self.search.as_on(self.image, self.told, values)

    def answer(self, values: Mapping[str, float]) -> FloatArray:
        return self.search.answer(self.image, self.told, values)


def is_less(now: float, was: float, noise: float) -> bool:
    """Whether what is left of an image has become less, by more than a share of what noise does not explain."""
    return was**2 - now**2 > 2 * LEAST_GAIN * max(was**2 - noise**2, 0.0)


def _exposure(result: Reconstruction) -> FloatArray:
    """Of the image, shape [n_w]."""
    return np.asarray(result.counters["exposure"], dtype=np.float64)


def _flat(scene: Scene) -> FloatArray:
    """Light of a flat plate in units of the radiosity, shape [n_w, m, m]."""
    level: FloatArray = flat_light(in_units_of_radiosity(scene, scene.image_pixels), scene.image_pixels).numpy()
    return np.maximum(level, 1e-3)
