"""``hcccd``: high-contrast caustic design, used backwards to measure. Our re-implementation of a published scheme.

Schwartzburg, Testuz, Tagliasacchi, Pauly, "High-contrast computational caustic
design", SIGGRAPH 2014: an optimal map from the light of the flat plate to the
caustic; from it a normal per vertex of a mesh; vertices moved until the mesh has
these normals; the last two in turn, since a vertex that moved sees its target
under another angle. As others who measure plates with it do, light is refracted
once: from the relief it goes straight to the screen, through glass all the way.

Normal integration: vertices x, their rays d, the wanted unit normals N and the graph Laplacian L,

    min_x  sum |n(x) - N|^2 + a sum |x - proj_d x|^2 + b sum |L x|^2 + c sum max(0, -log(1 + z - z_0))^2,

the paper's integration, direction, regularisation and barrier energies; its flux term is left out, as in the code that
others published.

Departures: transport by our grid solver instead of power diagrams; as many vertices as cells of that grid (256 x 256
for Tab. 1, 287 x 287 published), since the weight of smoothness depends on their number; and each inner minimisation
starts at the exact integral of the wanted slopes, because L-BFGS alone hardly moves slow modes; the minimum is the
same.

Limits: only a weak barrier holds the mean height of the vertices, so the base of the plate drifts; by how much is
reported (``base_drift_m``), and left in the heights. Folds are out of reach, as for ``transport``; a screen at some
distance in air is, too, because of the single refraction.
"""

from functools import partial
from typing import Annotated

import numpy as np
import scipy  # loads its parts when they are first used
import torch
from pydantic import Field

from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
from warp_caustics.reconstruct.pyramid import check_initial
from warp_caustics.reconstruct.result import Resimulation, make_result
from warp_caustics.reconstruct.run_log import RunLog, why_stopped
from warp_caustics.reconstruct.transport.integrate_normals import heights_of, integrate_slopes
from warp_caustics.reconstruct.transport.light import Light, light_of
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.reconstruct.transport.transport import (
    BARE_FRACTION,
    DEEPEST_OF_TRANSPORT,
    carry_light,
    checked_cells,
    fold_advice,
    grid_points,
    mass_warnings,
    note_step,
    relief_on_grid,
    targets_of,
    why_carried,
)
from warp_caustics.reconstruct.transport.transport_map import most_steps
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

TRANSPORT_STEPS, TRANSPORT_TOLERANCE = 20, 1e-2

INNER_STEPS = 50
"""L-BFGS steps per outer iteration, at most."""

INNER_TOLERANCE = 1e-5
"""Published stop of the inner minimisation."""

BARRIER_SLACK = 1e-3
"""Published: the barrier begins so far below the bare plate (0.104 above the screen, the plate 0.105), in half plate
sizes: 25 um for Tab. 1."""

MAX_GAP = 0.01
"""Beyond this share of the thickness, a gap of another medium below the plate matters."""


class HcccdOptions(Strict):
    """Settings of ``hcccd``; weights as published, lengths in half plate sizes (2.5 cm)."""

    cells: Annotated[int, Field(ge=4, le=2048)] | None = None
    """Grid of transport and vertices, a divisor of the image; None: all pixels, at most twice the height samples."""
    max_iterations: Annotated[int, Field(ge=1)] = 10
    """Outer iterations: target normals, then normal integration."""
    settled_m: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1e-6
    """Stop when no vertex moves further [m]; published: 2.5e-4, coarser than most reliefs."""
    ray_weight: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 5e3
    """Weight of the squared distance of a vertex from its ray."""
    smoothness: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 5e3
    """Weight of the squared graph Laplacian."""
    barrier: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0
    """Weight of what keeps vertices above the plate, less a slack."""
    max_time_s: Annotated[float, Field(gt=0)] | None = None
    """Stop after this time [s] with the best relief so far."""


class Hcccd(Reconstructor):
    """Transport, target normals, normal integration over 3D vertices, single refraction.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`HcccdOptions`.
        device: where to compute.
    """

    name = "hcccd"

    def __init__(self, scene: Scene, options: HcccdOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or HcccdOptions(), usable_device(device)
        self.cells = checked_cells(self.options.cells, scene, self.name)

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        From an initial relief its own caustic, not that of the flat plate, is carried to the measured one. Ctrl-C ends
        it with the last finished outer iteration.
        """
        light = light_of(image, self.scene, self.cells)
        n, options = self.scene.height_samples, self.options
        if initial is not None:
            check_initial(initial, self.scene)
        start: FloatArray = np.zeros((n, n)) if initial is None else initial.astype(np.float64)
        total = most_steps(self.cells, TRANSPORT_STEPS) + options.max_iterations
        log = RunLog(total, progress, options.max_time_s)
        report = partial(note_step, log)
        transport = carry_light(light, start, self.device, TRANSPORT_STEPS, TRANSPORT_TOLERANCE, report)
        transport_s = log.elapsed_s
        surface = _Surface(self, light, start, targets_of(transport, start, light.scene))
        reason = why_carried(transport)
        try:
            if reason in ("max_iterations", "converged"):
                reason = "converged" if surface.alternate(log) else "max_iterations"
            else:
                surface.iterate()
        except KeyboardInterrupt as stop:
            reason = why_stopped(stop)
        heights = surface.heights()
        drift = surface.base_m()
        counters = {"mass_error": transport.mass_error, "steps": transport.steps, "light_balance": light.balance}
        counters["exposure"] = light.exposure.tolist()
        counters |= {"outer_iterations": surface.iterations, "base_drift_m": drift}
        counters |= {"sideways_m": surface.sideways_m(), "last_move_m": surface.moved_m}
        warnings = [*light.warnings, *mass_warnings(transport), *surface.warnings]
        warnings.append(f"the base of the plate drifted by {drift * 1e6:.3g} um; hcccd does not know the mean height")
        timings = {"transport": transport_s, "integration": log.elapsed_s - transport_s}
        settings = options.model_dump() | {"cells": self.cells, "from_flat": not np.ptp(start)}
        return make_result(
            self.name,
            Resimulation(CausticSimulator(self.scene, "lattice", device=self.device), image, light.exposure),
            heights,
            reason=reason,
            history=log.history,
            timings=timings,
            counters=counters,
            settings=settings,
            warnings=warnings,
            advice=fold_advice,
        )


class _Surface:
    """Vertices, moved until their normals send light to the targets.

    Lengths inside are in half plate sizes, as the published weights want it; shapes [3, N, N] and [2, N, N].
    """

    def __init__(self, method: Hcccd, light: Light, start: FloatArray, targets: FloatArray):
        self.method, self.light, self.targets = method, light, targets
        self.scene, self.options = light.scene, method.options
        self.path = LightPath.of_scene(self.scene, single_refraction=True)
        self.unit_m = max(self.scene.plate_size_m) / 2
        self.points = grid_points(method.cells, self.scene)
        height, _ = relief_on_grid(start, method.cells, self.scene.plate_size_m)
        self.vertices: FloatArray = (
            np.concatenate([self.points, (self.scene.base_thickness_m + height)[None]]) / self.unit_m
        )
        self.iterations, self.moved_m = 0, np.inf
        self.warnings: list[str] = []
        exact = LightPath.of_scene(self.scene)
        if exact.outside != exact.glass and exact.gap_m > MAX_GAP * exact.thickness_m:
            self.warnings.append(
                f"the screen is {exact.gap_m:g} m below the plate and hcccd ignores the refraction at its bottom face; "
                "use transport"
            )
        simulated = self.scene.model_copy(update={"image_pixels": method.cells})
        self.simulator = CausticSimulator(simulated, "lattice", device=method.device)

    def heights(self) -> FloatArray:
        """Relief at the height samples [m], shape [n, n]."""
        fine = self.vertices[2] * self.unit_m - self.scene.base_thickness_m
        spectrum: FloatArray = scipy.fft.dctn(fine, norm="ortho")
        return np.maximum(
            heights_of(spectrum, self.scene.height_samples), -DEEPEST_OF_TRANSPORT * self.scene.base_thickness_m
        )

    def base_m(self) -> float:
        """Height of the bare plate [m], by the rule of ``transport``; 0 is where it was built."""
        return float(np.quantile(self.heights(), BARE_FRACTION / 2))

    def sideways_m(self) -> float:
        """How far the farthest vertex has left its start sideways [m]."""
        return float(np.abs(self.vertices[:2] * self.unit_m - self.points).max())

    def alternate(self, log: RunLog) -> bool:
        """Target normals and normal integration in turn; True once the vertices have settled."""
        for _ in range(self.options.max_iterations):
            before, moved_before = self.vertices, self.moved_m
            self.iterate()
            if self.moved_m > 2 * moved_before:
                self.vertices = before
                self.warnings.append(
                    f"the surface diverged after {self.iterations} iterations; the one before is returned"
                )
                return False
            residual = self._residual()
            stage = f"normals, {self.method.cells} x {self.method.cells} vertices"
            log.note(stage, residual, loss=residual, base_m=self.base_m(), moved_m=self.moved_m)
            if self.moved_m <= self.options.settled_m:
                return True
        return False

    def iterate(self) -> None:
        """One outer iteration."""
        heights = self.vertices[2] * self.unit_m - self.scene.base_thickness_m
        points = self.vertices[:2] * self.unit_m
        slopes, _ = self.path.slopes_towards(points, heights, self.targets)
        normals = np.concatenate([-slopes, np.ones_like(slopes[:1])])
        normals /= np.sqrt((normals**2).sum(0))
        integral = heights_of(integrate_slopes(slopes, self.scene.plate_size_m), self.method.cells)
        # The integral leaves the mean open; it stays where it is.
        guess = np.concatenate([self.points, (integral + self.scene.base_thickness_m + heights.mean())[None]])
        sideways, down = self.path.incident(points, heights)
        rays = np.concatenate([sideways, down[None]])
        found = self._integrated(guess / self.unit_m, normals, rays)
        self.moved_m = float(np.abs(found - self.vertices).max()) * self.unit_m
        self.vertices = found
        self.iterations += 1

    def _residual(self) -> float:
        """Relative residual of the image on the grid of the transport."""
        device = self.method.device
        found = torch.tensor(self.heights(), dtype=torch.float32, device=device)
        with torch.no_grad():
            image = self.simulator(found).double().mean(0).cpu().numpy()
        return float(np.linalg.norm(image - self.light.density) / np.linalg.norm(self.light.density))

    def _integrated(self, guess: FloatArray, normals: FloatArray, rays: FloatArray) -> FloatArray:
        """Vertices of least energy, from a guess."""
        device = self.method.device
        wanted, ray, origin = (
            torch.as_tensor(array, dtype=torch.float64, device=device) for array in (normals, rays, guess)
        )
        # A step of 1 must be a move that normals notice: a fraction of the distance of vertices.
        pitch = 2.0 / self.method.cells
        move = torch.zeros_like(origin, requires_grad=True)
        descent = torch.optim.LBFGS(
            [move],
            max_iter=INNER_STEPS,
            tolerance_change=INNER_TOLERANCE,
            line_search_fn="strong_wolfe",
            history_size=10,
        )
        lowest = self.scene.base_thickness_m / self.unit_m - BARRIER_SLACK

        def energy() -> torch.Tensor:
            descent.zero_grad()
            value = vertex_energy(origin + pitch * move, origin, wanted, ray, lowest, self.options)
            value.backward()
            return value

        descent.step(energy)
        found = (origin + pitch * move).detach()
        return found.cpu().numpy() if bool(torch.isfinite(found).all()) else guess


def vertex_energy(
    vertices: torch.Tensor,
    on_ray: torch.Tensor,
    wanted: torch.Tensor,
    ray: torch.Tensor,
    lowest: float,
    options: HcccdOptions,
) -> torch.Tensor:
    """Published energy of the normal integration: normals, rays, graph Laplacian, barrier; all shapes [3, N, N]."""
    normals = vertex_normals(vertices)
    offset = vertices - on_ray
    off_ray = offset - (offset * ray).sum(0) * ray
    padded = torch.nn.functional.pad(vertices[None], (1, 1, 1, 1), mode="replicate")[0]
    neighbours = padded[:, 2:, 1:-1] + padded[:, :-2, 1:-1] + padded[:, 1:-1, 2:] + padded[:, 1:-1, :-2]
    # At the edges, plain differences would pull the vertices inwards: sideways, only inner vertices count.
    laplacian = neighbours - 4 * vertices
    inner = laplacian[:2, 1:-1, 1:-1]
    near = torch.relu(-torch.log((1 + vertices[2] - lowest).clamp_min(1e-6)))
    value = (normals - wanted).square().sum() + options.ray_weight * off_ray.square().sum()
    value = value + options.smoothness * (laplacian[2].square().sum() + inner.square().sum())
    return value + options.barrier * near.square().sum()


def vertex_normals(vertices: torch.Tensor) -> torch.Tensor:
    """Unit normals from the neighbours on either side, one side at the edges; shape [3, N, N]."""
    padded = torch.nn.functional.pad(vertices[None], (1, 1, 1, 1), mode="replicate")[0]
    along_x = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    along_y = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    normal = torch.linalg.cross(along_x, along_y, dim=0)
    unit: torch.Tensor = normal / torch.linalg.vector_norm(normal, dim=0)
    return unit
