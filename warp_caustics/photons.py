"""Placement of light paths on the plate.

``lattice``: cell centres of a regular grid, deterministic and free of noise.
``stratified``: one uniform photon per cell. ``sobol``: a scrambled Sobol
sequence. ``random``: independent and uniform, as in the paper.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import torch
import warp as wp

from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.photons import photon_kernels
from warp_caustics.scene import Placement, Scene
from warp_caustics.types import FloatArray

MAX_PHOTONS = 10**10


def photon_key(seed: int, role: str = "") -> tuple[int, int]:
    """Two 32-bit words that select a photon stream.

    A hash, because neighbouring seeds would otherwise share photons: the
    stream of (seed, role) has nothing in common with (seed + 1, role) nor with
    (seed, another role).
    """
    digest = hashlib.sha256(f"{seed}/{role}".encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


@dataclass(frozen=True)
class Chunk:
    """Photons first ... first + count - 1; for grids whole rows first_row ... first_row + rows - 1."""

    first: int
    count: int
    first_row: int = 0
    rows: int = 0


@dataclass(frozen=True)
class PhotonPlan:
    """How many photons start where.

    Attributes:
        scene: the plate they start on.
        placement: see the module's docstring.
        requested: wished number of photons n_l; grids round it to columns x rows.
        seed: selects the photon set (unused for the lattice).
        role: distinguishes photon sets of one seed that must be independent.
    """

    scene: Scene
    placement: Placement
    requested: int
    seed: int = 0
    role: str = ""

    def __post_init__(self) -> None:
        if self.placement not in get_args(Placement):
            raise InputError(f"placement {self.placement!r} is not known; use one of {', '.join(get_args(Placement))}")
        if isinstance(self.requested, bool) or self.requested != int(self.requested):
            raise InputError(f"n_photons {self.requested!r} is not a whole number; give one such as 1000000")
        if not 1 <= self.requested <= MAX_PHOTONS:
            raise InputError(f"n_photons {self.requested} is not between 1 and {MAX_PHOTONS}; give at least one photon")

    @property
    def is_grid(self) -> bool:
        return self.placement in ("lattice", "stratified")

    @cached_property
    def columns(self) -> int:
        """Grid cells along x, as square as the plate allows."""
        width, length = self.scene.plate_size_m
        return max(1, round(math.sqrt(self.requested * width / length)))

    @cached_property
    def rows(self) -> int:
        """Grid cells along y."""
        return max(1, round(self.requested / self.columns))

    @cached_property
    def count(self) -> int:
        """Actual number of photons n_l."""
        return self.columns * self.rows if self.is_grid else int(self.requested)

    @cached_property
    def grid_x(self) -> FloatArray:
        """x of the grid's cell centres [m], shape [columns]."""
        return cell_centres(self.columns, self.scene.plate_size_m[0])

    @cached_property
    def grid_y(self) -> FloatArray:
        """y of the grid's cell centres [m], shape [rows]."""
        return cell_centres(self.rows, self.scene.plate_size_m[1])

    def chunks(self, max_photons: int) -> Iterator[Chunk]:
        """Cut into chunks of at most max_photons (grids: whole rows, at least one)."""
        if self.is_grid:
            step = max(1, max_photons // self.columns)
            for row in range(0, self.rows, step):
                rows = min(step, self.rows - row)
                yield Chunk(row * self.columns, rows * self.columns, row, rows)
        else:
            for first in range(0, self.count, max_photons):
                yield Chunk(first, min(max_photons, self.count - first))

    def axes(self, chunk: Chunk, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Grid's axes [m]: x of all columns and y of the chunk's rows, shape [2, max(columns, rows)]."""
        axes = torch.zeros(2, max(self.columns, chunk.rows), dtype=torch.float64)
        axes[0, : self.columns] = torch.from_numpy(self.grid_x)
        axes[1, : chunk.rows] = torch.from_numpy(self.grid_y[chunk.first_row : chunk.first_row + chunk.rows])
        return axes.to(device, dtype)

    def positions(self, chunk: Chunk, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Starting points (x, y) of a chunk [m], shape [chunk.count, 2]."""
        width, length = self.scene.plate_size_m
        if self.placement == "lattice":
            x = torch.as_tensor(self.grid_x, dtype=dtype, device=device)
            y = torch.as_tensor(self.grid_y[chunk.first_row : chunk.first_row + chunk.rows], dtype=dtype, device=device)
            return torch.stack([x.repeat(chunk.rows), y.repeat_interleave(self.columns)], dim=1)
        key0, key1 = photon_key(self.seed, self.role)
        if self.placement == "sobol":
            engine = torch.quasirandom.SobolEngine(2, scramble=True, seed=key0)
            unit: torch.Tensor = engine.fast_forward(chunk.first).draw(chunk.count, dtype=torch.float64)
            return ((unit - 0.5) * torch.tensor([width, length], dtype=torch.float64)).to(dtype).to(device)
        positions = torch.empty(chunk.count, 2, dtype=dtype, device=device)
        warp_dtype = dtype_of(torch.finfo(dtype).bits)
        jitter = (self.columns, self.rows) if self.placement == "stratified" else (0, 0)
        wp.launch(
            photon_kernels(warp_dtype).place_random,
            dim=chunk.count,
            inputs=[key0, key1, chunk.first, *jitter, width, length, wp.from_torch(positions)],
            device=wp.device_from_torch(device),
        )
        return positions


GOLDEN = (math.sqrt(5) - 1) / 2
"""Multiples of it, without their whole parts, lie as evenly as can be however many there are."""

GROUP = 64
"""Photons that stay together where cells are spread: a block of a GPU's threads."""


def sorted_by_cell(positions: torch.Tensor, scene: Scene, *, is_spread: bool = False) -> torch.Tensor:
    """The same photons, those of a cell of the relief together.

    Args:
        positions: starting points [m], shape [N, 2].
        scene: gives the cells.
        is_spread: whether neighbouring groups of photons come from cells far apart, so that threads that run at the
            same time seldom add to the same pixel or coefficient.
    """
    n = scene.height_samples
    pitch = torch.tensor(scene.sample_pitch_m, dtype=positions.dtype, device=positions.device)
    # Keys of 32 bits are sorted in half the time.
    whole_number = torch.int32 if (2 * n) ** 2 < 2**31 else torch.int64
    cell = (positions / pitch).floor().to(whole_number) + n
    order = (cell[:, 1] * 2 * n + cell[:, 0]).argsort(stable=True)
    groups = len(order) // GROUP
    if is_spread and groups > 1:
        step = round(groups * GOLDEN)
        step += next(k for k in range(groups) if math.gcd(step + k, groups) == 1)
        whole = order[: groups * GROUP].view(groups, GROUP)
        spread = whole[torch.arange(groups, device=order.device) * step % groups].flatten()
        order = torch.cat([spread, order[groups * GROUP :]])
    return positions[order].contiguous()
