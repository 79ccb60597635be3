"""The refinement that ends a method with networks: a few steps of the height descent of ``refine``.

Down the exact model from a start that is nearly right: the network leaves the
edges of lines a little off, which the image shows clearly. Where a fold was
missed, descent does not find it (docs/refine.md), but small steps do little
harm; what does not lower the residual of all pixels is thrown away.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any, Self

import torch
from pydantic import Field

from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, StopReason
from warp_caustics.reconstruct.pyramid import level_sizes, measurement_at, simulator_at
from warp_caustics.reconstruct.refine.height_descent import HeightDescent
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.run_log import RunLog, note_evaluation, why_stopped
from warp_caustics.resampling import blur_matrices
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

DEFAULT_ITERATIONS = {"cpu": 105, "cuda": 360}
"""By device, within the time that people wait for; on a GPU 480 bring 18 own fields another 2 to 3 %, and they keep
improving to 960 (docs/learned.md)."""

TRUSTED_M = 2e-6
"""Spread of the network's answers [m] at which half a step of the refinement is taken. Bare plate, which the network
leaves 0.05 um wrong, a descent on an image with 1 % noise moves by 0.6 um (earlier weights)."""

TRUSTED_BESIDE_CAMERA_M = 12e-6
"""The same where a camera was found: what it does beyond a Gaussian blur is bent into the heights. A plate that the
network had right to 1.9 um was 2.5 um wrong with the spread above and is left as it was with this one, which costs
plates 9 to 18 um wrong 0.1 um of the 1.5 to 4.5 um that they gain (earlier weights)."""


LEAST_GAIN_BESIDE_CAMERA = 0.06
"""Share by which the residual must fall to keep a refinement where a camera was found. A plate right to 1.9 um, seen
with a blur of 1 px, became 2.4 um wrong while the residual fell by 5 %; plates 9 to 30 um wrong mostly fall by more."""


PHOTONS_PER_OWN_PIXEL = 2
"""Simulated by a CPU where all pixels are looked at, of which colour filters leave a third: half as many as usual."""


class RefinementOptions(Strict):
    """Settings of the refinement at the end, and of what every method with networks shares."""

    weights: str | None = None
    """Weights file; None takes a shipped one that knows the scene."""
    refine: bool = True
    """Whether to refine the network's answer at all."""
    refine_iterations: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """None: 105 on a CPU, each of which looks at one wavelength, 360 on a GPU."""
    refine_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size at which to refine; None: all pixels on a GPU, at most 2n on a CPU."""
    refine_step_m: Annotated[float, Field(gt=0, le=1e-4, allow_inf_nan=False)] = 8e-6
    """First step [m]."""
    max_time_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Stop after this time [s] with the best relief so far."""

    def on(self, device_type: str) -> Self:
        """With the number of iterations for a device."""
        iterations = self.refine_iterations or DEFAULT_ITERATIONS[device_type]
        return self.model_copy(update={"refine_iterations": iterations})

    def pixels_on(self, device_type: str, scene: Scene) -> int:
        """``refine_pixels``, or what ``refine`` takes as its finest on a device."""
        finest = RefineOptions().resolved("height", False, scene, device_type).finest_pixels
        assert finest is not None
        return self.refine_pixels or finest


@dataclass(frozen=True)
class SettledRelief:
    """A relief that nothing more is done to.

    Attributes:
        heights: refined or as it was [m], shape [n, n].
        found_at: pixels per side that had a say in it, which divide the image's; None for all.
        outcome: what became of its refinement.
    """

    heights: FloatArray
    found_at: int | None
    outcome: str


@dataclass(frozen=True)
class Refined:
    """What a refinement gave.

    Attributes:
        heights: relief [m], shape [n, n]: the better of start and refinement.
        is_better: whether that is the refinement.
        reason: why it ended.
        history: one entry per step.
        pixels: per side, at which it was made.
    """

    heights: FloatArray
    is_better: bool
    reason: StopReason
    history: list[dict[str, Any]]
    pixels: int

    @property
    def found_at(self) -> int | None:
        """Pixels per side that had a say in the heights; None for all, which a start that stays was compared with."""
        return self.pixels if self.is_better else None


class Refinement:
    """Refines reliefs of one scene, image after image.

    At one image size: from a start this near, coarser ones would only blur. At all pixels where colour filters left
    some to be made up: what is binned is partly made up everywhere.

    Args:
        scene: of the measurement.
        options: how long.
        device: where to simulate.
        scale: of the plate that the lengths above were chosen for over the scene's: refraction knows no length, and a
            scaled plate is refined as the other was. A step that the user gave is his own.
    """

    def __init__(self, scene: Scene, options: RefinementOptions, device: torch.device, scale: float = 1.0):
        self.scene, self.options, self.device, self.scale = scene, options.on(device.type), device, scale
        self.pixels = options.pixels_on(device.type, scene)
        level_sizes(scene.image_pixels, self.pixels, self.pixels)  # refuses a size that does not divide
        step = options.refine_step_m / (1.0 if "refine_step_m" in options.model_fields_set else scale)
        wished = RefineOptions(max_iterations=self.options.refine_iterations, step_m=step)
        self.refine = wished.resolved("height", False, scene, device.type)

    @cached_property
    def _descent(self) -> HeightDescent:
        return self._descending(simulator_at(self.scene, self.pixels, self.device))

    @cached_property
    def _descent_on_all(self) -> HeightDescent:
        """At all pixels."""
        photons = None if self.device.type == "cuda" else PHOTONS_PER_OWN_PIXEL
        return self._descending(simulator_at(self.scene, self.scene.image_pixels, self.device, photons))

    def _descending(self, simulator: CausticSimulator) -> HeightDescent:
        return HeightDescent(simulator, self.refine, in_turn=self.device.type == "cpu")

    def pixels_for(self, image: CausticImage) -> int:
        """Pixels per side at which an image is refined."""
        is_free = self.options.refine_pixels is None
        return self.scene.image_pixels if image.is_mosaic and is_free else self.pixels

    def __call__(
        self,
        resimulation: Resimulation,
        heights: FloatArray,
        elapsed_s: float,
        progress: ProgressCallback | None,
        spread: FloatArray | None = None,
    ) -> Refined | None:
        """Refine a relief; None where no time is left.

        Ctrl-C ends it with the best so far.

        Args:
            resimulation: of what was measured; judges by all pixels. With its camera: heights would else be bent to
                explain what that did (blur of 2 px: from 18 um of error to 23, with the camera to 15).
            heights: where to start [m], shape [n, n].
            elapsed_s: time already spent [s].
            progress: called after every step.
            spread: of the network's answers [m], shape [n, n]. Where it is small the network knows better than a
                descent on a noisy image; None trusts the descent everywhere.
        """
        left = None if self.options.max_time_s is None else self.options.max_time_s - elapsed_s
        if left is not None and left <= 0:
            return None
        pixels = self.pixels_for(resimulation.image)
        descent = self._descent if pixels == self.pixels else self._descent_on_all
        log = RunLog(descent.steps, progress, left, self.refine.discrepancy)
        before, camera = resimulation(heights).residual, resimulation.camera
        measurement = measurement_at(resimulation.image, self.scene, pixels, self.device, self.refine.border_pixels)
        blur = blur_matrices(pixels, camera.blur_at(pixels), self.device) if camera.blurs else None
        note = partial(note_evaluation, log, f"{pixels} x {pixels} pixels")
        reason: StopReason = "max_iterations"
        try:
            descent.run(measurement, heights, note, blur)
        except KeyboardInterrupt as stop:
            reason = why_stopped(stop)
        found = descent.best_heights()
        if spread is not None:
            trusted = (TRUSTED_M if camera.is_perfect else TRUSTED_BESIDE_CAMERA_M) / self.scale
            found = heights + (found - heights) * spread**2 / (spread**2 + trusted**2)
        least_gain = 0.0 if camera.is_perfect else LEAST_GAIN_BESIDE_CAMERA
        is_better = resimulation(found).residual < (1 - least_gain) * before
        return Refined(found if is_better else heights, is_better, reason, log.history, pixels)


def outcome(found: Refined | None) -> str:
    """What became of a refinement, for the record."""
    if found is None:
        return "no time left"
    return "kept" if found.is_better else "no better, discarded"
