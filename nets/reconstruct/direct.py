"""``direct``: heights from the image by one network, averaged over symmetries, then refined on the exact model."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Annotated, Any, Literal, Self

import torch
from pydantic import Field

from nets.family import check_family
from nets.reconstruct.bench_search import BenchSearch
from nets.reconstruct.network_grid import NetworkGrid
from nets.reconstruct.network_io import TRAINED_EXPOSURE_ERROR, network_result
from nets.reconstruct.refinement import Refinement, RefinementOptions, outcome
from nets.reconstruct.told_bench import ToldBench
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION, FAMILY_CALIBRATION, uncertainty
from nets.replayed import Replayed
from nets.seen_scene import seen_scene
from nets.shipped import FoundNetwork, find_network
from nets.symmetries import all_symmetries, seen_in, turned_back
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor, StopReason
from warp_caustics.reconstruct.pyramid import check_image, check_initial
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.run_log import RunLog, following, why_stopped
from warp_caustics.reconstruct.seen_camera.channel_camera import TRAINED_BLUR_PX
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

SYMMETRIES_AT_ONCE = {"cpu": 4, "cuda": 8}
"""By device."""


BENCH_OPTIONS = ("set_up", "priors", "ambient")
"""Those that are about the bench, which other methods take as it is told."""


class DirectOptions(RefinementOptions):
    """Settings of ``direct``."""

    symmetries: bool = True
    """Mean over all turns and flips that the scene has: more exact, and the source of the uncertainty."""
    max_iterations: Annotated[int, Field(ge=1)] | None = None
    """Of the refinement, in place of ``refine_iterations``: what --max-iterations sets."""
    set_up: Literal["known", "estimate"] = "known"
    """Whether the bench is as it is told, or its numbers are looked for beside the heights."""
    priors: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(default_factory=dict)
    """Standard deviations of what is told of it, by name; 0 is exact."""
    ambient: Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)] = 0.0
    """Stray light that is told, relative to a flat plate's: taken off the image."""


class Direct(Reconstructor):
    """Network, symmetries, refinement.

    A network that is told of its bench is told the scene, and serves any of its family (:mod:`nets.family`). Images
    come to the network's grid and heights back to the scene's (:mod:`nets.reconstruct.network_grid`), where they are
    refined.

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

    def __init__(self, scene: Scene, options: DirectOptions | None = None, device: str | torch.device = "cpu"):
        self.options, self.device = options or DirectOptions(), usable_device(device)
        if self.options.max_iterations is not None:
            self.options = self.options.model_copy(update={"refine_iterations": self.options.max_iterations})
        self.options = self.options.on(self.device.type)
        network = find_network("direct", scene, path=self.options.weights, device=self.device, any_grid=True)
        network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.is_told = bool(getattr(network.module, "is_told", False))
        self.replayed = Replayed(network.module)
        self._serve(network)
        self.bench = ToldBench(network.seen.scene, network.info.scene, self.device) if self.is_told else None
        self.numbers = BenchNumbers.of(self.scene, self.options.priors, self.options.ambient)

    def _serve(self, network: FoundNetwork) -> None:
        """Take a network with the scene that it is to see."""
        self.network, self.grid = network, NetworkGrid(network, self.device)
        self.scene = network.seen.working
        self.simulator = CausticSimulator(self.scene, "lattice", device=self.device)
        self.refinement = Refinement(self.scene, self.options, self.device, network.seen.scale)

    def on_bench(self, scene: Scene) -> Self:
        """The same method for another bench near its own: as many pixels, samples and wavelengths.

        A network that is told of its bench is told of this one. Another one sees the picture as its own bench would
        have shown it: a flat plate's light where it met the plate, and heights in proportion, which is right to first
        order (:mod:`nets.flat_light`); refinement does the rest.

        Raises:
            MismatchError: a bench beyond the family of a network that is told of it.
        """
        trained, seen = self.network.info.scene, seen_scene(scene, self.network.info.scene)
        if self.is_told:
            check_family(seen, trained, self.network.info.training["family"], self.network.file, "direct")
        other = copy.copy(self)
        other._serve(dataclasses.replace(self.network, seen=seen))
        other.bench = ToldBench(seen.scene, trained, self.device)
        return other

    def made_for(self, scene: Scene) -> "Direct | None":
        """One with the network that would be taken if this scene were told; None if that is the own.

        Raises:
            MismatchError: none serves it.
        """
        if self.options.weights is not None or scene == self.network.seen.user:
            return None
        other = Direct(scene, self.options.model_copy(update={"priors": {}}), self.device)
        return None if other.network.file == self.network.file else other

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
        image = check_image(image, self.scene)
        search = BenchSearch(self, self.numbers)
        seen = search.cleared(image)
        found, answer = self._found(seen, initial, progress)
        if self.watch is not None:
            self.watch(found)
        if self.options.set_up == "estimate" and found.stop_reason != "interrupted":
            found = search(image, found, answer, progress)
        return self.grid.result(found)

    def found(
        self, image: CausticImage, initial: FloatArray | None = None, progress: ProgressCallback | None = None
    ) -> Reconstruction:
        """Recover the relief with as many samples as it is found with, which may be others than the user's.

        On this bench and no other, of an image without stray light.
        """
        return self._found(check_image(image, self.scene), initial, progress)[0]

    def answer(self, image: CausticImage) -> FloatArray:
        """Heights of the network before they are refined [m], shape [n, n]."""
        resimulation = self._resimulation(image)
        answers, reason = self._answers(resimulation.image, RunLog(0, None))
        if reason == "interrupted":
            raise KeyboardInterrupt
        return as_glass(answers.mean(0).cpu().numpy(), self.scene)

    def _resimulation(self, image: CausticImage) -> Resimulation:
        """At the exposure that a network needs."""
        resimulation = Resimulation(self.simulator, image)
        if self.bench is None or not self.bench.is_near:
            return resimulation.exposed(least=TRAINED_EXPOSURE_ERROR)
        return resimulation

    def _found(
        self, image: CausticImage, initial: FloatArray | None, progress: ProgressCallback | None
    ) -> tuple[Reconstruction, FloatArray]:
        """The record, and the network's heights before they were refined."""
        warnings = list(self.network.warnings)
        if initial is not None:
            check_initial(initial, self.network.seen.user)
            warnings.append("direct takes no start, the given one is not used; --method refine does")
        log = RunLog(0, progress)
        resimulation = self._resimulation(image)
        answers, reason = self._answers(resimulation.image, log)
        interrupted = reason == "interrupted"
        n = self.scene.height_samples
        mean = answers.mean(0).cpu().numpy() if len(answers) else torch.zeros(n, n).numpy()
        heights = answer = as_glass(mean, self.scene)
        if not interrupted:
            resimulation = resimulation.exposed(heights)
        spread = uncertainty(answers.double(), FAMILY_CALIBRATION if self.is_told else DIRECT_CALIBRATION)
        no_spread = self._no_uncertainty(len(answers))
        timings = {"network": log.elapsed_s}
        found_at = None
        counters: dict[str, Any] = {"symmetries": len(answers), "refinement": "off"}
        if not interrupted:
            resimulation = resimulation.through(resimulation.found_camera(heights))
            counters["camera"] = resimulation.camera.record
            known_px = self._trained_shift_px, TRAINED_BLUR_PX * self._pixels_of_one
            warnings += resimulation.camera.warnings(self.scene.wavelengths_m, *known_px)
        history = log.history
        if self.options.refine and not interrupted:
            found = self.refinement(
                resimulation,
                heights,
                timings["network"],
                following(progress, len(history), log.started, "refinement, "),
                None if spread is None else answers.double().std(dim=0).cpu().numpy(),
            )
            reason = "max_time"
            if found is not None:
                heights, reason = found.heights, found.reason
                found_at = self.refinement.pixels if found.is_better else None
                history += [
                    entry | {"iteration": len(history) + k + 1, "elapsed_s": entry["elapsed_s"] + timings["network"]}
                    for k, entry in enumerate(found.history)
                ]
            counters["refinement"] = outcome(found)
            timings["refinement"] = log.elapsed_s - timings["network"]
        record = network_result(
            self.name,
            resimulation,
            heights,
            reason=reason,
            history=history,
            timings=timings,
            counters=counters,
            settings=self.options.model_dump() | {"network": self.network.record},
            warnings=warnings,
            uncertainty=None if spread is None or no_spread else spread.cpu().numpy(),
            no_uncertainty=no_spread,
            found_at=found_at,
        )
        return record, answer

    def _no_uncertainty(self, answers: int) -> str:
        """Why a result of so many answers has no uncertainty; empty where it has one."""
        if answers < 2:
            why = "the run was cut short" if self.options.symmetries else "symmetries is off"
            return f"{why}: only answers of several symmetries tell how far they lie apart"
        few = self.network.few_steps
        if few is None:
            return ""
        return f"the network was trained for {few} steps only, and how far its answers lie apart tells nothing"

    @property
    def _trained_shift_px(self) -> float | None:
        """How far apart channels were in training [px of the scene]; None where the weights do not tell."""
        camera = self.network.training.get("camera")
        shift = camera.get("shift_px") if isinstance(camera, dict) else None
        return None if shift is None else float(shift) * self._pixels_of_one

    @property
    def _pixels_of_one(self) -> float:
        """The scene's pixels per side over the network's."""
        return self.scene.image_pixels / self.network.info.scene.image_pixels

    def _answers(self, image: CausticImage, log: RunLog) -> tuple[torch.Tensor, StopReason]:
        """Heights of each symmetry turned back, shape [B, n, n] [m]; ``interrupted`` or ``converged``."""
        seen, noise = self.grid.picture(image), self.grid.noise(image)
        if self.bench is not None:
            seen = self.bench.picture(seen)
        symmetries = all_symmetries(self.network.seen.scene if self.bench is None else self.bench.trained)
        if not self.options.symmetries:
            symmetries = symmetries[:, :1]
        n = self.scene.height_samples
        answers = torch.empty(0, n, n, device=self.device)
        batch = SYMMETRIES_AT_ONCE[self.device.type]
        log.total = -(-symmetries.shape[1] // batch)
        try:
            for part in symmetries.split(batch, dim=1):
                told = [self.bench.told(noise, part)] if self.bench is not None and self.is_told else []
                heights = self.replayed(seen_in(seen, part), *told)
                if self.bench is not None:
                    heights = heights * self.bench.height_scale
                answers = torch.cat([answers, self.grid.heights(turned_back(heights, part))])
                log.note("network", None, symmetries=len(answers))
        except KeyboardInterrupt as stop:
            return answers, why_stopped(stop)
        return answers, "converged"
