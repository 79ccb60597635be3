"""Lattice photons on a CPU: rows of them through ``kernels/rows.py``."""

from typing import Any

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import warp_array
from warp_caustics.height_field import sample_coordinate
from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.row_refraction import PLANES
from warp_caustics.kernels.row_surface import CELL_PLANES
from warp_caustics.kernels.rows import row_adjoint_kernel, row_kernel
from warp_caustics.kernels.vectors import LANES
from warp_caustics.optics import Optics
from warp_caustics.photons import PhotonPlan


class LatticeRows:
    """Launches ``kernels/rows.py``; a launch may run beside others."""

    def __init__(self, optics: Optics, plan: PhotonPlan, dtype: torch.dtype):
        scene = optics.scene
        n, width = scene.height_samples, scene.plate_size_m[0]
        self._kind, self._effects = dtype_of(torch.finfo(dtype).bits), optics.effects
        # Blocks of photons are read and written whole.
        self._columns = -(-plan.columns // LANES) * LANES + LANES
        self._cells = n + 4
        u = sample_coordinate(plan.grid_x, n, width)
        cell = np.clip(np.floor(u).astype(int), -1, n - 1)
        across = np.zeros((2, self._columns))
        across[:, : plan.columns] = u - cell, plan.grid_x
        first = np.searchsorted(cell, np.arange(-1, n + 1))
        self._across = torch.from_numpy(across).to(dtype)
        self._first_photon = torch.from_numpy(first.astype(np.int32))

    def splat(self, coefficients: torch.Tensor, photons: Any, image: torch.Tensor) -> tuple[int, int]:
        """Add whole rows of a lattice to an image.

        Args:
            coefficients: of the relief [m], shape [B, n + 4, n + 4].
            photons: struct ``Photons`` of a chunk, by its axes.
            image: [W/m^2], shape [B, n_w, m, m].

        Returns:
            The first row of pixels that light was added to, and the one past the last.
        """
        touched = torch.tensor([[image.shape[2], 0]] * len(image), dtype=torch.int32)
        self._launch(
            row_kernel(self._kind, self._effects),
            coefficients,
            photons,
            [],
            [warp_array(image), wp.from_torch(touched, return_ctype=True)],
        )
        return int(touched[:, 0].min()), int(touched[:, 1].max())

    def splat_adjoint(
        self, coefficients: torch.Tensor, photons: Any, grad_image: torch.Tensor, grad_coefficients: torch.Tensor
    ) -> None:
        """Add to the gradient of the coefficients what follows from that of the image."""
        self._launch(
            row_adjoint_kernel(self._kind, self._effects),
            coefficients,
            photons,
            [warp_array(grad_image)],
            [warp_array(grad_coefficients)],
        )

    def _launch(
        self, kernel: wp.Kernel, coefficients: torch.Tensor, photons: Any, inputs: list[Any], outputs: list[Any]
    ) -> None:
        dtype = coefficients.dtype
        listed = torch.empty(self._columns, dtype=torch.int32)
        # Zero is no light: so the photons beyond the last column.
        scratch = torch.empty(CELL_PLANES, self._cells, dtype=dtype), torch.zeros(PLANES, self._columns, dtype=dtype)
        wp.launch(
            kernel,
            dim=(len(coefficients), photons.count // photons.columns),
            inputs=[
                warp_array(coefficients),
                photons,
                *inputs,
                warp_array(self._across),
                wp.from_torch(self._first_photon, return_ctype=True),
                *(warp_array(array) for array in scratch),
                wp.from_torch(listed, return_ctype=True),
            ],
            outputs=outputs,
            device="cpu",
        )
