"""From gradients of a photon lattice's surface maps to those of spline coefficients, by what each of them acts on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import warp_array
from warp_caustics.height_field import MARGIN, TAPS, basis_taps, sample_coordinate
from warp_caustics.kernels import MAP_NAMES, dtype_of
from warp_caustics.kernels.lattice_surface import lattice_adjoint_kernels
from warp_caustics.photons import Chunk, PhotonPlan
from warp_caustics.types import FloatArray, IntArray


@dataclass(frozen=True)
class Axis:
    """Which coefficients act on which photons along an axis, as the kernels are told (see there)."""

    first: torch.Tensor
    span: torch.Tensor
    weights: torch.Tensor


def axis_of(positions_m: FloatArray, n: int, length_m: float, tensor: Callable[[FloatArray], torch.Tensor]) -> Axis:
    """Photons at ascending positions [m], shape [N], over n samples along an axis of the given length [m].

    Args:
        positions_m: where they start.
        n: number of height samples.
        length_m: of the plate.
        tensor: makes tensors of the wished floating type on the wished device.
    """
    u = sample_coordinate(positions_m, n, length_m)
    first, _ = basis_taps(n, u, 0)
    weights = np.stack([basis_taps(n, u, k)[1] * (n / length_m) ** k for k in range(3)])
    coefficients = np.arange(n + 2 * MARGIN)
    span = np.stack([np.searchsorted(first, coefficients - TAPS + 1), np.searchsorted(first, coefficients, "right")])
    made = tensor(weights)

    def whole(numbers: IntArray) -> torch.Tensor:
        return torch.as_tensor(numbers, dtype=torch.int32, device=made.device)

    return Axis(whole(first), whole(span), made)


class LatticeAdjoint:
    """Of one relief's grid and one lattice."""

    def __init__(self, plan: PhotonPlan, tensor: Callable[[FloatArray], torch.Tensor]):
        """Prepare both axes; the rest as of :func:`axis_of`."""
        n, (width_m, height_m) = plan.scene.height_samples, plan.scene.plate_size_m
        self._x = axis_of(plan.grid_x, n, width_m, tensor)
        self._y = axis_of(plan.grid_y, n, height_m, tensor)
        self._size = n + 2 * MARGIN

    def __call__(self, planes: torch.Tensor, chunk: Chunk) -> torch.Tensor:
        """Gradient of the coefficients [B, n + 4, n + 4] from that of a chunk's maps [B, 6, rows, columns]."""
        batch, _, _, columns = planes.shape
        kernels, device = lattice_adjoint_kernels(dtype_of(torch.finfo(planes.dtype).bits)), str(planes.device)
        sums = planes.new_empty(batch, 3, self._size, columns)
        wp.launch(
            kernels.gather_along_y,
            dim=(batch, self._size, columns),
            inputs=[warp_array(planes), *_told(self._y), chunk.first_row],
            outputs=[warp_array(sums)],
            device=device,
        )
        grad = planes.new_empty(batch, self._size, self._size)
        wp.launch(
            kernels.gather_along_x,
            dim=grad.shape,
            inputs=[warp_array(sums), *_told(self._x)],
            outputs=[warp_array(grad)],
            device=device,
        )
        return grad


def _told(axis: Axis) -> list[object]:
    return [warp_array(axis.first), warp_array(axis.span), warp_array(axis.weights)]


assert len(MAP_NAMES) == 6  # the kernel writes out which map has which derivatives
