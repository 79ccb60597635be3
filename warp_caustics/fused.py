"""A photon from surface to pixels in one kernel, and back."""

from typing import Any

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.determinism import is_deterministic
from warp_caustics.kernels import MAP_NAMES, dtype_of
from warp_caustics.kernels.blocks import BLOCK, PLACE_PLANES, block_adjoint_kernel, block_kernel
from warp_caustics.kernels.fused import fused_kernels, unpack_kernel
from warp_caustics.kernels.fused_adjoint import fused_adjoint_kernels
from warp_caustics.kernels.native import PACK, WARP_LANES
from warp_caustics.kernels.row_refraction import PLANES
from warp_caustics.optics import Optics
from warp_caustics.photons import PhotonPlan
from warp_caustics.scene import Profile

WIDE_SIGMA_PX = 0.8
"""Photons with footprints wider than this on a flat plate come cell by cell; several GPU threads share each."""

WIDE_LANES = 8
"""Threads that share the columns of a wide footprint; neighbours then write to neighbouring pixels. The adjoint
only reads, and does better with fewer (:data:`WIDE_ADJOINT_LANES`)."""

WIDE_ADJOINT_LANES = 2
"""Of a wide footprint in the adjoint, where there is no thread for each wavelength."""

DEFERRED_LANES = 32
"""Threads per footprint on the list of deferred ones."""

DEFERRED_DIM = 4096, DEFERRED_LANES
"""How many of these are worked on at a time, and their threads."""

GPU_BLOCK = 64
"""Threads of a block: with their hundred registers each a GPU holds a fifth more of them than in blocks of 256."""

BY_WAVELENGTH = 2**18, 2**21
"""Adjoints of at most so many photons, over the batch, have a thread for each wavelength: more fill a GPU by
themselves, and their surface would be found once per wavelength. The second number is for wide footprints."""

MAX_BLOCKS = 2**23
"""Blocks of rows on the list of deferred ones, at most."""

PACKED_ARCH = 90
"""GPUs from this compute capability on add 16 bytes at once."""


class FusedPhotons:
    """Launches ``kernels/fused.py`` and its adjoint, or ``kernels/blocks.py``, in the variant that suits the device.

    Attributes:
        is_wide: footprints of a flat plate cover many pixels; on a GPU several threads share each.
        defers: wide footprints are listed, for a launch with many threads each.
        width: wavelengths added together: on GPUs all of two to four in float32, otherwise 1. Whole numbers are added
            one by one, and three at once take 1.3 to 1.5 times as long on an H200.
        lanes, adjoint_lanes: threads that share a footprint.
        max_blocks: room on the list of deferred blocks.
        in_blocks: ``kernels/blocks.py`` instead, on a CPU.
        is_fixed: sums are the same whatever the order of photons and threads: light in fixed point, gradients in order.
    """

    def __init__(self, optics: Optics, plan: PhotonPlan, device: torch.device, dtype: torch.dtype, profile: Profile):
        scene, self.device = optics.scene, device
        self.channels, self.pixels = scene.n_wavelengths, scene.image_pixels
        self.warp_device = wp.device_from_torch(device)
        self._dtype = dtype_of(torch.finfo(dtype).bits)
        self._variant = self._dtype, profile, plan.placement == "lattice"
        self._effects = optics.effects
        self.defers = device.type == "cuda"
        self.is_fixed = device.type == "cuda" and is_deterministic()
        self._steps, self._torch_dtype = optics.steps, dtype
        self.is_wide = optics.flat_sigma_px > WIDE_SIGMA_PX
        is_shared = self.defers and self.is_wide
        packs = self.defers and not self.is_fixed and dtype == torch.float32 and 2 <= self.channels <= PACK
        self.width = self.channels if packs and self.warp_device.arch >= PACKED_ARCH else 1
        self.lanes = WIDE_LANES if is_shared and self.width == 1 and not self.is_fixed else 1
        self.adjoint_lanes = WIDE_ADJOINT_LANES if is_shared else 1
        self.max_blocks = MAX_BLOCKS
        self.in_blocks = device.type == "cpu" and plan.placement != "lattice"

    def image_shape(self, batch: int) -> tuple[int, ...]:
        """Shape of the sums that :meth:`splat` adds to."""
        m = self.pixels
        return (batch, m, m, PACK) if self.width > 1 else (batch, self.channels, m, m)

    @property
    def sum_dtype(self) -> torch.dtype:
        """Type of those sums."""
        return torch.int64 if self.is_fixed else self._torch_dtype

    def unpacked(self, total: torch.Tensor) -> torch.Tensor:
        """Image [B, n_w, m, m] of a sum of the above shape."""
        if self.is_fixed:
            # A power of two: only the conversion rounds.
            return total.to(self._torch_dtype).div_(self._steps)
        if self.width == 1:
            return total
        batch, m, _, _ = total.shape
        image = total.new_empty(batch, self.channels, m, m)
        with warp_stream(self.device):
            self._launch(unpack_kernel(self._dtype), (batch, m, m), [warp_array(total)], [warp_array(image)])
        return image

    def splat(self, coefficients: torch.Tensor, photons: Any, image: torch.Tensor) -> None:
        """Add photons to an image of shape :meth:`image_shape`.

        Args:
            coefficients: of the relief, [B, n + 4, n + 4].
            photons: struct ``Photons`` of a chunk; a lattice by its axes.
            image: [W/m^2].
        """
        batch, inputs = coefficients.shape[0], [warp_array(coefficients), photons]
        if self.in_blocks and self.lanes == self.width == 1 and not self.defers and not self.is_fixed:
            kernel = block_kernel(*self._variant[:2], self._effects)
            self._launch(kernel, self._blocks(batch, photons), [*inputs, *self._scratch()], [warp_array(image)])
            return
        kernels = fused_kernels(*self._variant, self.width, self.lanes, self.defers, self._effects, self.is_fixed)
        is_packed = self.width > 1
        size = min(batch * photons.count, self.max_blocks) if is_packed else batch * photons.count * self.channels
        listed = self._list(size, 2 if is_packed else 1)
        outputs = [warp_array(image)]
        self._launch(kernels.splat_photons, (batch, photons.count, self.lanes), inputs, [*outputs, *listed])
        if self.defers:
            wide = fused_kernels(*self._variant, self.width, DEFERRED_LANES, False, self._effects, self.is_fixed)
            self._launch(wide.splat_deferred, DEFERRED_DIM, [*inputs, DEFERRED_DIM[0], *listed], outputs)

    def splat_adjoint(self, coefficients: torch.Tensor, photons: Any, grad_image: torch.Tensor) -> torch.Tensor:
        """Gradient with respect to the surface maps [B, 6, N] of photons, from that of the image [B, n_w, m, m]."""
        batch = coefficients.shape[0]
        shape = batch, len(MAP_NAMES), photons.count
        by_wavelength = self.defers and not self.is_fixed and batch * photons.count <= BY_WAVELENGTH[self.is_wide]
        lanes = 1 if by_wavelength else self.adjoint_lanes
        is_added = by_wavelength or lanes > 1
        grad_maps = coefficients.new_zeros(shape) if is_added else coefficients.new_empty(shape)
        inputs = [warp_array(coefficients), photons, warp_array(grad_image)]
        if self.in_blocks and self.adjoint_lanes == 1 and not self.defers and not self.is_fixed:
            kernel = block_adjoint_kernel(*self._variant[:2], self._effects)
            self._launch(kernel, self._blocks(batch, photons), [*inputs, *self._scratch()], [warp_array(grad_maps)])
            return grad_maps
        variant = self._effects, self.is_fixed
        kernels = fused_adjoint_kernels(*self._variant, lanes, self.defers, *variant, by_wavelength)
        listed = self._list(batch * photons.count * self.channels, 1)
        outputs = [warp_array(grad_maps)]
        dim = (batch, self.channels, photons.count) if by_wavelength else (batch, photons.count, lanes)
        self._launch(kernels.splat_photons_adjoint, dim, inputs, [*outputs, *listed])
        if self.defers:
            wide = fused_adjoint_kernels(*self._variant, DEFERRED_LANES, False, *variant)
            self._launch(wide.splat_deferred_adjoint, DEFERRED_DIM, [*inputs, DEFERRED_DIM[0], *listed], outputs)
        return grad_maps

    def _launch(self, kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]) -> None:
        block = GPU_BLOCK if self.device.type == "cuda" else 256
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.warp_device, block_dim=block)

    def _blocks(self, batch: int, photons: Any) -> tuple[int, int]:
        """Blocks of photons over each relief."""
        return batch, -(-photons.count // BLOCK)

    def _scratch(self) -> list[Any]:
        """Memory for what is known of a block; what no photon writes is zero."""
        return [warp_array(torch.zeros(planes, BLOCK, dtype=self._torch_dtype)) for planes in (PLACE_PLANES, PLANES)]

    def _list(self, size: int, columns: int) -> list[Any]:
        """Room for deferred footprints, or for blocks of their rows, and how many there are."""
        size = size if self.defers else 1
        listed = torch.empty(size, columns, dtype=torch.int32, device=self.device)
        count = torch.zeros(1, dtype=torch.int32, device=self.device)
        return [wp.from_torch(listed), wp.from_torch(count)]


# Fixed sums rely on it: two terms are the same in either order, and the threads of a warp are added in one.
assert WIDE_ADJOINT_LANES <= 2
assert DEFERRED_LANES == WARP_LANES
