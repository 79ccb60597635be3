"""A relief for a picture: optimal transport, descent on the exact model, and a check by other light.

Limits: light must be collimated. One relief cannot bring all colours to one place: they part by about a hundredth of
the way that light is moved, and the picture is right in their mean. Diffraction and the extent of the source are not
in the model.
"""

import time
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch

from warp_caustics.design.advice import design_warnings
from warp_caustics.design.descent import Descent, design_levels
from warp_caustics.design.distance import at_distance, least_distance
from warp_caustics.design.judgement import picture_figures, relief_figures
from warp_caustics.design.limits import MARGIN
from warp_caustics.design.options import DesignOptions
from warp_caustics.design.start import carry_even_light, relief_of, start_cells
from warp_caustics.energy import energy_budget
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import ProgressCallback, StopReason
from warp_caustics.reconstruct.run_log import RunLog, why_stopped
from warp_caustics.reconstruct.transport.transport import note_step, why_carried
from warp_caustics.reconstruct.transport.transport_map import most_steps
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

CHECK_PATHS_PER_PIXEL = 3
"""Light paths per pixel and axis of the check, and one more per axis: the descent has two, so no path is the same."""


@dataclass(frozen=True)
class Design:
    """Result record.

    Attributes:
        scene: the set-up it was designed for, with its screen distance.
        heights_m: relief [m], lowest 0, shape [n, n].
        target: wanted irradiance in units of the radiosity, shape [m, m].
        image: caustic of the relief [W/m^2], simulated with other light paths than it was designed with,
            shape [n_w, m, m].
        check: arguments of the simulator that made ``image``.
        stop_reason: why the search ended.
        figures: see ``judgement.py``.
        history: one entry per iteration: stage, iteration, residual, loss, elapsed_s.
        timings_s: wall time per part [s].
        counters: what happened to the light, and how often what ran.
        settings: everything needed to repeat the run.
        warnings: what the user should know.
    """

    scene: Scene
    heights_m: FloatArray
    target: FloatArray
    image: FloatArray
    check: dict[str, Any]
    stop_reason: StopReason
    figures: dict[str, Any]
    history: list[dict[str, Any]] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    counters: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Designer:
    """Finds a relief for a picture.

    Args:
        scene: the set-up; its screen distance gives way to that of the options, or to the one chosen.
        options: see :class:`~warp_caustics.design.options.DesignOptions`.
        device: where to compute.

    Raises:
        InputError: light that is not collimated.
        ResourceError: the machine has no such device.
    """

    def __init__(self, scene: Scene, options: DesignOptions | None = None, device: str | torch.device = "cpu"):
        if not scene.is_collimated:
            raise InputError(
                f"a design needs collimated light, the scene has a cone of {scene.emission_half_angle_rad:g} rad; "
                "set scene.emission_half_angle_rad=0"
            )
        self.scene, self.options, self.device = scene, options or DesignOptions(), usable_device(device)

    def design(self, target: FloatArray, progress: ProgressCallback | None = None) -> Design:
        """Find the relief; Ctrl-C (KeyboardInterrupt) ends the search with the best so far.

        Args:
            target: irradiance in units of the radiosity, of mean 1, see
                :func:`~warp_caustics.design.target.target_irradiance`; shape [m, m].
            progress: called after every step; its residual is the mass error of the transport, then that of the image.

        Raises:
            InputError: a target of another shape, or that is no irradiance.
        """
        check_target_irradiance(target, self.scene)
        options = self.options
        cells = start_cells(self.scene, options.start_cells)
        levels = len(design_levels(self.scene, options))
        total = most_steps(cells, options.start_steps) + levels * options.max_iterations
        log = RunLog(total, progress, options.max_time_s)
        note = partial(note_step, log)
        transport = carry_even_light(target, cells, self.device, options.start_steps, note)
        distance_m = options.screen_distance_m or least_distance(transport, self.scene, options.max_height_m)
        scene = at_distance(self.scene, distance_m)
        start, limited = relief_of(transport, scene)
        timings = {"transport": log.elapsed_s}
        descent = Descent(target, start, scene, options, self.device, note)
        reason: StopReason = why_carried(transport)
        if transport.stop is None:
            try:
                reason = "converged" if descent.run() else "max_iterations"
            except KeyboardInterrupt as stop:
                reason = why_stopped(stop)
        timings["descent"] = log.elapsed_s - timings["transport"]
        counters = {
            "transport_steps": transport.steps,
            "transport_mass_error": transport.mass_error,
            "transport_limited_share": limited,
            "start_height_range_m": float(np.ptp(start)),
            "start_cells": cells,
            "evaluations": descent.evaluations,
        }
        return self._checked(target, scene, descent.heights(), reason, log, timings, counters)

    def _checked(
        self,
        target: FloatArray,
        scene: Scene,
        heights: FloatArray,
        reason: StopReason,
        log: RunLog,
        timings: dict[str, float],
        counters: dict[str, Any],
    ) -> Design:
        """The record of a relief, with its caustic by other light paths."""
        started = time.perf_counter()
        n_photons = (CHECK_PATHS_PER_PIXEL * scene.image_pixels + 1) ** 2
        simulator = CausticSimulator(scene, "lattice", n_photons=n_photons, device=self.device)
        found = torch.tensor(heights, dtype=torch.float32, device=self.device)
        with torch.no_grad():
            image = simulator(found).cpu().numpy()
        figures = {"picture": picture_figures(image, target, scene), "relief": relief_figures(heights, scene)}
        options = self.options
        needed_m = counters["start_height_range_m"] / (1 - 2 * MARGIN)
        return Design(
            scene=scene,
            heights_m=heights,
            target=target,
            image=image,
            check={"preset": "lattice", "n_photons": n_photons},
            stop_reason=reason,
            figures=figures,
            history=log.history,
            timings_s=timings | {"check": time.perf_counter() - started},
            counters=counters | {"energy": energy_budget(simulator, found)},
            settings=options.model_dump()
            | {
                "screen_distance_m": -scene.screen_position_m[2],
                "distance_was_chosen": options.screen_distance_m is None,
                "levels": design_levels(scene, options),
                "check": simulator.settings(),
            },
            warnings=tuple(design_warnings(figures, scene, options, needed_m)),
        )


def check_target_irradiance(target: FloatArray, scene: Scene) -> None:
    """Refuse what is no wanted irradiance.

    Raises:
        InputError: wrong shape, negative or not finite, or not of mean 1.
    """
    m = scene.image_pixels
    if target.shape != (m, m):
        raise InputError(f"target has shape {list(target.shape)}, the scene needs [{m}, {m}]; resample it")
    if not np.isfinite(target).all() or target.min() < 0:
        raise InputError("target is negative or not finite somewhere; give an irradiance")
    if abs(float(target.mean()) - 1) > 1e-6:
        raise InputError(f"target has mean {target.mean():g}, a plate sends as much light as falls on it; scale to 1")
