"""``direct``: heights from the image by one network, averaged over symmetries, then refined on the exact model."""

import copy
import dataclasses
import time
from collections.abc import Callable
from typing import Any, Self

import torch

from nets.reconstruct.bench_search import BenchSearch
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.losses_of_light import LOSS_FACTOR, effects_of, with_losses
from nets.reconstruct.network_answers import NetworkAnswers
from nets.reconstruct.network_io import TRAINED_EXPOSURE_ERROR, network_result
from nets.reconstruct.opinions import Opinion, opinion
from nets.reconstruct.posterior_samples import Samples, posterior_samples
from nets.reconstruct.refinement import Refined, Refinement, outcome
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION, FAMILY_CALIBRATION, uncertainty
from nets.reconstruct.with_bench import with_bench
from nets.reconstruct.with_causes import looks_bare, with_causes
from nets.reconstruct.with_doubt import with_doubt
from nets.shipped import FoundNetwork, find_network, told_network
from warp_caustics.errors import MismatchError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
from warp_caustics.reconstruct.folds import has_folds
from warp_caustics.reconstruct.pyramid import check_image, check_initial
from warp_caustics.reconstruct.rest import local_relief
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.run_log import RunLog, following
from warp_caustics.reconstruct.seen_camera.channel_camera import TRAINED_BLUR_PX
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

NO_FOLDS = (
    "the image shows no bright lines, which networks were trained with: where light paths do not cross, --method "
    "refine, which auto takes here, finds the relief"
)
UNLIKE = "the image shows no bright lines, and how wrong networks are was measured on images that do"
SEARCH_TIMES = 4.0
"""What looking for the bench may take, relative to what was done before: with less time left it is not begun."""


def unlike_training(found: Reconstruction, *, is_bare: bool) -> Reconstruction:
    """A result whose image shows no bright lines: with a warning, and without an uncertainty unless the plate is bare.

    Hills of 0.2 mm were 98 um off where 2.0 um were stated.
    """
    warned = dataclasses.replace(found, warnings=(*found.warnings, NO_FOLDS))
    if is_bare or found.uncertainty_m is None:
        return warned
    return dataclasses.replace(warned, uncertainty_m=None, no_uncertainty=UNLIKE)


class Direct(Reconstructor):
    """Network, symmetries, refinement.

    A network that is told of its bench is told the scene, and serves any of its family (:mod:`nets.family`). Where
    another was made for the scene, the one that explains the image is taken (:mod:`nets.reconstruct.opinions`).

    Args:
        scene: the set-up of the measurement.
        options: see :class:`DirectOptions`.
        device: where to compute.

    Raises:
        InputError: no network is shipped, or no such file.
        MismatchError: the network is for another scene.
    """

    name = "direct"
    watch: Callable[[Reconstruction], None] | None = None
    """Called with what was found on the told bench, before any other is looked for."""
    said: tuple[CausticImage, Opinion] | None = None
    """The last image that the networks were asked about, and what they said; for :meth:`take_over`."""
    handed: tuple[CausticImage, Opinion] | None = None
    """What the next call need not ask, of this image."""
    far: tuple[CausticImage, dict[str, float] | None] | None = None

    def __init__(self, scene: Scene, options: DirectOptions | None = None, device: str | torch.device = "cpu"):
        self.options, self.device = options or DirectOptions(), usable_device(device)
        if self.options.max_iterations is not None:
            self.options = self.options.model_copy(update={"refine_iterations": self.options.max_iterations})
        self.options = self.options.on(self.device.type)
        self.finds_bench = self.options.set_up != "known"
        self.finds_losses = self.device.type == "cuda" if self.options.losses is None else self.options.losses
        first = find_network("direct", scene, path=self.options.weights, device=self.device, any_grid=True)
        networks = [first]
        if self.options.second_opinion and self.options.weights is None:
            second = told_network("direct", scene, first, self.device)
            networks += [] if second is None else [second]
        self._ask([NetworkAnswers(each, self.device, self.options.symmetries) for each in networks])
        self.numbers = BenchNumbers.of(self.scene, self.options.priors, self.options.ambient)

    def _ask(self, networks: list[NetworkAnswers]) -> None:
        """Take networks with the scene that they see."""
        self.asked, self.network = networks, networks[0].network
        self.scene = self.network.seen.working
        self.simulator = CausticSimulator(self.scene, "lattice", device=self.device)
        self.refinement = Refinement(self.scene, self.options, self.device, self.network.seen.scale)

    def take_over(self, other: "Direct") -> None:
        """Let the next call, if it is of the image that another of these was asked about last, not ask it again.

        Once: an image may be changed between calls, and whoever calls twice wants it asked twice.
        """
        self.handed, other.said = other.said, None
        self.far, other.far = other.far, None

    def on_bench(self, scene: Scene) -> Self:
        """The same method for another bench near its own: as many pixels, samples and wavelengths.

        Raises:
            MismatchError: a bench beyond the family of all its networks that are told of it.
        """
        networks, beyond = [], None
        for each in self.asked:
            try:
                networks.append(each.on_bench(scene))
            except MismatchError as error:
                beyond = error
        if beyond is not None and not networks:
            raise beyond
        other = copy.copy(self)
        other.said = other.handed = other.far = None
        other._ask(networks)
        return other

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        The network needs no start and ignores a given one. Ctrl-C returns the mean of the symmetries done so
        far (a flat plate before the first), or the refinement so far. ``stop_reason`` is that of the refinement,
        ``converged`` without one.
        """
        started, image = time.perf_counter(), check_image(image, self.scene)
        search = BenchSearch(self, self.numbers)
        seen = search.cleared(image)
        found, answer = self._found(seen, initial, progress)
        if self.watch is not None:
            self.watch(found)
        if self.finds_bench and found.stop_reason != "interrupted" and self._has_time(time.perf_counter() - started):
            try:
                found = search(image, found, answer, progress)
            except KeyboardInterrupt:
                found = dataclasses.replace(found, stop_reason="interrupted")
        if self.options.causes and found.stop_reason != "interrupted":
            if found.counters.get("bench", {}).get("is_kept"):
                shown, there, numbers = search.on_found(image, found), search.simulator_of(found), None
            else:
                shown, there, numbers = seen, self.simulator_of(found), self.numbers
            found = with_causes(found, shown, there, numbers, None if numbers is None else answer)
            if not has_folds(image, self.scene):
                found = unlike_training(found, is_bare=looks_bare(found, shown, there))
        if self.options.bench_uncertainty:
            found = with_bench(found, self.numbers, flatness_m=self.options.flatness_m)
        return self.asked[0].grid.result(with_doubt(found))

    def _has_time(self, elapsed_s: float) -> bool:
        """Whether another bench can be looked for within the time that is left."""
        limit_s = self.options.max_time_s
        return limit_s is None or (1 + SEARCH_TIMES) * elapsed_s < limit_s

    def simulator_of(self, found: Reconstruction) -> CausticSimulator:
        """With the losses of light that were found."""
        scene = self.scene.model_copy(update=found.counters.get("losses", {}))
        return self.simulator if scene == self.scene else CausticSimulator(scene, "lattice", device=self.device)

    def found(
        self, image: CausticImage, initial: FloatArray | None = None, progress: ProgressCallback | None = None
    ) -> Reconstruction:
        """Recover the relief with as many samples as it is found with, which may be others than the user's.

        On this bench and no other, of an image without stray light.
        """
        return self._found(check_image(image, self.scene), initial, progress)[0]

    def answer(self, image: CausticImage) -> FloatArray:
        """Heights of the networks before they are refined [m], shape [n, n]."""
        resimulation = self._resimulation(image)
        found = self._opinion(resimulation, RunLog(0, None))
        if found.reason == "interrupted":
            raise KeyboardInterrupt
        return as_glass(found.answers.mean(0).cpu().numpy(), self.scene)

    @torch.no_grad()
    def looked_again(self, resimulation: Resimulation, heights: FloatArray) -> tuple[torch.Tensor, torch.Tensor] | None:
        """What a network says that looks at somebody else's answer.

        Args:
            resimulation: of an image on this bench.
            heights: that answer [m], shape [n, n].

        Returns:
            Mean and standard deviation of its answers [m], shape [n, n]; None if no network can look again.
        """
        seeing = [each for each in self.asked if each.has_feedback]
        if not seeing:
            return None
        look = seeing[-1].look(torch.as_tensor(heights), resimulation(heights).image)
        answers = torch.cat(list(seeing[-1](resimulation.image, look)))
        return answers.mean(0), answers.std(0, correction=0)

    @torch.no_grad()
    def first_answers(self, image: CausticImage) -> torch.Tensor:
        """What each network says at a first look in each symmetry [m], shape [B, n, n].

        Args:
            image: on this bench, at its exposure.
        """
        return torch.cat([answers for network in self.asked for answers in network(image)])

    def _resimulation(self, image: CausticImage) -> Resimulation:
        """At the exposure that a network needs."""
        resimulation, bench = Resimulation(self.simulator, image), self.asked[0].bench
        if bench is None or not bench.is_near:
            return resimulation.exposed(least=TRAINED_EXPOSURE_ERROR)
        return resimulation

    def _opinion(self, resimulation: Resimulation, log: RunLog) -> Opinion:
        def caustic(heights: torch.Tensor) -> tuple[torch.Tensor, float]:
            found = as_glass(heights.cpu().numpy(), self.scene)
            return resimulation.exposed(found)(found)

        return opinion(self.asked, resimulation.image, caustic, log)

    def _refined(
        self,
        resimulation: Resimulation,
        image: CausticImage,
        heights: FloatArray,
        spread: FloatArray | None,
        log: RunLog,
    ) -> tuple[Resimulation, Refined | None]:
        """Heights refined, and what judges them: with losses of light that are not told, where the image shows them."""

        def refined(seen: Resimulation, name: str) -> Refined | None:
            started, progress = log.elapsed_s, following(log.progress, len(log.history), log.started, name)
            return self._refinement_in(seen.simulator.scene)(seen, heights, started, progress, spread)

        found = refined(resimulation, "refinement, ")
        is_over = found is None or found.reason in ("interrupted", "max_time")
        lossy = None if is_over or not self.finds_losses else self._lossy(resimulation, image, heights)
        if found is None or lossy is None:
            return resimulation, found
        other = refined(lossy, "refinement with losses, ")
        if other is None or lossy(other.heights).residual > LOSS_FACTOR * resimulation(found.heights).residual:
            return resimulation, found
        return lossy, other

    def _lossy(self, resimulation: Resimulation, image: CausticImage, heights: FloatArray) -> Resimulation | None:
        """With all losses of light, where less of the image is left with them already before heights are refined."""
        seen = {self.scene: resimulation}

        def left(scene: Scene) -> float:
            if scene not in seen:
                simulator = CausticSimulator(scene, "lattice", device=self.device)
                plain = Resimulation(simulator, image, resimulation.exposure).exposed(heights)
                seen[scene] = plain.through(resimulation.camera)
            return seen[scene](heights).residual

        scene = with_losses(self.scene, left, both=True)
        return None if scene == self.scene else seen[scene]

    def _refinement_in(self, scene: Scene) -> Refinement:
        if scene == self.scene:
            return self.refinement
        return Refinement(scene, self.options, self.device, self.network.seen.scale)

    def _found(
        self, image: CausticImage, initial: FloatArray | None, progress: ProgressCallback | None
    ) -> tuple[Reconstruction, FloatArray]:
        """The record, and the heights before they were refined."""
        if initial is not None:
            check_initial(initial, self.network.seen.user)
        log = RunLog(0, progress)
        resimulation = self._resimulation(image)
        handed, self.handed = self.handed, None
        found = handed[1] if handed is not None and handed[0] is image else self._opinion(resimulation, log)
        self.said = None if found.reason == "interrupted" else (image, found)
        answers, network, reason = found.answers, found.source.network, found.reason
        interrupted = reason == "interrupted"
        warnings = list(network.warnings)
        if initial is not None:
            warnings.append("direct takes no start, the given one is not used; --method refine does")
        n = self.scene.height_samples
        mean = answers.mean(0).cpu().numpy() if len(answers) else torch.zeros(n, n).numpy()
        heights = answer = as_glass(mean, self.scene)
        if not interrupted:
            resimulation = resimulation.exposed(heights)
        calibration = FAMILY_CALIBRATION if found.looked_by.network.is_told else DIRECT_CALIBRATION
        flatness = self.options.flatness_beside
        spread = uncertainty(found.looked.double(), calibration, network.seen.scale, flatness)
        no_spread = self._no_uncertainty(network, len(found.looked))
        timings = {"network": log.elapsed_s}
        found_at = None
        counters: dict[str, Any] = {"symmetries": len(answers), "refinement": "off"}
        if found.record:
            counters["networks"] = found.record
        if not interrupted:
            resimulation = resimulation.through(resimulation.found_camera(heights))
            counters["camera"] = resimulation.camera.record
            known_px = network.trained_shift_px, TRAINED_BLUR_PX * network.pixels_of_one
            warnings += resimulation.camera.warnings(self.scene.wavelengths_m, *known_px)
        history = log.history
        if self.options.refine and not interrupted:
            own_spread = None if spread is None else found.looked.double().std(dim=0).cpu().numpy()
            resimulation, refined = self._refined(resimulation, image, heights, own_spread, log)
            counters["losses"] = effects_of(resimulation.simulator.scene)
            reason = "max_time"
            if refined is not None:
                heights, reason, found_at = refined.heights, refined.reason, refined.found_at
                history += [
                    entry | {"iteration": len(history) + k + 1, "elapsed_s": entry["elapsed_s"] + timings["network"]}
                    for k, entry in enumerate(refined.history)
                ]
            counters["refinement"] = outcome(refined)
            timings["refinement"] = log.elapsed_s - timings["network"]
        rest = resimulation.rest(heights, found_at) if self.options.causes and spread is not None else None
        if rest is not None and not interrupted:
            left = torch.as_tensor(rest.share * local_relief(heights), device=answers.device)
            spread = uncertainty(found.looked.double(), calibration, network.seen.scale, flatness, left)
            assert spread is not None
        record = network_result(
            self.name,
            resimulation,
            heights,
            reason=reason,
            history=history,
            timings=timings,
            counters=counters,
            settings=self.options.model_dump() | {"network": network.record},
            warnings=warnings,
            uncertainty=None if spread is None or no_spread else spread.cpu().numpy(),
            no_uncertainty=no_spread,
            found_at=found_at,
        )
        if self.options.samples and reason not in ("interrupted", "max_time"):
            record = self._with_samples(record, found, resimulation, log, found_at)
        return record, answer

    def _with_samples(
        self, record: Reconstruction, found: Opinion, resimulation: Resimulation, log: RunLog, found_at: int | None
    ) -> Reconstruction:
        """The record with samples of what the image leaves open, or why there are none."""
        every = found.looked if found.answers is found.looked else torch.cat([found.looked, found.answers])
        started, spread = log.elapsed_s, found.looked.double().std(dim=0, correction=len(found.looked) > 1)
        refinement = self._refinement_in(resimulation.simulator.scene)

        def refined(heights: FloatArray) -> FloatArray:
            progress = following(log.progress, len(record.history), log.started, "samples, ")
            other = refinement(resimulation, heights, log.elapsed_s, progress, spread.cpu().numpy())
            if other is None or other.reason == "interrupted":
                raise KeyboardInterrupt
            return other.heights

        samples: Samples | None = None
        why = "the noise of the image cannot be told"
        if len(every) < 2:
            why = "only answers of several symmetries tell what is open"
        else:
            try:
                samples = posterior_samples(
                    self.options.samples,
                    record.heights_m,
                    every,
                    resimulation,
                    refined,
                    uncertainty_m=record.uncertainty_m,
                    scale=self.network.seen.scale,
                    found_at=found_at,
                )
            except KeyboardInterrupt:
                why = "the run was cut short"
        told = {"count": 0, "line": f"none, because {why}"} if samples is None else samples.record
        return dataclasses.replace(
            record,
            samples_m=None if samples is None else samples.heights_m,
            counters=record.counters | {"samples": told},
            timings_s=record.timings_s | {"samples": log.elapsed_s - started},
        )

    def _no_uncertainty(self, network: FoundNetwork, answers: int) -> str:
        """Why a result of so many answers has no uncertainty; empty where it has one."""
        if answers < 2:
            why = "the run was cut short" if self.options.symmetries else "symmetries is off"
            return f"{why}: only answers of several symmetries tell how far they lie apart"
        few = network.few_steps
        if few is None:
            return ""
        return f"the network was trained for {few} steps only, and how far its answers lie apart tells nothing"
