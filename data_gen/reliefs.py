"""Batches of printed reliefs on any device."""

import torch
import warp as wp

from data_gen.config import PrintedPattern
from data_gen.kernels import stroke_kernel
from data_gen.patterns import STROKE_COLUMNS
from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.scene import Scene


def print_strokes(strokes: torch.Tensor, scene: Scene, pattern: PrintedPattern) -> torch.Tensor:
    """Reliefs of printed strokes, added up; ``fibres.line_relief`` is the same in float64, one relief at a time.

    Args:
        strokes: shape [B, L, 7] (STROKE_COLUMNS) [m], float32, on the CPU or a GPU; parts beyond the plate
            are cut off.
        scene: gives plate size and number of height samples n.
        pattern: gives the strokes' profile and the supersampling.

    Returns:
        Heights above the base [m], shape [B, n, n], float32, on the strokes' device.

    Raises:
        InputError: strokes of another shape or type.
    """
    if strokes.ndim != 3 or strokes.shape[2] != len(STROKE_COLUMNS) or strokes.dtype != torch.float32:
        raise InputError(
            f"strokes are {strokes.dtype} {list(strokes.shape)}; give float32 [B, L, {len(STROKE_COLUMNS)}]"
        )
    start_warp()
    n = scene.height_samples
    heights = torch.empty(len(strokes), n, n, dtype=torch.float32, device=strokes.device)
    pitch_x, pitch_y = scene.sample_pitch_m
    with warp_stream(strokes.device):
        wp.launch(
            stroke_kernel(pattern.profile == "quarter"),
            dim=heights.shape,
            inputs=[warp_array(strokes.contiguous()), pitch_x, pitch_y, n, pattern.supersampling],
            outputs=[warp_array(heights)],
            device=wp.device_from_torch(strokes.device),
        )
    return heights
