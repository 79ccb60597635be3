"""The loop that ``nsfc`` and ``nsfc-unrolled`` share: simulate, compare, let a network step, again."""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field

from nets.reconstruct.network_io import TRAINED_EXPOSURE_ERROR, network_image, network_result
from nets.reconstruct.refinement import Refinement, RefinementOptions, outcome
from nets.scene_match import working_scene
from nets.shipped import FoundNetwork
from warp_caustics.data_gradient import possible_heights
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor, StopReason
from warp_caustics.reconstruct.exposure import light_ratio, untreated_warning
from warp_caustics.reconstruct.pyramid import check_image, check_initial
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.run_log import RunLog, following, why_stopped
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray


class IterationOptions(RefinementOptions):
    """Settings of methods that iterate a network."""

    max_iterations: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Steps of the network; None takes as many as the method or the training says."""
    keep_iterates: bool = False
    """Keep the relief after every step in ``Reconstruction.iterates_m``."""
    seed: Annotated[int, Field(ge=0, lt=2**62)] = 0
    """Of random photons; no effect on a lattice."""


@dataclass
class Steps:
    """What a running iteration has found.

    Attributes:
        heights: current relief of each copy [m], shape [B, n, n].
        iterates: mean relief [m] before the first and after every step, where kept.
    """

    heights: torch.Tensor
    iterates: list[FloatArray] = field(default_factory=list)


class Iterated(Reconstructor):
    """A network iterated on its own answers.

    Args:
        scene: the set-up of the measurement.
        options: of the method.
        network: the updater.
        device: where to compute.
    """

    def __init__(self, scene: Scene, options: IterationOptions, network: FoundNetwork, device: str | torch.device):
        self.device = usable_device(device)
        self.scene, self.options, self.network = scene, options.on(self.device.type), network
        self.inner_scene = working_scene(scene, network.info.scene)
        self.simulator = CausticSimulator(scene, "lattice", device=self.device)
        self.refinement = Refinement(scene, options, self.device)

    @property
    @abstractmethod
    def iterations(self) -> int:
        """Steps to do."""

    @property
    @abstractmethod
    def used(self) -> dict[str, Any]:
        """Networks and photons, for the result's settings."""

    @abstractmethod
    def start(self, target: torch.Tensor, initial: FloatArray | None) -> torch.Tensor:
        """Heights to start from [m], shape [B, n, n]; ``target`` [n_w, m, m] in the network's brightness."""

    @abstractmethod
    def step(self, number: int, heights: torch.Tensor) -> tuple[torch.Tensor, float]:
        """Improved heights [m], shape [B, n, n], and the relative residual of those given."""

    @abstractmethod
    def mean(self, heights: torch.Tensor) -> torch.Tensor:
        """One relief [m], shape [n, n], of all copies."""

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        Ctrl-C and ``max_time_s`` end it with the last complete step. The residual of a history's entry is that
        before its step.
        """
        image = check_image(image, self.scene)
        if initial is not None:
            check_initial(initial, self.scene)
        log = RunLog(self.iterations, progress, self.options.max_time_s)
        resimulation = Resimulation(self.simulator, image)
        n = self.scene.height_samples
        flat = np.zeros((n, n)) if initial is None else initial
        steps = Steps(torch.as_tensor(flat, dtype=torch.float32, device=self.device)[None])
        reason = self._iterate(image, initial, steps, log)
        heights = as_glass(self.mean(steps.heights).cpu().numpy(), self.scene)
        timings = {"iteration": log.elapsed_s}
        told = untreated_warning(light_ratio(resimulation.measurement), self.name, TRAINED_EXPOSURE_ERROR)
        warnings = [*self.network.warnings, *([] if told is None else [told])]
        counters, found_at = dict[str, Any](steps=len(log.history), refinement="off"), None
        if self.options.refine and reason == "max_iterations":
            resimulation = resimulation.through(resimulation.found_camera(heights))
            counters["camera"] = resimulation.camera.record
            warnings += resimulation.camera.warnings(self.scene.wavelengths_m)
            after = following(progress, len(log.history), log.started, "refinement, ")
            found = self.refinement(resimulation, heights, timings["iteration"], after)
            if found is not None:
                heights, reason, found_at = found.heights, found.reason, found.found_at
            counters["refinement"] = outcome(found)
            timings["refinement"] = log.elapsed_s - timings["iteration"]
        return network_result(
            self.name,
            resimulation,
            heights,
            reason=reason,
            history=log.history,
            timings=timings,
            counters=counters,
            settings=self.options.model_dump() | self.used,
            warnings=warnings,
            iterates=np.stack(steps.iterates) if steps.iterates else None,
            found_at=found_at,
        )

    def _iterate(self, image: CausticImage, initial: FloatArray | None, steps: Steps, log: RunLog) -> StopReason:
        """Fill ``steps``; returns why it ended."""
        try:
            target = network_image(image, self.scene, self.network.info.scene, self.device)
            steps.heights = possible_heights(self.start(target, initial), self.scene)
            self._keep(steps)
            for number in range(self.iterations):
                found, residual = self.step(number, steps.heights)
                steps.heights = possible_heights(found, self.scene)
                self._keep(steps)
                log.note("network", residual, loss=residual**2 / 2)
        except KeyboardInterrupt as stop:
            return why_stopped(stop)
        return "max_iterations"

    def _keep(self, steps: Steps) -> None:
        if self.options.keep_iterates:
            steps.iterates.append(self.mean(steps.heights).double().cpu().numpy())


def relative(simulated: torch.Tensor, target: torch.Tensor) -> float:
    """||simulated - target|| / ||target|| over a batch of images."""
    return float((simulated - target).double().norm() / target.double().norm().clamp_min(1e-30))
