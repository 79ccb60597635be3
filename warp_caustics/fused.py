"""The fast path for collimated light: a photon from surface to pixels in one kernel."""

from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.kernels import MAP_NAMES
from warp_caustics.kernels.fused_adjoint import fused_adjoint_kernels
from warp_caustics.kernels.fused_splat import fused_splat_kernels
from warp_caustics.kernels.packed import PACK, unpack_kernel
from warp_caustics.kernels.packed_splat import packed_splat_kernels
from warp_caustics.photons import Chunk

if TYPE_CHECKING:
    from warp_caustics.engine import Engine

WIDE_SIGMA_PX = 0.8
"""Footprints wider than this on a flat plate are shared by several GPU threads."""

WIDE_LANES, WIDE_ADJOINT_LANES = 8, 2
"""Threads that share the columns of a wide footprint; neighbours then write to neighbouring pixels. The adjoint
only reads, and does better with fewer."""

DEFERRED_LANES, DEFERRED_GROUPS = 32, 4096
"""Threads per footprint on the list of deferred ones, and how many of these are worked on at a time."""
MAX_BLOCKS = 2**23
"""Blocks of rows on the list of deferred ones, at most."""

PACKED_ARCH = 90
"""GPUs from this compute capability on add 16 bytes at once."""


class FusedPhotons:
    """Launches the fused kernels for an engine; see ``kernels/fused_splat.py`` and ``fused_adjoint.py``.

    On GPUs, two to four channels in float32 are added together; see ``kernels/packed.py``. The adjoint only reads, and
    is slower that way.
    """

    def __init__(self, engine: "Engine"):
        self.engine = engine
        self.is_lattice = engine.plan.placement == "lattice"
        self.defers = engine.device.type == "cuda"
        wide = engine.optics.sigma0 * engine.optics.pixels_per_m_x > WIDE_SIGMA_PX
        self.is_wide = wide and self.defers
        self.lanes, self.adjoint_lanes = (WIDE_LANES, WIDE_ADJOINT_LANES) if self.is_wide else (1, 1)
        variant = engine.warp_dtype, engine.profile
        here, there = (self.is_lattice, self.defers), (self.is_lattice, False)
        self.kernels = fused_splat_kernels(*variant, self.lanes, *here)
        self.adjoint_kernels = fused_adjoint_kernels(*variant, self.adjoint_lanes, *here)
        self.deferred = fused_splat_kernels(*variant, DEFERRED_LANES, *there)
        self.deferred_adjoint = fused_adjoint_kernels(*variant, DEFERRED_LANES, *there)
        self._axes: dict[Chunk, torch.Tensor] = {}
        channels = engine.scene.n_wavelengths
        packs = self.defers and engine.dtype == torch.float32 and 2 <= channels <= PACK
        packs = packs and engine.warp_device.arch >= PACKED_ARCH
        self.packs = packs
        self.max_blocks = MAX_BLOCKS
        self._packed_variant = *variant, channels, DEFERRED_LANES, self.is_lattice

    @cached_property
    def packed(self) -> SimpleNamespace:
        """Kernels of the packed image."""
        return packed_splat_kernels(*self._packed_variant)

    def _inputs(self, coefficients: torch.Tensor, chunk: Chunk) -> list[Any]:
        engine = self.engine
        pitch_x, pitch_y = engine.scene.sample_pitch_m
        positions = self._lattice_axes(chunk) if self.is_lattice else engine.positions(chunk)
        columns = engine.plan.columns if self.is_lattice else 0
        return [
            warp_array(coefficients),
            warp_array(positions),
            chunk.count,
            columns,
            1 / pitch_x,
            1 / pitch_y,
            engine.scene.height_samples,
            warp_array(engine.eta),
            warp_array(engine.ratio),
            warp_array(engine.radiosity),
            engine.optics,
        ]

    def _lattice_axes(self, chunk: Chunk) -> torch.Tensor:
        """x of all columns and y of the chunk's rows [m], shape [2, max(columns, rows)]."""
        if chunk not in self._axes:
            engine, plan = self.engine, self.engine.plan
            axes = torch.zeros(2, max(plan.columns, chunk.rows), dtype=torch.float64)
            axes[0, : plan.columns] = torch.from_numpy(plan.grid_x)
            axes[1, : chunk.rows] = torch.from_numpy(plan.grid_y[chunk.first_row : chunk.first_row + chunk.rows])
            self._axes[chunk] = axes.to(engine.device, engine.dtype)
        return self._axes[chunk]

    def image_shape(self, batch: int) -> tuple[int, ...]:
        """Shape of the sums that :meth:`splat` adds to."""
        m, channels = self.engine.scene.image_pixels, self.engine.scene.n_wavelengths
        return (batch, m, m, PACK) if self.packs else (batch, channels, m, m)

    def unpacked(self, total: torch.Tensor) -> torch.Tensor:
        """Image [B, n_w, m, m] of a sum of the above shape."""
        if not self.packs:
            return total
        batch, m, _, _ = total.shape
        image = total.new_empty(batch, self.engine.scene.n_wavelengths, m, m)
        with warp_stream(self.engine.device):
            wp.launch(
                unpack_kernel(self.engine.warp_dtype),
                dim=(batch, m, m),
                inputs=[warp_array(total)],
                outputs=[warp_array(image)],
                device=self.engine.warp_device,
            )
        return image

    def splat(self, coefficients: torch.Tensor, chunk: Chunk, image: torch.Tensor) -> None:
        """Add a chunk of photons to an image of shape :meth:`image_shape`; coefficients [B, n + 4, n + 4]."""
        inputs = self._inputs(coefficients, chunk)
        if self.packs:
            lists = self._block_lists(coefficients.shape[0] * chunk.count)
            wp.launch(
                self.packed.splat_photons,
                dim=(coefficients.shape[0], chunk.count),
                inputs=inputs,
                outputs=[warp_array(image), *lists],
                device=self.engine.warp_device,
            )
            wp.launch(
                self.packed.splat_deferred,
                dim=(DEFERRED_GROUPS, DEFERRED_LANES),
                inputs=[*inputs, DEFERRED_GROUPS, *lists],
                outputs=[warp_array(image)],
                device=self.engine.warp_device,
            )
            return
        lists = self._lists(coefficients.shape[0] * chunk.count)
        wp.launch(
            self.kernels.splat_photons,
            dim=(coefficients.shape[0], chunk.count, self.lanes),
            inputs=inputs,
            outputs=[warp_array(image), *lists],
            device=self.engine.warp_device,
        )
        if self.defers:
            wp.launch(
                self.deferred.splat_deferred,
                dim=(DEFERRED_GROUPS, DEFERRED_LANES),
                inputs=[*inputs, DEFERRED_GROUPS, *lists],
                outputs=[warp_array(image)],
                device=self.engine.warp_device,
            )

    def splat_adjoint(self, coefficients: torch.Tensor, chunk: Chunk, grad_image: torch.Tensor) -> torch.Tensor:
        """Gradient with respect to the surface maps [B, 6, N] of a chunk, from that of the image [B, n_w, m, m]."""
        shape = (coefficients.shape[0], len(MAP_NAMES), chunk.count)
        grad_maps = coefficients.new_zeros(shape) if self.adjoint_lanes > 1 else coefficients.new_empty(shape)
        inputs = [*self._inputs(coefficients, chunk), warp_array(grad_image)]
        lists = self._lists(coefficients.shape[0] * chunk.count)
        wp.launch(
            self.adjoint_kernels.splat_photons_adjoint,
            dim=(coefficients.shape[0], chunk.count, self.adjoint_lanes),
            inputs=inputs,
            outputs=[warp_array(grad_maps), *lists],
            device=self.engine.warp_device,
        )
        if self.defers:
            wp.launch(
                self.deferred_adjoint.splat_deferred_adjoint,
                dim=(DEFERRED_GROUPS, DEFERRED_LANES),
                inputs=[*inputs, DEFERRED_GROUPS, *lists],
                outputs=[warp_array(grad_maps)],
                device=self.engine.warp_device,
            )
        return grad_maps

    def _lists(self, photons: int) -> list[Any]:
        """Room for every footprint on the list of deferred ones, and their number."""
        size = photons * self.engine.scene.n_wavelengths if self.defers else 1
        deferred = torch.empty(size, dtype=torch.int32, device=self.engine.device)
        count = torch.zeros(1, dtype=torch.int32, device=self.engine.device)
        return [wp.from_torch(deferred), wp.from_torch(count)]

    def _block_lists(self, photons: int) -> list[Any]:
        """Room for deferred blocks of rows, and their number; what finds no room is not deferred."""
        size = min(photons, self.max_blocks)
        deferred = torch.empty(size, 2, dtype=torch.int32, device=self.engine.device)
        count = torch.zeros(1, dtype=torch.int32, device=self.engine.device)
        return [wp.from_torch(deferred), wp.from_torch(count)]
