"""Lattice photons on a CPU: strips of rows on all cores, through ``kernels/rows.py``."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from warp_caustics.chunked import MIN_CHUNK_PHOTONS, on_all_cores, warp_array
from warp_caustics.height_field import PREFILTER_REACH, sample_coordinate
from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.row_refraction import PLANES
from warp_caustics.kernels.row_surface import CELL_PLANES
from warp_caustics.kernels.rows import row_adjoint_kernel, row_kernels
from warp_caustics.kernels.vectors import LANES
from warp_caustics.optics import Optics
from warp_caustics.photons import Chunk, PhotonPlan
from warp_caustics.relief_bounds import bounds_of

PhotonsOf = Callable[[Chunk, torch.Tensor], Any]
"""Struct ``Photons`` of a chunk, over reliefs with these coefficients; of as many columns as its rows have photons."""


STRIPS = 16
"""Strips of rows that a lattice is cut into, whatever the number of cores: more would use more of them."""

BLOCKS = 4
"""Blocks of rows in a strip, each with columns of its own where a relief changes in places: a slanted line comes to
others in each."""

TOUCHED = 1e-3
"""Of the largest change of a spline's coefficients, below which photons are taken to stay where they are: coefficients
fall by 0.27 from sample to sample beside a change of heights."""

BATCH_BYTES = 64 * 2**20
"""Images of at most so much memory are summed at a time; every strip touches a part of its own copy."""


class _Columns(NamedTuple):
    """Columns of a lattice that stand side by side.

    Attributes:
        padded: with those that are read beyond the last one: blocks of photons are read and written whole.
        across: place in its cell, and x [m], of each, shape [2, padded].
        first_photon: of each cell, shape [n + 2].
    """

    padded: int
    across: torch.Tensor
    first_photon: torch.Tensor


class _Block(NamedTuple):
    """Photons of some rows and columns."""

    chunk: Chunk
    columns: _Columns


class LatticeRows:
    """Images and gradients of whole lattices: strips of rows on all cores, their sums added in order."""

    def __init__(self, plan: PhotonPlan, dtype: torch.dtype):
        n = plan.scene.height_samples
        self._plan, self._dtype, self._kind = plan, dtype, dtype_of(torch.finfo(dtype).bits)
        u = sample_coordinate(plan.grid_x, n, plan.scene.plate_size_m[0])
        cell = np.clip(np.floor(u).astype(int), -1, n - 1)
        self._across, self._first = np.stack([u - cell, plan.grid_x]), np.searchsorted(cell, np.arange(-1, n + 1))
        rows = max(-(-plan.rows // STRIPS), -(-MIN_CHUNK_PHOTONS // plan.columns))
        whole = self._columns(0, plan.columns)
        self._strips = [[_Block(strip, whole)] for strip in plan.chunks(rows * plan.columns)]
        self._taps = [_taps_of(strip.chunk, plan) for (strip,) in self._strips]

    def change(self, coefficients: torch.Tensor, photons_of: PhotonsOf, optics: Optics) -> torch.Tensor:
        """Irradiance of the second of two reliefs less that of the first [W/m^2], shape [n_w, m, m].

        Only photons that the change touches are looked at: of light from elsewhere that meets the relief again no more
        or less is lost.

        Args:
            coefficients: of both [m], shape [2, n + 4, n + 4].
            photons_of: struct ``Photons`` of a chunk over one relief, by the lattice's axes.
            optics: as of :meth:`image`.
        """
        channels, m = optics.scene.n_wavelengths, optics.scene.image_pixels
        strips = self._touched(coefficients)
        change = _zeros(1, channels, m, m, dtype=self._dtype)
        for one, add in zip(coefficients.split(1), (np.subtract, np.add), strict=True):
            for part, ((first, end),) in self._parts(one, photons_of, optics, strips):
                rows = change[:, :, first:end].numpy()
                add(rows, part[:, :, first:end], out=rows)
        return change[0]

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
            for part, rows in self._parts(group, photons_of, optics, self._strips):
                for one, addend, (first, end) in zip(total, part, rows, strict=True):
                    one[:, first:end] += addend[:, first:end]
            done += len(group)
        return image

    def _parts(
        self, group: torch.Tensor, photons_of: PhotonsOf, optics: Optics, strips: Sequence[Sequence[_Block]]
    ) -> Iterator[tuple[NDArray[Any], list[list[int]]]]:
        """Image of each strip, shape [B, n_w, m, m], and between which rows each relief's holds anything.

        For NumPy: torch's threads would wait for the next sum on the cores that compute it.
        """
        channels, m = optics.scene.n_wavelengths, optics.scene.image_pixels
        kernel, bounds = row_kernels(self._kind, optics.effects).splat_rows, _bounds(group, optics)

        def add(strip: Sequence[_Block]) -> tuple[NDArray[Any], list[list[int]]]:
            # Rows of pixels are set to zero by whoever comes to them first.
            part = torch.empty(len(group), channels, m, m, dtype=self._dtype)
            rows = torch.tensor([[m, m]] * len(group), dtype=torch.int32)
            outputs = [warp_array(part), wp.from_torch(rows, return_ctype=True)]
            for block in strip:
                photons = photons_of(block.chunk, group)
                self._launch(kernel, group, photons, block.columns, [warp_array(bounds)], outputs)
            return part.numpy(), rows.tolist()

        return on_all_cores(add, strips)

    def image_adjoint(
        self, coefficients: torch.Tensor, photons_of: PhotonsOf, optics: Optics, grad_image: torch.Tensor
    ) -> torch.Tensor:
        """Gradient of the coefficients from that of the image, in shapes of :meth:`image`."""
        kernel = row_adjoint_kernel(self._kind, optics.effects)
        bounds = _bounds(coefficients, optics)

        def add(strip: Sequence[_Block]) -> torch.Tensor:
            part = _zeros(*coefficients.shape, dtype=self._dtype)
            inputs = [warp_array(grad_image), warp_array(bounds)]
            for block in strip:
                photons = photons_of(block.chunk, coefficients)
                self._launch(kernel, coefficients, photons, block.columns, inputs, [warp_array(part)])
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
                PREFILTER_REACH,
                warp_array(torch.empty(inner, dtype=self._dtype)),
            ],
            outputs=[warp_array(found)],
            device="cpu",
        )
        return found

    def _columns(self, begin: int, end: int) -> _Columns:
        """From one column to before another."""
        count = end - begin
        padded = -(-count // LANES) * LANES + LANES
        across = np.zeros((2, padded))
        across[:, :count] = self._across[:, begin:end]
        first = np.clip(self._first - begin, 0, count)
        return _Columns(padded, torch.from_numpy(across).to(self._dtype), torch.from_numpy(first.astype(np.int32)))

    def _touched(self, coefficients: torch.Tensor) -> list[list[_Block]]:
        """Photons under which the second of two reliefs differs from the first."""
        apart = (coefficients[1] - coefficients[0]).abs().numpy()
        is_other, plan, strips = apart > TOUCHED * apart.max(), self._plan, []
        for (strip,) in self._strips:
            blocks, rows = [], -(-strip.chunk.rows // BLOCKS)
            for row in range(0, strip.chunk.rows, rows):
                first, count = strip.chunk.first_row + row, min(rows, strip.chunk.rows - row)
                chunk = Chunk(first * plan.columns, count * plan.columns, first, count)
                taps = np.flatnonzero(is_other[_taps_of(chunk, plan)].any(0))
                if not len(taps):
                    continue
                # A photon lies between four coefficients.
                begin, end = self._first[max(0, taps[0] - 3)], self._first[min(taps[-1] + 1, len(self._first) - 1)]
                if end > begin:
                    wide = Chunk(chunk.first + int(begin), count * int(end - begin), first, count)
                    blocks.append(_Block(wide, self._columns(int(begin), int(end))))
            if blocks:
                strips.append(blocks)
        return strips

    def _launch(
        self,
        kernel: wp.Kernel,
        coefficients: torch.Tensor,
        photons: Any,
        columns: _Columns,
        inputs: list[Any],
        outputs: list[Any],
    ) -> None:
        listed = torch.empty(columns.padded, dtype=torch.int32)
        by_cell = torch.empty(CELL_PLANES, coefficients.shape[2], dtype=self._dtype)
        # Zero is no light: so the photons beyond the last column.
        work = _zeros(PLANES, columns.padded, dtype=self._dtype)
        wp.launch(
            kernel,
            dim=(len(coefficients), photons.count // photons.columns),
            inputs=[
                warp_array(coefficients),
                photons,
                *inputs,
                warp_array(columns.across),
                wp.from_torch(columns.first_photon, return_ctype=True),
                warp_array(by_cell),
                warp_array(work),
                wp.from_torch(listed, return_ctype=True),
            ],
            outputs=outputs,
            device="cpu",
        )


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
