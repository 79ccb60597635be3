"""Batches of printed lines of any shape, on any device: rows to heights, with :mod:`warp_caustics.prints.paths` beside.

A row is a piece of a printed line (ROW_COLUMNS) [m], see the kinds in :mod:`warp_caustics.prints.path_kernels`.
"""

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.path_kernels import BEGIN, BLOCK, JOINED, PATH_TRAIT_COLUMNS, RING, SEGMENT, path_kernel
from warp_caustics.prints.paths import PrintedPath
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

ROW_COLUMNS = ("kind", "x0_m", "y0_m", "x1_m", "y1_m", "width_m", "height_m")
"""Of a ring: centre (x0, y0), radius x1."""
_REACH = PATH_TRAIT_COLUMNS.index("reach")


def rows_of_path(path: PrintedPath) -> FloatArray:
    """Rows of a path, shape [pieces, 7] (ROW_COLUMNS); its section is not in them."""
    points, widths, heights = path.points_m, path.widths_m, path.heights_m
    pieces = max(1, len(points) - 1)
    rows = np.zeros((pieces, len(ROW_COLUMNS)))
    rows[:, 0] = [SEGMENT] + [JOINED] * (pieces - 1)
    rows[:, 1:3], rows[:, 3:5] = points[:pieces], points[-pieces:]
    rows[:, 5], rows[:, 6] = widths[-pieces:], heights[-pieces:]
    if widths[0] == rows[0, 5] and heights[0] == rows[0, 6]:
        return rows
    # A row has one width and height, those of its end: the first point gets a row of its own.
    rows[0, 0] = JOINED
    first = np.array([[BEGIN, *points[0], *points[0], widths[0], heights[0]]])
    return np.concatenate([first, rows])


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
        return padded.unflatten(1, (-1, BLOCK))

    begins = blocks((~joined).to(rows.dtype)[..., None], 0.0).amax(dim=2)
    return torch.cat([blocks(low, torch.inf).amin(dim=2), blocks(high, -torch.inf).amax(dim=2), begins], dim=2)


def print_paths(rows: torch.Tensor, scene: Scene, traits: torch.Tensor, supersampling: int = 4) -> torch.Tensor:
    """Reliefs of printed lines of any shape.

    Args:
        rows: shape [B, L, 7] (ROW_COLUMNS) [m], float32, on the CPU or a GPU; the first of each is not ``JOINED``.
        scene: gives plate size and number of height samples n.
        traits: of each relief, shape [B, 11] (PATH_TRAIT_COLUMNS), float32.
        supersampling: a sample is the mean of supersampling^2 points of its cell.

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
            path_kernel(supersampling),
            dim=heights.shape,
            inputs=[warp_array(rows), warp_array(boxes), warp_array(traits), *scene.sample_pitch_m, n],
            outputs=[warp_array(heights)],
            device=wp.device_from_torch(device),
        )
    return heights

