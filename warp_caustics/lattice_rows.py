"""Lattice photons on a CPU: strips of rows on all cores, through ``kernels/rows.py``."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from warp_caustics.chunked import MIN_CHUNK_PHOTONS, on_all_cores, warp_array
from warp_caustics.height_field import REACH_OF_BITS, sample_coordinate
from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.row_refraction import PLANES
from warp_caustics.kernels.row_surface import CELL_PLANES
from warp_caustics.kernels.rows import row_adjoint_kernel, row_kernels
from warp_caustics.kernels.vectors import LANES
from warp_caustics.optics import Optics
from warp_caustics.photons import Chunk, PhotonPlan
from warp_caustics.relief_bounds import bounds_of

PhotonsOf = Callable[[Chunk, torch.Tensor], Any]
"""Struct ``Photons`` of a chunk, over reliefs with these coefficients."""

STRIPS = 16
"""Strips of rows that a lattice is cut into, whatever the number of cores: more would use more of them."""

CHANGES = 4
"""Reliefs whose changes are a core's work at a time, at most; fewer if there are less than of strips."""

TOUCHED = 1e-3
"""Of the largest change of a spline's coefficients, below which photons are taken to stay where they are: coefficients
fall by 0.27 from sample to sample beside a change of heights."""

BATCH_BYTES = 64 * 2**20
"""Images of at most so much memory are summed at a time; every strip touches a part of its own copy."""


class LatticeRows:
    """Images and gradients of whole lattices: strips of rows on all cores, their sums added in order."""

    def __init__(self, plan: PhotonPlan, dtype: torch.dtype):
        n = plan.scene.height_samples
        self._plan, self._dtype, self._kind = plan, dtype, dtype_of(torch.finfo(dtype).bits)
        u = sample_coordinate(plan.grid_x, n, plan.scene.plate_size_m[0])
        cell = np.clip(np.floor(u).astype(int), -1, n - 1)
        # Blocks of photons are read and written whole: so many more are read beyond the last one.
        self._padded = -(-plan.columns // LANES) * LANES + LANES
        across = np.zeros((2, self._padded))
        across[:, : plan.columns] = np.stack([u - cell, plan.grid_x])
        self._across = torch.from_numpy(across).to(dtype)
        """Place in its cell, and x [m], of each column."""
        self._first = torch.from_numpy(np.searchsorted(cell, np.arange(-1, n + 1)).astype(np.int32))
        """First photon of each cell, shape [n + 2]."""
        rows = max(-(-plan.rows // STRIPS), -(-MIN_CHUNK_PHOTONS // plan.columns))
        self._strips = list(plan.chunks(rows * plan.columns))
        self._taps = [_taps_of(strip, plan) for strip in self._strips]

    def change(
        self, coefficients: torch.Tensor, changes: torch.Tensor, photons_of: PhotonsOf, optics: Optics
    ) -> torch.Tensor:
        """Irradiance of reliefs less that of others [W/m^2], shape [B, n_w, m, m].

        Only photons that a change touches are looked at, of each row those from the first to the last: of light from
        elsewhere that meets the relief again no more or less is lost. A relief's are a core's work, which adds to no
        image but its own.

        Args:
            coefficients: of the others [m], shape [B, n + 4, n + 4], or of one, [1, n + 4, n + 4].
            changes: of what the reliefs are higher [m], shape [B, n + 4, n + 4].
            photons_of: struct ``Photons`` of a chunk, by the lattice's axes.
            optics: as of :meth:`image`; of one bench.
        """
        channels, m, plan = optics.scene.n_wavelengths, optics.scene.image_pixels, self._plan
        image = _zeros(len(changes), channels, m, m, dtype=self._dtype)
        touched = torch.from_numpy(_touched(changes.numpy()))
        kernel = row_kernels(self._kind, optics.effects).splat_changes
        everything = Chunk(0, plan.count, 0, plan.rows)
        # Asked for once: cores that made them at the same time would free what another one reads.
        photons = photons_of(everything, coefficients)
        at_once = min(CHANGES, -(-len(changes) // STRIPS))

        def add(begin: int) -> None:
            some = slice(begin, begin + at_once)
            first = coefficients if len(coefficients) == 1 else coefficients[some]
            both, part = torch.cat([first, first + changes[some]]), image[some]
            # All rows are set to zero already: none wait for whoever comes to them first.
            rows = torch.tensor([[0, m]] * len(part), dtype=torch.int32)
            inputs = [warp_array(touched[some]), photons, warp_array(_bounds(both, optics))]
            outputs = [warp_array(part), wp.from_torch(rows, return_ctype=True)]
            self._launch(kernel, both, len(part), everything, inputs, outputs)

        for _ in on_all_cores(add, range(0, len(changes), at_once)):
            pass
        return image

    def image(self, coefficients: torch.Tensor, photons_of: PhotonsOf, optics: Optics) -> torch.Tensor:
        """Irradiance [W/m^2], shape [B, n_w, m, m].

        Args:
            coefficients: of the relief [m], shape [B, n + 4, n + 4].
            photons_of: struct ``Photons`` of a chunk over some of the reliefs, by the lattice's axes.
            optics: what else ``photons_of`` tells.
        """
        channels, m = optics.scene.n_wavelengths, optics.scene.image_pixels
        at_once = max(1, BATCH_BYTES // (channels * m * m * coefficients.itemsize))
        groups = [coefficients] if optics.effects.many_benches else coefficients.split(at_once)
        image = _zeros(len(coefficients), channels, m, m, dtype=self._dtype)
        done = 0
        for group in groups:
            total = image[done : done + len(group)].numpy()
            for part, rows in self._parts(group, photons_of, optics):
                for one, addend, (first, end) in zip(total, part, rows, strict=True):
                    one[:, first:end] += addend[:, first:end]
            done += len(group)
        return image

    def _parts(
        self, group: torch.Tensor, photons_of: PhotonsOf, optics: Optics
    ) -> Iterator[tuple[NDArray[Any], list[list[int]]]]:
        """Image of each strip, shape [B, n_w, m, m], and between which rows each relief's holds anything.

        For NumPy: torch's threads would wait for the next sum on the cores that compute it.
        """
        channels, m = optics.scene.n_wavelengths, optics.scene.image_pixels
        kernel, bounds = row_kernels(self._kind, optics.effects).splat_rows, _bounds(group, optics)

        def add(strip: Chunk) -> tuple[NDArray[Any], list[list[int]]]:
            # Rows of pixels are set to zero by whoever comes to them first.
            part = torch.empty(len(group), channels, m, m, dtype=self._dtype)
            rows = torch.tensor([[m, m]] * len(group), dtype=torch.int32)
            inputs, outputs = [photons_of(strip, group), warp_array(bounds)], [warp_array(part)]
            self._launch(kernel, group, len(group), strip, inputs, [*outputs, wp.from_torch(rows, return_ctype=True)])
            return part.numpy(), rows.tolist()

        return on_all_cores(add, self._strips)

    def image_adjoint(
        self, coefficients: torch.Tensor, photons_of: PhotonsOf, optics: Optics, grad_image: torch.Tensor
    ) -> torch.Tensor:
        """Gradient of the coefficients from that of the image, in shapes of :meth:`image`."""
        kernel = row_adjoint_kernel(self._kind, optics.effects)
        bounds = _bounds(coefficients, optics)

        def add(strip: Chunk) -> torch.Tensor:
            part = _zeros(*coefficients.shape, dtype=self._dtype)
            inputs = [photons_of(strip, coefficients), warp_array(grad_image), warp_array(bounds)]
            self._launch(kernel, coefficients, len(coefficients), strip, inputs, [warp_array(part)])
            return part

        parts = on_all_cores(add, self._strips)
        total = next(parts)
        # What nobody has written need not be read: memory of zeros is made where it is first looked at.
        for part, taps in zip(parts, self._taps[1:], strict=True):
            total.numpy()[:, taps] += part.numpy()[:, taps]
        return total

    def filtered(
        self, planes: torch.Tensor, matrix: torch.Tensor, transposed: torch.Tensor, optics: Optics
    ) -> torch.Tensor:
        """matrix [R, K] @ planes [B, K, K] @ transposed [K, R], which is contiguous and the matrix's transpose.

        The matrix is the spline's prefilter or its transpose: what lies beyond its reach is not looked at.
        """
        rows, inner = matrix.shape
        found = torch.empty(len(planes), rows, rows, dtype=self._dtype)
        wp.launch(
            row_kernels(self._kind, optics.effects).filter_planes,
            dim=len(planes),
            inputs=[
                *(warp_array(array) for array in (matrix, transposed, planes.contiguous())),
                REACH_OF_BITS[torch.finfo(self._dtype).bits],
                warp_array(torch.empty(inner, dtype=self._dtype)),
            ],
            outputs=[warp_array(found)],
            device="cpu",
        )
        return found

    def _launch(
        self,
        kernel: wp.Kernel,
        coefficients: torch.Tensor,
        count: int,
        strip: Chunk,
        inputs: list[Any],
        outputs: list[Any],
    ) -> None:
        """A kernel for all rows of a strip and so many reliefs."""
        listed = torch.empty(self._padded, dtype=torch.int32)
        by_cell = torch.empty(CELL_PLANES, coefficients.shape[2], dtype=self._dtype)
        # Zero is no light: so the photons beyond the last column.
        work = _zeros(PLANES, self._padded, dtype=self._dtype)
        wp.launch(
            kernel,
            dim=(count, strip.rows),
            inputs=[
                warp_array(coefficients),
                *inputs,
                warp_array(self._across),
                wp.from_torch(self._first, return_ctype=True),
                warp_array(by_cell),
                warp_array(work),
                wp.from_torch(listed, return_ctype=True),
            ],
            outputs=outputs,
            device="cpu",
        )


def _touched(changes: NDArray[Any]) -> NDArray[np.int32]:
    """In which columns coefficients change: first and end of each row, shape [B, n + 4, 2].

    Args:
        changes: of coefficients, shape [B, n + 4, n + 4] [m].
    """
    taps = changes.shape[1]
    found = np.empty((len(changes), taps, 2), np.int32)
    for places, change in zip(found, np.abs(changes), strict=True):
        is_other = change > TOUCHED * change.max()
        rows = is_other.any(1)
        places[:, 0] = np.where(rows, is_other.argmax(1), taps)
        places[:, 1] = np.where(rows, taps - is_other[:, ::-1].argmax(1), 0)
    return found


def _taps_of(strip: Chunk, plan: PhotonPlan) -> slice:
    """Rows of coefficients that a strip's photons lie between, and one more on either side for rounding."""
    n = plan.scene.height_samples
    y = plan.grid_y[[strip.first_row, strip.first_row + strip.rows - 1]]
    low, high = np.clip(np.floor(sample_coordinate(y, n, plan.scene.plate_size_m[1])).astype(int), -1, n - 1)
    return slice(max(0, low), high + 6)


def _bounds(coefficients: torch.Tensor, optics: Optics) -> torch.Tensor:
    """What a kernel that follows paths through the relief asks for."""
    if not optics.effects.second_hits:
        return coefficients.new_empty(0, 2)
    return bounds_of(coefficients, optics.scene.sample_pitch_m)


def _zeros(*shape: int, dtype: torch.dtype) -> torch.Tensor:
    """Zeros that no thread of torch's has to write."""
    return torch.from_numpy(np.zeros(shape, dtype=np.float32 if dtype == torch.float32 else np.float64))
