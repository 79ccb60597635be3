"""Batches of printed reliefs on any device."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
import warp as wp

from data_gen.config import PrintedPattern
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.patterns import RING, STROKE_COLUMNS
from data_gen.variety import TRAIT_COLUMNS, PrintTraits, draw_traits, merged, plain_traits
from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.kernels import stroke_kernel
from warp_caustics.prints.line import distance_to_segment, section_height
from warp_caustics.scene import Scene


def traits_of(dataset: DatasetConfig, fingerprint: str, samples: Sequence[int]) -> torch.Tensor:
    """Traits of a data set's reliefs, shape [len(samples), 7] (TRAIT_COLUMNS), float32, on the CPU."""
    pattern, plate_size_m = dataset.reliefs, dataset.scene.plate_size_m
    plain, variety = plain_traits(pattern.profile), pattern.variety
    if variety is None:
        rows = [plain.row()] * len(samples)
    else:
        rows = [
            draw_traits(variety, plain, plate_size_m, sample_generator(fingerprint, "traits", sample)).row()
            for sample in samples
        ]
    return torch.tensor(rows, dtype=torch.float32).reshape(-1, len(TRAIT_COLUMNS))


def print_strokes(
    strokes: torch.Tensor, scene: Scene, pattern: PrintedPattern, traits: torch.Tensor | None = None
) -> torch.Tensor:
    """Reliefs of printed strokes; :func:`printed_relief` is the same in float64, one relief at a time.

    Args:
        strokes: shape [B, L, 7] (STROKE_COLUMNS) [m], float32, on the CPU or a GPU; parts beyond the plate
            are cut off.
        scene: gives plate size and number of height samples n.
        pattern: gives the strokes' profile and the supersampling.
        traits: of each print, shape [B, 7] (TRAIT_COLUMNS), float32; None prints all as the pattern says.

    Returns:
        Heights above the base [m], shape [B, n, n], float32, on the strokes' device.

    Raises:
        InputError: strokes of another shape or type.
    """
    if strokes.ndim != 3 or strokes.shape[2] != len(STROKE_COLUMNS) or strokes.dtype != torch.float32:
        raise InputError(
            f"strokes are {strokes.dtype} {list(strokes.shape)}; give float32 [B, L, {len(STROKE_COLUMNS)}]"
        )
    if traits is None:
        traits = torch.tensor(plain_traits(pattern.profile).row(), dtype=torch.float32).expand(len(strokes), -1)
    if traits.shape != (len(strokes), len(TRAIT_COLUMNS)) or traits.dtype != torch.float32:
        raise InputError(
            f"traits are {traits.dtype} {list(traits.shape)}; give float32 [{len(strokes)}, {len(TRAIT_COLUMNS)}]"
        )
    can_merge = pattern.variety is not None and pattern.variety.merging_share > 0
    start_warp()
    n = scene.height_samples
    heights = torch.empty(len(strokes), n, n, dtype=torch.float32, device=strokes.device)
    pitch_x, pitch_y = scene.sample_pitch_m
    with warp_stream(strokes.device):
        wp.launch(
            stroke_kernel(pattern.supersampling, can_merge),
            dim=heights.shape,
            inputs=[
                warp_array(strokes.contiguous()),
                warp_array(traits.to(strokes.device, non_blocking=True).contiguous()),
                pitch_x,
                pitch_y,
                n,
            ],
            outputs=[warp_array(heights)],
            device=wp.device_from_torch(strokes.device),
        )
    return heights


def printed_relief(
    strokes: npt.NDArray[np.float64],
    samples: int,
    plate_size_m: tuple[float, float],
    traits: PrintTraits,
    supersampling: int = 4,
) -> npt.NDArray[np.float64]:
    """Relief of one print in float64, point by point: the oracle of :func:`print_strokes`.

    Args:
        strokes: shape [L, 7] (STROKE_COLUMNS) [m].
        samples: n, height samples per side.
        plate_size_m: extent along x and y [m].
        traits: of the print.
        supersampling: each sample is the mean over supersampling x supersampling points of its cell.

    Returns:
        Heights above the base [m], shape [n, n]; row grows with +y, column with +x.
    """
    fine = samples * supersampling
    x, y = (cell_centres(fine, length) for length in plate_size_m)
    heights = [np.zeros((fine, fine))]
    for kind, x0, y0, x1, y1, width, height in strokes.tolist():
        if kind == RING:
            distance = np.abs(np.hypot(x[None, :] - x0, y[:, None] - y0) - x1)
        else:
            distance = distance_to_segment((x0, y0), (x1, y1), x[None, :], y[:, None])
        heights.append(height * section_height(2 * distance / width, traits.section, traits.exponent, traits.reach))
    relief = merged(np.stack(heights), traits.merging)
    relief = relief.reshape(samples, supersampling, samples, supersampling).mean(axis=(1, 3))
    x, y = (cell_centres(samples, length) for length in plate_size_m)
    xx, xy, yy = traits.bow
    return np.asarray(relief + xx * x[None, :] ** 2 + xy * x[None, :] * y[:, None] + yy * y[:, None] ** 2)
