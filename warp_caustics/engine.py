"""Stages of the simulation on torch tensors, forward and adjoint.

    heights --spline--> surface maps --trace--> footprint records --splat--> image

The first stage is linear: matrix products for a photon lattice (its adjoint
then needs no atomics), a 4 x 4 gather otherwise. Photons are handled in chunks
of bounded memory. Images and their adjoints run all stages of a photon in one
kernel (``fused.py``); the stages one by one are for tapes, tests and accounts of light.
"""

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp

from warp_caustics.chunked import CHUNK_BYTES, sum_over_chunks, warp_array, warp_stream
from warp_caustics.cuda_graph import Replays
from warp_caustics.extremes import Extremes
from warp_caustics.fused import FusedPhotons
from warp_caustics.gathered_adjoint import gathered_adjoint, gathered_in_order
from warp_caustics.height_field import MARGIN
from warp_caustics.kernels import MAP_NAMES, RECORD_NAMES, dtype_of
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.kernels.second_hits import second_hits_kernel
from warp_caustics.kernels.splat import splat_kernels
from warp_caustics.kernels.surface import surface_kernels
from warp_caustics.kernels.trace import trace_kernels
from warp_caustics.landings import Landings
from warp_caustics.lattice_rows import LatticeRows
from warp_caustics.optics import Optics
from warp_caustics.photons import Chunk, PhotonPlan, sorted_by_cell
from warp_caustics.relief_bounds import bounds_of
from warp_caustics.scene import Profile, Scene
from warp_caustics.spline_stage import SplineStage

MAX_GRAPH_PHOTONS = 2**22
"""Simulations of at most so many photons, over the batch, are replayed as CUDA graphs."""

MAX_KEPT_PHOTONS = 2**25
"""Positions of at most so many photons are kept between calls."""


class Engine:
    """Arrays and kernels of one scene, photon plan, device and precision.

    Heights are shape [B, n, n] [m], images [B, n_w, m, m] [W/m^2], both of the
    engine's dtype on its device and contiguous.
    """

    def __init__(
        self,
        scene: Scene,
        plan: PhotonPlan,
        smoothing: float,
        profile: Profile,
        device: torch.device,
        dtype: torch.dtype,
    ):
        self.scene, self.plan, self.smoothing, self.profile = scene, plan, smoothing, profile
        self.device, self.dtype = device, dtype
        start_warp()
        self.warp_device = wp.device_from_torch(device)
        self.warp_dtype = dtype_of(torch.finfo(dtype).bits)
        self.spline = SplineStage(plan, self._tensor)
        self.optics = Optics([scene], plan, smoothing, profile, device, dtype)
        self._positions: dict[Chunk, torch.Tensor] = {}
        self._photons: dict[tuple[int, int], Any] = {}
        self._axes: dict[Chunk, torch.Tensor] = {}
        self._lattices: dict[Chunk, Any] = {}
        self._replays = Replays()
        self._ends = -0.999 * scene.base_thickness_m, 1.0

    def _tensor(self, values: Any) -> torch.Tensor:
        return torch.as_tensor(values, dtype=self.dtype, device=self.device).contiguous()

    def on(self, scenes: Sequence[Scene], spectra: torch.Tensor | None = None) -> "Engine":
        """The same plate, photons and window on another bench: a fifth of a millisecond instead of ten.

        Args:
            scenes: one, or one for each relief of a batch, all with the same effects; of the same plate size, numbers
                of samples, pixels and wavelengths.
            spectra: as of :class:`Optics`.

        Spline matrices and starting points of photons are shared.
        """
        if self.plan.placement == "lattice":
            _ = self.rows  # made once, and by the first
        other = copy.copy(self)
        for name in ("in_double_precision", "fused", "tracer"):
            other.__dict__.pop(name, None)
        other.scene = scenes[0]
        other.optics = Optics(scenes, self.plan, self.smoothing, self.profile, self.device, self.dtype, spectra)
        other._photons, other._lattices, other._replays = {}, {}, Replays()
        return other

    @cached_property
    def in_double_precision(self) -> "Engine":
        """The same engine in float64."""
        if self.dtype == torch.float64:
            return self
        return Engine(self.scene, self.plan, self.smoothing, self.profile, self.device, torch.float64)

    # -- kernels of single stages, made when somebody asks for them

    @cached_property
    def surface(self) -> SimpleNamespace:
        return surface_kernels(self.warp_dtype)

    @cached_property
    def tracer(self) -> SimpleNamespace:
        return trace_kernels(self.warp_dtype, self.optics.effects)

    @cached_property
    def splatter(self) -> SimpleNamespace:
        return splat_kernels(self.warp_dtype, self.profile, self.device.type == "cpu")

    # -- the linear stage -------------------------------------------------------------------------------------

    @property
    def prefilter(self) -> torch.Tensor:
        """From height samples to spline coefficients along one axis, shape [n + 4, n]."""
        return self.spline.prefilter

    def coefficients(self, heights: torch.Tensor) -> torch.Tensor:
        """Spline coefficients [B, n + 4, n + 4] [m] of heights [B, n, n] [m]."""
        spline = self.spline
        if self.rows is not None and not spline.by_blocks:
            return self.rows.filtered(heights, spline.prefilter, spline.prefilter_transposed, self.optics)
        return spline.coefficients(heights)

    def coefficients_adjoint(self, grad: torch.Tensor) -> torch.Tensor:
        """Adjoint of :meth:`coefficients`."""
        spline = self.spline
        if self.rows is not None and not spline.by_blocks:
            return self.rows.filtered(grad, spline.prefilter_transposed, spline.prefilter, self.optics)
        return spline.coefficients_adjoint(grad)

    def maps(self, coefficients: torch.Tensor, chunk: Chunk, positions: torch.Tensor) -> torch.Tensor:
        """Surface maps [B, 6, N] (MAP_NAMES) of a chunk of photons."""
        batch = coefficients.shape[0]
        if self.plan.placement != "lattice":
            maps = coefficients.new_empty(batch, len(MAP_NAMES), chunk.count)
            wp.launch(
                self.surface.gather_surface,
                dim=(batch, chunk.count),
                inputs=[warp_array(coefficients), self.photons(positions)],
                outputs=[warp_array(maps)],
                device=self.warp_device,
            )
            return maps
        return self.spline.maps(coefficients, chunk).reshape(batch, len(MAP_NAMES), chunk.count)

    def maps_adjoint(self, coefficients: torch.Tensor, chunk: Chunk, grad_maps: torch.Tensor) -> torch.Tensor:
        """Adjoint of :meth:`maps`: gradient with respect to the coefficients [B, n + 4, n + 4]."""
        if self.plan.placement != "lattice":
            shape, photons = tuple(coefficients.shape), self.photons(self.positions(chunk))
            if self.fused.is_fixed:
                return gathered_in_order(shape, photons, grad_maps, self.scene.sample_pitch_m)
            return gathered_adjoint(shape, photons, grad_maps)
        planes = grad_maps.view(grad_maps.shape[0], len(MAP_NAMES), chunk.rows, self.plan.columns)
        return self.spline.maps_adjoint(planes, chunk)

    # -- trace and splat --------------------------------------------------------------------------------------

    def clear_paths(self, coefficients: torch.Tensor, photons: Any, *, is_lattice: bool = False) -> torch.Tensor:
        """Which paths do not meet the relief again: 1 for those, uint8, shape [B, n_w, N].

        Args:
            coefficients: of the relief [m], shape [B, n + 4, n + 4].
            photons: struct ``Photons``.
            is_lattice: whether that holds the axes of a lattice.
        """
        batch = coefficients.shape[0]
        clear = torch.empty(batch, self.scene.n_wavelengths, photons.count, dtype=torch.uint8, device=self.device)
        bounds = bounds_of(coefficients, self.scene.sample_pitch_m)
        wp.launch(
            second_hits_kernel(self.warp_dtype, is_lattice, self.optics.effects),
            dim=(batch, photons.count),
            inputs=[warp_array(coefficients), photons, warp_array(bounds)],
            outputs=[warp_array(clear)],
            device=self.warp_device,
            record_tape=False,
        )
        return clear

    def told(self, coefficients: torch.Tensor, photons: Any, *, is_lattice: bool = False) -> Any:
        """Struct ``Photons`` that knows which paths are lost because they meet the relief again, where that matters."""
        if not self.optics.effects.second_hits:
            return photons
        return self.optics.with_clear(photons, self.clear_paths(coefficients, photons, is_lattice=is_lattice))

    def records(self, maps: torch.Tensor, positions: torch.Tensor, photons: Any = None) -> torch.Tensor:
        """Footprint records [B, n_w, 6, N] (RECORD_NAMES) of surface maps [B, 6, N].

        ``photons`` are those at the positions, if more is known of them: see :meth:`told`.
        """
        batch, _, count = maps.shape
        records = maps.new_empty(batch, self.scene.n_wavelengths, len(RECORD_NAMES), count)
        wp.launch(
            self.tracer.trace,
            dim=(batch, self.scene.n_wavelengths, count),
            inputs=[warp_array(maps), photons or self.photons(positions)],
            outputs=[warp_array(records)],
            device=self.warp_device,
        )
        return records

    def splat(self, records: torch.Tensor, image: torch.Tensor) -> None:
        """Add the footprints of records [B, n_w, 6, N] to image [B, n_w, m, m]."""
        wp.launch(
            self.splatter.splat,
            dim=(records.shape[0], records.shape[1], records.shape[3]),
            inputs=[warp_array(records)],
            outputs=[warp_array(image)],
            device=self.warp_device,
        )

    def land(self, maps: torch.Tensor, positions: torch.Tensor, photons: Any = None) -> Landings:
        """Where light of surface maps [B, 6, N] lands, and what becomes of it on the way."""
        batch, _, count = maps.shape
        channels = self.scene.n_wavelengths
        landings = maps.new_empty(batch, channels, 2, count)
        energies = maps.new_empty(batch, channels, count)
        shares = torch.empty_like(energies)
        fates = torch.empty(batch, channels, count, dtype=torch.int32, device=self.device)
        wp.launch(
            self.tracer.land,
            dim=(batch, channels, count),
            inputs=[warp_array(maps), photons or self.photons(positions)],
            outputs=[warp_array(landings), warp_array(energies), warp_array(shares), warp_array(fates)],
            device=self.warp_device,
        )
        return Landings(landings, energies, shares, fates)

    # -- everything -------------------------------------------------------------------------------------------

    @cached_property
    def fused(self) -> FusedPhotons:
        """All stages of a photon in one kernel."""
        return FusedPhotons(self.optics, self.plan, self.device, self.dtype, self.profile)

    @cached_property
    def rows(self) -> LatticeRows | None:
        """Splines on a lattice on a CPU go row by row."""
        is_here = self.device.type == "cpu" and self.plan.placement == "lattice" and self.profile == "spline"
        return LatticeRows(self.plan, self.dtype) if is_here else None

    def reseed(self, seed: int, role: str) -> None:
        """Take another photon set of the same size; recorded graphs keep reading the same memory."""
        self.plan = replace(self.plan, seed=seed, role=role)
        self.__dict__.pop("in_double_precision", None)
        with warp_stream(self.device):
            for chunk, kept in self._positions.items():
                kept.copy_(self._new_positions(chunk))

    def positions(self, chunk: Chunk) -> torch.Tensor:
        """Starting points of a chunk [m], shape [N, 2]; kept between calls unless they are very many."""
        if self.plan.count > MAX_KEPT_PHOTONS:
            return self._new_positions(chunk)
        if chunk not in self._positions:
            kept = self._positions[chunk] = self._new_positions(chunk)
            self._photons[kept.data_ptr(), len(kept)] = self.optics.photons(kept)
        return self._positions[chunk]

    def photons(self, positions: torch.Tensor) -> Any:
        """What kernels are told about photons at these positions [N, 2] [m]: struct ``Photons``."""
        key = positions.data_ptr(), len(positions)
        kept = self._photons.get(key)
        if kept is None:
            kept = self.optics.photons(positions)
            if self.plan.count <= MAX_KEPT_PHOTONS:
                # Positions are kept and stay where they are; another bench's engine has made them.
                self._photons[key] = kept
        return kept

    def fused_photons(self, chunk: Chunk, coefficients: torch.Tensor) -> Any:
        """The same for a chunk, a relief and the fused kernels, which know a lattice by its axes."""
        if self.plan.placement != "lattice":
            return self.told(coefficients, self.photons(self.positions(chunk)))
        if chunk not in self._lattices:
            if chunk not in self._axes:
                self._axes[chunk] = self.plan.axes(chunk, self.dtype, self.device)
            self._lattices[chunk] = self.optics.photons(self._axes[chunk], chunk.count, self.plan.columns)
        if self.rows is not None:
            return self._lattices[chunk]  # rows look for lost paths themselves
        return self.told(coefficients, self._lattices[chunk], is_lattice=True)

    def _new_positions(self, chunk: Chunk) -> torch.Tensor:
        positions = self.plan.positions(chunk, self.dtype, self.device)
        if self.plan.is_grid or self.plan.count > MAX_KEPT_PHOTONS:
            return positions
        # Wide footprints then share cache lines, and threads of a GPU that run together lines, cells and sums. Cells in
        # order would collide there.
        is_gpu = self.device.type == "cuda"
        if is_gpu or self.fused.is_wide:
            return sorted_by_cell(positions, self.scene, is_spread=is_gpu)
        return positions

    def parts(self, batch: int) -> Iterator[Chunk]:
        """Chunks of photons for a batch of height fields in bounded memory."""
        return self.plan.chunks(max(1, CHUNK_BYTES[self.device.type] // self._bytes_per_photon(batch)))

    def chunks(self, batch: int) -> Iterator[tuple[Chunk, torch.Tensor]]:
        """The same with their positions [N, 2]."""
        return ((chunk, self.positions(chunk)) for chunk in self.parts(batch))

    def _bytes_per_photon(self, batch: int) -> int:
        planes = len(MAP_NAMES) + self.scene.n_wavelengths
        return batch * planes * self.dtype.itemsize

    def image(self, heights: torch.Tensor, extremes: Extremes | None = None) -> torch.Tensor:
        """Irradiance [B, n_w, m, m] [W/m^2] of heights [B, n, n] [m].

        Args:
            heights: possible ones. Where extremes tell, they may be no numbers, or lower than the plate is thick; of
                such comes an image that means nothing.
            extremes: on a GPU, asked for the heights', which are to be read next; always the same ones.
        """
        name, batch = "image", len(heights)
        inputs: tuple[torch.Tensor, ...] = (heights,)
        call: Callable[..., torch.Tensor] = self._image
        if extremes is not None and self.spline.by_blocks:
            extremes.find(heights)
            name, call = "guarded image", self._guarded_image
        elif extremes is not None:
            extremes.ask(heights)
            name, call, inputs = "asked image", lambda: self._asked_image(batch, extremes), ()
        return self._replays((name, batch), call, *inputs) if self._is_small(heights) else call(*inputs)

    def change(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Images of reliefs [B, n, n] [m] less those of others, [B, n, n] or [1, n, n]: [B, n_w, m, m] [W/m^2]."""
        if self.rows is None or self.optics.effects.many_benches:
            return self.image(second) - self.image(first)
        coefficients, changes = self.coefficients(first), self.coefficients(second - first)
        return self.rows.change(coefficients, changes, self.fused_photons, self.optics)

    def image_adjoint(self, heights: torch.Tensor, grad_image: torch.Tensor) -> torch.Tensor:
        """Gradient [B, n, n] with respect to the heights from that with respect to the image [B, n_w, m, m]."""
        if self._is_small(heights):
            return self._replays(("adjoint", len(heights)), self._image_adjoint, heights, grad_image)
        return self._image_adjoint(heights, grad_image)

    def _is_small(self, heights: torch.Tensor) -> bool:
        """Whether starting the launches one by one would take longer than running them."""
        return self.device.type == "cuda" and heights.shape[0] * self.plan.count <= MAX_GRAPH_PHOTONS

    def _image(self, heights: torch.Tensor) -> torch.Tensor:
        return self.image_of(self.coefficients(heights))

    def _guarded_image(self, heights: torch.Tensor) -> torch.Tensor:
        """The same of heights that may be anything: kernels are not told what is no number."""
        return self.image_of(self.spline.coefficients(heights, self._ends))

    def _asked_image(self, batch: int, extremes: Extremes) -> torch.Tensor:
        """The same of those that extremes are asked of, and tells these."""
        return self.image_of(self.spline.asked_coefficients(batch, extremes, self._ends))

    def _image_adjoint(self, heights: torch.Tensor, grad_image: torch.Tensor) -> torch.Tensor:
        return self.adjoint_of(self.coefficients(heights), grad_image)

    def image_of(self, coefficients: torch.Tensor) -> torch.Tensor:
        """Irradiance [B, n_w, m, m] [W/m^2] of :meth:`coefficients`; launches one by one."""
        if self.rows is not None:
            return self.rows.image(coefficients, self.fused_photons, self.optics)
        fused = self.fused

        def add(image: torch.Tensor, chunk: Chunk) -> None:
            fused.splat(coefficients, self.fused_photons(chunk, coefficients), image)

        return fused.unpacked(self._sum(fused.image_shape(coefficients.shape[0]), add, fused.sum_dtype))

    def adjoint_of(self, coefficients: torch.Tensor, grad_image: torch.Tensor) -> torch.Tensor:
        """Gradient [B, n, n] with respect to the heights whose :meth:`coefficients` these are; likewise."""
        if self.rows is not None:
            grad = self.rows.image_adjoint(coefficients, self.fused_photons, self.optics, grad_image)
            return self.coefficients_adjoint(grad)
        fused = self.fused

        def add(grad: torch.Tensor, chunk: Chunk) -> None:
            grad_maps = fused.splat_adjoint(coefficients, self.fused_photons(chunk, coefficients), grad_image)
            grad += self.maps_adjoint(coefficients, chunk, grad_maps)

        return self.coefficients_adjoint(self._sum(tuple(coefficients.shape), add, self.dtype))

    def _sum(
        self, shape: tuple[int, ...], add: Callable[[torch.Tensor, Chunk], None], dtype: torch.dtype
    ) -> torch.Tensor:
        return sum_over_chunks(self.plan, self._bytes_per_photon(shape[0]), shape, dtype, self.device, add)


assert MARGIN == 2  # the gather kernel's index arithmetic relies on it
