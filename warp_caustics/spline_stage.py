"""The linear stage: heights to spline coefficients to the surface maps of a photon lattice, and the adjoints of both.

Small reliefs by products with whole matrices. Those would cost the cube of the number of samples along an axis, so
larger ones go by blocks (``banded.py``).
"""

import math
from collections.abc import Callable
from functools import cached_property
from types import SimpleNamespace

import numpy as np
import torch
import warp as wp

from warp_caustics.banded import Banded, banded
from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.extremes import Extremes
from warp_caustics.height_field import MARGIN, REACH_OF_BITS, basis_matrix, prefilter_matrix, sample_coordinate
from warp_caustics.kernels import MAP_NAMES, dtype_of
from warp_caustics.kernels.prefilter import prefilter_kernels
from warp_caustics.lattice_adjoint import LatticeAdjoint
from warp_caustics.photons import Chunk, PhotonPlan
from warp_caustics.types import FloatArray

MAX_WHOLE_SAMPLES = 512
"""Reliefs of at most so many samples along an axis go by whole matrices."""

EVERYTHING = (-math.inf, math.inf)
"""Heights that may be."""

_ORDERS_Y, _ORDERS_X = (0, 0, 1, 0, 1, 2), (0, 1, 0, 2, 1, 0)
"""Derivatives along both axes that the six maps are (MAP_NAMES)."""


class SplineStage:
    """Matrices of one relief's grid and one lattice; shared between benches.

    Attributes:
        by_blocks: whether the relief is a large one.
    """

    def __init__(self, plan: PhotonPlan, tensor: Callable[[FloatArray], torch.Tensor]):
        """Prepare what small reliefs always need.

        Args:
            plan: photons and the scene that they start in.
            tensor: makes tensors of the engine's type on its device.
        """
        self._plan, self._tensor = plan, tensor
        self._n, self._plate_m = plan.scene.height_samples, plan.scene.plate_size_m
        self.by_blocks = self._n > MAX_WHOLE_SAMPLES
        self._rows_of_chunks: dict[Chunk, Banded] = {}
        if not self.by_blocks:
            _ = self.prefilter, self.prefilter_transposed

    @cached_property
    def prefilter(self) -> torch.Tensor:
        """From height samples to spline coefficients along one axis, shape [n + 4, n]."""
        return self._tensor(prefilter_matrix(self._n))

    @cached_property
    def prefilter_transposed(self) -> torch.Tensor:
        """The same, transposed and contiguous."""
        return self.prefilter.T.contiguous()

    def coefficients(self, heights: torch.Tensor, ends: tuple[float, float] = EVERYTHING) -> torch.Tensor:
        """Spline coefficients [B, n + 4, n + 4] [m] of heights [B, n, n] [m].

        Args:
            heights: of the relief; those beyond the ends are taken for these, what is no number for the first.
            ends: lowest and highest that there can be [m].
        """
        if heights.is_cuda and not self.by_blocks:
            return self.filtered(heights, self.prefilter, self.prefilter_transposed, ends)
        if ends != EVERYTHING:
            heights = heights.nan_to_num(nan=ends[0]).clamp(*ends)
        if self.by_blocks:
            return self._prefilter_blocks.transposed_after(self._prefilter_blocks.times(heights))
        return self.prefilter @ heights @ self.prefilter.T

    def coefficients_adjoint(self, grad: torch.Tensor) -> torch.Tensor:
        """Adjoint of :meth:`coefficients`, of heights within the ends."""
        if self.by_blocks:
            return self._prefilter_blocks.transposed_times(self._prefilter_blocks.after(grad))
        if grad.is_cuda:
            return self.filtered(grad, self.prefilter_transposed, self.prefilter)
        return self.prefilter.T @ grad @ self.prefilter

    def filtered(
        self,
        planes: torch.Tensor,
        matrix: torch.Tensor,
        transposed: torch.Tensor,
        ends: tuple[float, float] = EVERYTHING,
    ) -> torch.Tensor:
        """matrix [R, K] @ planes [B, K, K] @ transposed [K, R] as a GPU does it: no farther than the filter reaches.

        Args:
            planes: brought within the ends.
            matrix: the prefilter or its transpose.
            transposed: its transpose, contiguous.
            ends: least and most.
        """
        batch, (rows, inner) = len(planes), matrix.shape
        half_way, found = planes.new_empty(batch, rows, inner), planes.new_empty(batch, rows, rows)
        kernels, reach = self._kernels(planes.dtype)
        first = [warp_array(matrix), warp_array(planes.contiguous()), reach, *ends], [warp_array(half_way)]
        then = [warp_array(half_way), warp_array(transposed), reach], [warp_array(found)]
        with warp_stream(planes.device):
            device = wp.device_from_torch(planes.device)
            wp.launch(kernels.filter_columns, half_way.shape, *first, device=device)
            wp.launch(kernels.filter_rows, found.shape, *then, device=device)
        return found

    def asked_coefficients(self, batch: int, extremes: Extremes, ends: tuple[float, float]) -> torch.Tensor:
        """:meth:`coefficients` of the heights that extremes are asked of, shape [B, n, n]; and tells these."""
        matrix, transposed = self.prefilter, self.prefilter_transposed
        rows, inner = matrix.shape
        half_way, found = matrix.new_empty(batch, rows, inner), matrix.new_empty(batch, rows, rows)
        kernels, reach = self._kernels(matrix.dtype)
        first = [warp_array(matrix), extremes.where, reach, *ends], [warp_array(half_way), extremes.here]
        then = [warp_array(half_way), warp_array(transposed), reach]
        with warp_stream(matrix.device):
            device = wp.device_from_torch(matrix.device)
            wp.launch(kernels.filter_columns_there, half_way.shape, *first, device=device)
            told = [warp_array(found), extremes.here, extremes.told]
            wp.launch(kernels.filter_rows_and_tell, found.shape, then, told, device=device)
        return found

    def _kernels(self, dtype: torch.dtype) -> tuple[SimpleNamespace, int]:
        """That filter, and how far they reach."""
        return prefilter_kernels(dtype_of(torch.finfo(dtype).bits)), REACH_OF_BITS[torch.finfo(dtype).bits]

    def maps(self, coefficients: torch.Tensor, chunk: Chunk) -> torch.Tensor:
        """Surface maps [B, 6, rows, columns] (MAP_NAMES) of a chunk of the lattice."""
        if self.by_blocks:
            along_y = self._rows_of(chunk).times(coefficients[:, None])
            return self._column_blocks.transposed_after(along_y)
        along_y, along_x = self.lattice_matrices
        return along_y[:, _rows(chunk)] @ coefficients[:, None] @ along_x.transpose(1, 2)

    def maps_adjoint(self, planes: torch.Tensor, chunk: Chunk) -> torch.Tensor:
        """Gradient of the coefficients [B, n + 4, n + 4] from that of maps [B, 6, rows, columns]."""
        if planes.is_cuda:
            return self._gather(planes, chunk)
        if self.by_blocks:
            return self._rows_of(chunk).transposed_times(self._column_blocks.after(planes))
        along_y, along_x = self.lattice_matrices
        # The sum over the six planes is part of the second product.
        return along_y[:, _rows(chunk)].flatten(0, 1).T @ (planes @ along_x).flatten(1, 2)

    @cached_property
    def lattice_matrices(self) -> tuple[torch.Tensor, torch.Tensor]:
        """From coefficients to each of the six maps: along y [6, rows, n + 4], along x [6, columns, n + 4]."""
        return self._tensor(self._along_y(0, self._plan.rows)), self._tensor(self._along_x(0, self._plan.columns))

    @cached_property
    def _gather(self) -> LatticeAdjoint:
        """Products with matrices that are nearly empty take a GPU three times as long."""
        return LatticeAdjoint(self._plan, self._tensor)

    @cached_property
    def _prefilter_blocks(self) -> Banded:
        return banded(lambda a, b: prefilter_matrix(self._n, a, b), self._n + 2 * MARGIN, self._tensor)

    @cached_property
    def _column_blocks(self) -> Banded:
        return banded(self._along_x, self._plan.columns, self._tensor)

    def _rows_of(self, chunk: Chunk) -> Banded:
        if chunk not in self._rows_of_chunks:
            first = chunk.first_row
            rows = banded(lambda a, b: self._along_y(first + a, first + b), chunk.rows, self._tensor)
            self._rows_of_chunks[chunk] = rows
        return self._rows_of_chunks[chunk]

    def _along_y(self, first: int, last: int) -> FloatArray:
        return self._derivatives(self._plan.grid_y[first:last], self._plate_m[1], _ORDERS_Y)

    def _along_x(self, first: int, last: int) -> FloatArray:
        return self._derivatives(self._plan.grid_x[first:last], self._plate_m[0], _ORDERS_X)

    def _derivatives(self, positions_m: FloatArray, length_m: float, orders: tuple[int, ...]) -> FloatArray:
        u = sample_coordinate(positions_m, self._n, length_m)
        found = [basis_matrix(self._n, u, k) * (self._n / length_m) ** k for k in range(3)]
        return np.stack([found[k] for k in orders])


def _rows(chunk: Chunk) -> slice:
    return slice(chunk.first_row, chunk.first_row + chunk.rows)


assert len(_ORDERS_X) == len(_ORDERS_Y) == len(MAP_NAMES)
