"""``direct``: heights from the image by one network, averaged over symmetries, then refined on the exact model."""

import dataclasses
import time
from typing import Annotated, Any

import torch
from pydantic import Field

from nets.reconstruct.polish import Polish, PolishOptions, outcome
from nets.reconstruct.record import Resimulation, as_glass, finished, network_image
from nets.reconstruct.symmetries import all_symmetries, seen_in, turned_back
from nets.reconstruct.uncertainty import DIRECT, uncertainty
from nets.replayed import Replayed
from nets.shipped import find_network
from warp_caustics.reconstruct.base import (
    CausticImage,
    Progress,
    ProgressCallback,
    Reconstruction,
    Reconstructor,
    StopReason,
)
from warp_caustics.reconstruct.pyramid import check_image, check_initial
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

BATCH = {"cpu": 4, "cuda": 8}
"""Symmetries at a time."""


class DirectOptions(PolishOptions):
    """Settings of ``direct``."""

    symmetries: bool = True
    """Mean over all turns and flips that the scene has: more exact, and the source of the uncertainty."""
    max_iterations: Annotated[int, Field(ge=1)] | None = None
    """Of the refinement, in place of ``refine_iterations``: what --max-iterations sets."""


class Direct(Reconstructor):
    """Network, symmetries, refinement.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`DirectOptions`.
        device: where to compute.

    Raises:
        InputError: no network is shipped, or no such file.
        MismatchError: the network is for another scene.
    """

    name = "direct"

    def __init__(self, scene: Scene, options: DirectOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or DirectOptions(), usable_device(device)
        if self.options.max_iterations is not None:
            self.options = self.options.model_copy(update={"refine_iterations": self.options.max_iterations})
        self.options = self.options.on(self.device.type)
        self.network = find_network("direct", scene, path=self.options.weights, device=self.device)
        self.network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.replayed = Replayed(self.network.module)
        self.simulator = CausticSimulator(scene, "lattice", device=self.device)
        self.polish = Polish(scene, self.options, self.device)

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
        check_image(image, self.scene)
        warnings = list(self.network.warnings)
        if initial is not None:
            check_initial(initial, self.scene)
            warnings.append("direct takes no start, the given one is not used; --method refine does")
        started = time.perf_counter()
        resimulation = Resimulation(self.simulator, image).exposed()
        answers, history, interrupted = self._answers(resimulation.image, started, progress)
        n = self.scene.height_samples
        mean = answers.mean(0).cpu().numpy() if len(answers) else torch.zeros(n, n).numpy()
        heights = as_glass(mean, self.scene)
        if not interrupted:
            resimulation = resimulation.exposed(heights)
        spread = uncertainty(answers.double(), DIRECT)
        timings = {"network": time.perf_counter() - started}
        counters: dict[str, Any] = {"symmetries": len(answers), "refinement": "off"}
        if not interrupted:
            resimulation = resimulation.through(resimulation.found_camera(heights))
            counters["camera"] = resimulation.camera.record
            warnings += resimulation.camera.warnings(self.scene.wavelengths_m, self._trained_shift_px)
        reason: StopReason = "interrupted" if interrupted else "converged"
        if self.options.refine and not interrupted:
            found = self.polish(
                resimulation,
                heights,
                timings["network"],
                _after(progress, history, started),
                None if spread is None else spread.cpu().numpy() / DIRECT.scale,
            )
            reason = "max_time"
            if found is not None:
                heights, reason = found.heights, found.reason
                history += [
                    entry | {"iteration": len(history) + k + 1, "elapsed_s": entry["elapsed_s"] + timings["network"]}
                    for k, entry in enumerate(found.history)
                ]
            counters["refinement"] = outcome(found)
            timings["refinement"] = time.perf_counter() - started - timings["network"]
        return finished(
            self.name,
            resimulation,
            heights,
            reason=reason,
            history=history,
            timings=timings,
            counters=counters,
            settings=self.options.model_dump() | {"network": self.network.record},
            warnings=warnings,
            uncertainty=None if spread is None else spread.cpu().numpy(),
        )

    @property
    def _trained_shift_px(self) -> float | None:
        """How far apart channels were in training [px]; None where the weights do not tell."""
        camera = self.network.training.get("camera")
        shift = camera.get("shift_px") if isinstance(camera, dict) else None
        return None if shift is None else float(shift)

    def _answers(
        self, image: CausticImage, started: float, progress: ProgressCallback | None
    ) -> tuple[torch.Tensor, list[dict[str, Any]], bool]:
        """Heights of each symmetry turned back, shape [B, n, n] [m]; history; whether Ctrl-C came."""
        seen = network_image(image, self.scene, self.network.info.scene, self.device)
        symmetries = all_symmetries(self.scene)
        if not self.options.symmetries:
            symmetries = symmetries[:, :1]
        n = self.scene.height_samples
        answers, history = torch.empty(0, n, n, device=self.device), list[dict[str, Any]]()
        batch = BATCH[self.device.type]
        try:
            for part in symmetries.split(batch, dim=1):
                heights = self.replayed(seen_in(seen, part))
                answers = torch.cat([answers, turned_back(heights, part)])
                elapsed = time.perf_counter() - started
                entry = {"stage": "network", "iteration": len(history) + 1, "residual": None, "elapsed_s": elapsed}
                history.append(entry | {"symmetries": len(answers)})
                if progress is not None:
                    steps = -(-symmetries.shape[1] // batch)
                    progress(Progress("network", len(history), steps, float("nan"), elapsed))
        except KeyboardInterrupt:
            return answers, history, True
        return answers, history, False


def _after(progress: ProgressCallback | None, history: list[dict[str, Any]], started: float) -> ProgressCallback | None:
    """A callback that counts iterations and time on from what was done before."""
    if progress is None:
        return None
    before, report = len(history), progress

    def shifted(state: Progress) -> None:
        report(
            dataclasses.replace(
                state,
                stage=f"refinement, {state.stage.split(', ')[-1]}",
                iteration=before + state.iteration,
                total=before + state.total,
                elapsed_s=time.perf_counter() - started,
            )
        )

    return shifted
