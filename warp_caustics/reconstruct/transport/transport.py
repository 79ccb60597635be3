"""``transport``: heights from the optimal transport of light, in seconds and from no start.

Light of the flat plate is carried to the measured caustic by the optimal map
(``transport_map.py``), each point of the relief is given the slope that refracts
its light to where the map says (``ray_inversion.py``), and the slopes are
integrated (``integrate_normals.py``); since the way through the glass depends on
the height, the last two steps are repeated until the heights settle.

Limits: the optimal map never folds. Where light paths cross it is a different
map from the true one, and the relief is wrong there although its caustic is close.
"""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import scipy  # loads its parts when they are first used
import torch
from pydantic import Field

from warp_caustics.errors import InputError
from warp_caustics.height_field import basis_matrix, cell_centres, prefilter_matrix, sample_coordinate
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor, StopReason
from warp_caustics.reconstruct.pyramid import check_initial, usual_pixels
from warp_caustics.reconstruct.result import Resimulation, make_result
from warp_caustics.reconstruct.run_log import RunLog, why_stopped
from warp_caustics.reconstruct.transport.integrate_normals import heights_of, integrate_slopes, plate_bend
from warp_caustics.reconstruct.transport.light import Light, light_of, without_border
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.reconstruct.transport.transport_map import TransportMap, most_steps, optimal_transport
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

BARE_FRACTION = 0.2
"""At least this part of the plate is taken as bare, as ``refine`` does."""

BAD_MASS_ERROR = 0.05
"""Tab. 3 reliefs end below 0.03; more means that transport has not converged."""

FOLDED_RESIDUAL = 0.1
"""Mild reliefs end below 0.08; more means folds."""

SETTLED_M = 1e-9
"""Heights that change less have settled [m]."""

GEOMETRY_STEPS = 12

DEEPEST_OF_TRANSPORT = 0.5
"""Share of the plate's thickness: less than the ``DEEPEST_TRENCH`` of descents. Nothing here looks at the image of a
trench, which only a map that should have folded asks for, and the way through the glass, which slopes and heights are
found for in turn, must not all but vanish. The figures of docs/transport.md are with this."""

Baseline = Literal["smooth", "constant"]


class TransportOptions(Strict):
    """Settings of ``transport``."""

    cells: Annotated[int, Field(ge=4, le=2048)] | None = None
    """Grid of the transport, a divisor of the image; None: all pixels, at most twice as many as height samples."""
    max_iterations: Annotated[int, Field(ge=1)] = 20
    """Back-and-forth steps per grid, at most."""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-2
    """Share of the light to be moved that may be left misplaced; a grid is also left when steps gain nothing."""
    baseline: Baseline = "smooth"
    """Where zero is. smooth: on a smooth surface through the bare plate, see ``plate_bend``; constant: at the median
    of the lowest fifth of the plate."""
    max_time_s: Annotated[float, Field(gt=0)] | None = None
    """Stop the transport after this time [s] with the best map so far."""


def note_step(log: RunLog, stage: str, mass_error: float) -> None:
    """Record a step of the transport; its mass error stands for the residual.

    Raises:
        StopRun: the time is up.
    """
    log.note(stage, mass_error, loss=mass_error)


def why_carried(transport: TransportMap) -> StopReason:
    """Why a transport ended."""
    if transport.stop is not None:
        return why_stopped(transport.stop)
    return "converged" if transport.mass_error <= BAD_MASS_ERROR else "max_iterations"


class Transport(Reconstructor):
    """Optimal transport of light, exact refraction, integration of slopes.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`TransportOptions`.
        device: where to compute.
    """

    name = "transport"

    def __init__(self, scene: Scene, options: TransportOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or TransportOptions(), usable_device(device)
        self.cells = checked_cells(self.options.cells, scene, self.name)

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        From an initial relief its own caustic, not that of the flat plate, is carried to the measured one. Ctrl-C
        ends the transport with the best map so far. ``residual`` in progress and history is the mass error.
        """
        light = light_of(image, self.scene, self.cells)
        n = self.scene.height_samples
        if initial is not None:
            check_initial(initial, self.scene)
        start: FloatArray = np.zeros((n, n)) if initial is None else initial.astype(np.float64)
        options = self.options
        log = RunLog(most_steps(self.cells, options.max_iterations), progress, options.max_time_s)
        report = partial(note_step, log)
        transport = carry_light(light, start, self.device, options.max_iterations, options.tolerance, report)
        transport_s = log.elapsed_s
        targets = targets_of(transport, start, light.scene)
        heights, geometry = self._heights(targets, start, light.scene)
        geometry |= {"light_balance": light.balance, "exposure": light.exposure.tolist()}
        geometry |= {"mass_error": transport.mass_error, "steps": transport.steps}
        timings = {"transport": transport_s, "heights": log.elapsed_s - transport_s}
        warnings = [*light.warnings, *mass_warnings(transport)]
        if geometry["limited_share"] > 0:
            warnings.append(f"{geometry['limited_share']:.1%} of the light cannot be refracted as far as it should go")
        settings = options.model_dump() | {"cells": self.cells, "from_flat": not np.ptp(start)}
        return make_result(
            self.name,
            Resimulation(CausticSimulator(self.scene, "lattice", device=self.device), image, light.exposure),
            heights,
            reason=why_carried(transport),
            history=log.history,
            timings=timings,
            counters=geometry,
            settings=settings,
            warnings=warnings,
            advice=fold_advice,
        )

    def _heights(self, targets: FloatArray, start: FloatArray, scene: Scene) -> tuple[FloatArray, dict[str, Any]]:
        """Heights that send light to targets (x, y) [m], shape [2, N, N]; and what happened on the way."""
        path = LightPath.of_scene(scene)
        points = grid_points(self.cells, scene)
        heights, steps, change = start, 0, np.inf
        while change > SETTLED_M and steps < GEOMETRY_STEPS:
            fine, _ = relief_on_grid(heights, self.cells, scene.plate_size_m)
            slopes, limited = path.slopes_towards(points, fine, targets)
            raw = heights_of(integrate_slopes(slopes, scene.plate_size_m), scene.height_samples)
            base = self._baseline(raw, path)
            found = np.maximum(raw - base, -DEEPEST_OF_TRANSPORT * scene.base_thickness_m)
            change, heights, steps = float(np.abs(found - heights).max()), found, steps + 1
        counters = {"geometry_steps": steps, "geometry_change_m": change, "limited_share": limited}
        return heights, counters | {"removed_mean_m": float(base.mean()), "removed_bend_rms_m": float(base.std())}

    def _baseline(self, heights: FloatArray, path: LightPath) -> FloatArray:
        if self.options.baseline == "constant":
            return np.full_like(heights, np.quantile(heights, BARE_FRACTION / 2))
        return plate_bend(heights, self.scene.plate_size_m, (1 - 1 / path.glass) * self.scene.base_thickness_m)


def checked_cells(cells: int | None, scene: Scene, method: str) -> int:
    """Grid of the transport for a scene.

    Raises:
        InputError: no divisor of the image.
    """
    if cells is not None:
        if scene.image_pixels % cells:
            raise InputError(f"{method}.cells: {cells} does not divide {scene.image_pixels} pixels; use a divisor")
        return cells
    return usual_pixels(scene)


def carry_light(
    light: Light,
    start: FloatArray,
    device: torch.device,
    max_steps: int,
    tolerance: float,
    report: Callable[[str, float], None] | None,
) -> TransportMap:
    """Transport from the caustic of a relief [m], shape [n, n], to the measured light."""
    simulator = CausticSimulator(light.scene, "lattice", device=device)
    with torch.no_grad():
        simulated = simulator(torch.tensor(start, dtype=torch.float32, device=device)).double().mean(0)
    source = torch.as_tensor(without_border(simulated.cpu().numpy()), device=device)
    target = torch.as_tensor(light.density, device=device)
    return optimal_transport(source, target, max_steps=max_steps, tolerance=tolerance, report=report)


def targets_of(transport: TransportMap, start: FloatArray, scene: Scene) -> FloatArray:
    """Where light of each cell must land: where relief ``start`` sends it, and on by the map; [m], shape [2, N, N]."""
    displacement = transport.displacement_px.cpu().numpy()
    cells = displacement.shape[1]
    fine, slopes = relief_on_grid(start, cells, scene.plate_size_m)
    landing = LightPath.of_scene(scene).landing(grid_points(cells, scene), fine, slopes)
    # Totally reflected light has no place yet; it may start below its point.
    landing = np.where(np.isfinite(landing), landing, grid_points(cells, scene))
    coordinates = [
        ((landing[axis] - scene.screen_position_m[axis]) / scene.plate_size_m[axis] + 0.5) * cells - 0.5
        for axis in (1, 0)
    ]
    moved = [
        scipy.ndimage.map_coordinates(displacement[axis], coordinates, order=1, mode="nearest")
        * (scene.plate_size_m[axis] / cells)
        for axis in (0, 1)
    ]
    targets: FloatArray = landing + np.stack(moved)
    return targets


def grid_points(cells: int, scene: Scene) -> FloatArray:
    """(x, y) of the centres of the plate's cells [m], shape [2, N, N]."""
    return np.stack(np.meshgrid(*(cell_centres(cells, length) for length in scene.plate_size_m)))


def relief_on_grid(heights: FloatArray, cells: int, plate_size_m: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """The relief's spline [m], shape [N, N], and its slopes, shape [2, N, N], at the centres of cells."""
    n = len(heights)
    prefilter = prefilter_matrix(n)
    coefficients = prefilter @ heights @ prefilter.T
    u = sample_coordinate(cell_centres(cells, 1.0), n, 1.0)
    value, derivative = basis_matrix(n, u, 0), basis_matrix(n, u, 1)
    along_x = value @ coefficients @ derivative.T * (n / plate_size_m[0])
    along_y = derivative @ coefficients @ value.T * (n / plate_size_m[1])
    return value @ coefficients @ value.T, np.stack([along_x, along_y])


def mass_warnings(transport: TransportMap) -> list[str]:
    """What the user should know of a transport."""
    if transport.mass_error <= BAD_MASS_ERROR:
        return []
    return [
        f"transport has not converged: {transport.mass_error:.1%} of the light is misplaced, above "
        f"{BAD_MASS_ERROR:.0%}; raise max_iterations, or check the image"
    ]


def fold_advice(residual: float) -> Iterator[str]:
    """What a relative residual tells of a relief that was found by transport."""
    if residual > FOLDED_RESIDUAL:
        yield (
            f"{residual:.0%} of the image is left unexplained: where light paths cross, transport finds another "
            "relief; take it as a start for a method that knows folds"
        )


def transport_initial(
    scene: Scene,
    image: CausticImage,
    device: str | torch.device = "cpu",
    progress: ProgressCallback | None = None,
) -> Reconstruction:
    """A starting relief for any other method, from the image alone.

    Args:
        scene: the set-up of the measurement.
        image: the measured caustic.
        device: where to compute.
        progress: called after every step.

    Returns:
        The result of ``transport`` with its default options; ``heights_m`` is the start.
    """
    return Transport(scene, device=device).reconstruct(image, progress=progress)


def with_initial(result: Reconstruction, start: Reconstruction) -> Reconstruction:
    """A result whose record says which method made its start, and what it had to say."""
    described = {"method": start.method, "settings": start.settings, "counters": start.counters}
    return dataclasses.replace(
        result,
        settings=result.settings | {"initial": described},
        timings_s={"initial": sum(start.timings_s.values())} | result.timings_s,
        warnings=(*(f"start: {warning}" for warning in start.warnings), *result.warnings),
    )
