"""Batches of printed lines of any shape, on any device: rows to heights, with :mod:`warp_caustics.prints.paths` beside.

A row is a piece of a printed line (:mod:`warp_caustics.prints.rows`) [m].
"""

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.path_kernels import BLOCK, PATH_TRAIT_COLUMNS, path_kernel
from warp_caustics.prints.rows import BEGIN, JOINED, RING, ROW_COLUMNS
from warp_caustics.scene import Scene

_REACH = PATH_TRAIT_COLUMNS.index("reach")


def block_boxes(rows: torch.Tensor, reach: torch.Tensor) -> torch.Tensor:
    """What blocks of rows can touch.

    Args:
        rows: shape [B, L, 7] [m].
        reach: where the section ends, in halves of the width [1], shape [B].

    Returns:
        Shape [B, ceil(L / BLOCK), 5] (BOX_COLUMNS) [m].
    """
    kind, width = rows[..., 0], rows[..., 5]
    # A joined row begins with the width and height of the row before.
    before = torch.nn.functional.pad(rows[..., 5:7], (0, 0, 1, 0))[:, :-1]
    joined = kind == JOINED
    half = 0.5 * reach[:, None] * torch.where(joined, torch.maximum(width, before[..., 0]), width)
    prints = ((rows[..., 6] > 0) | (joined & (before[..., 1] > 0))) & (kind != BEGIN)
    start, end, ring = rows[..., 1:3], rows[..., 3:5], kind == RING
    half = torch.where(ring, half + rows[..., 3], half)[..., None]
    end = torch.where(ring[..., None], start, end)
    inf = torch.full_like(start, torch.inf)
    low = torch.where(prints[..., None], torch.minimum(start, end) - half, inf)
    high = torch.where(prints[..., None], torch.maximum(start, end) + half, -inf)
    missing = -rows.shape[1] % BLOCK

    def blocks(values: torch.Tensor, fill: float) -> torch.Tensor:
        padded = torch.nn.functional.pad(values, (0, 0, 0, missing), value=fill)
        return padded.reshape(len(padded), -1, BLOCK, padded.shape[2])

    begins = blocks((~joined).to(rows.dtype)[..., None], 0.0).amax(dim=2)
    return torch.cat([blocks(low, torch.inf).amin(dim=2), blocks(high, -torch.inf).amax(dim=2), begins], dim=2)


def print_paths(
    rows: torch.Tensor, scene: Scene, traits: torch.Tensor, supersampling: int = 4, *, has_chains: bool = True
) -> torch.Tensor:
    """Reliefs of printed lines of any shape.

    Args:
        rows: shape [B, L, 7] (ROW_COLUMNS) [m], float32, on the CPU or a GPU; the first of each is not ``JOINED``.
        scene: gives plate size and number of height samples n.
        traits: of each relief, shape [B, 11] (PATH_TRAIT_COLUMNS), float32.
        supersampling: a sample is the mean of supersampling^2 points of its cell.
        has_chains: rows may be joined, lines may merge; without either the kernel is that much faster.

    Returns:
        Heights above the base [m], shape [B, n, n], float32, on the rows' device.

    Raises:
        InputError: rows or traits of another shape or type.
    """
    for name, found, columns in (("rows", rows, ROW_COLUMNS), ("traits", traits, PATH_TRAIT_COLUMNS)):
        if found.shape[-1] != len(columns) or found.ndim != (3 if name == "rows" else 2) or len(found) != len(rows):
            raise InputError(f"{name} have shape {list(found.shape)}; give one of {len(columns)} columns per relief")
        if found.dtype != torch.float32:
            raise InputError(f"{name} are {found.dtype}; give float32")
    start_warp()
    n, device = scene.height_samples, rows.device
    heights = torch.empty(len(rows), n, n, dtype=torch.float32, device=device)
    rows, traits = rows.contiguous(), traits.to(device, non_blocking=True).contiguous()
    boxes = block_boxes(rows, traits[:, _REACH]).contiguous()
    with warp_stream(device):
        wp.launch(
            path_kernel(supersampling, has_chains),
            dim=heights.shape,
            inputs=[warp_array(rows), warp_array(boxes), warp_array(traits), *scene.sample_pitch_m, n],
            outputs=[warp_array(heights)],
            device=wp.device_from_torch(device),
        )
    return heights
