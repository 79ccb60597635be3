"""Batches of printed reliefs on any device."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
import warp as wp

from data_gen.config import PrintedPattern
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.making import MadePrint, draw_making
from data_gen.patterns import STROKE_COLUMNS
from data_gen.variety import TRAIT_COLUMNS, PrintTraits, draw_traits, merged, plain_traits
from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.kernels import stroke_kernel
from warp_caustics.prints.line import distance_to_segment
from warp_caustics.prints.path_kernels import PATH_TRAIT_COLUMNS
from warp_caustics.prints.path_printer import print_paths
from warp_caustics.prints.rows import BEGIN, JOINED, RING
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray


def made_print(dataset: DatasetConfig, fingerprint: str, sample: int) -> MadePrint | None:
    """How a sample is made; None where its pattern has no making."""
    making = dataset.reliefs.making
    if making is None:
        return None
    return draw_making(making, dataset.scene.plate_size_m, sample_generator(fingerprint, "traits", sample))


def traits_of(dataset: DatasetConfig, fingerprint: str, samples: Sequence[int]) -> torch.Tensor:
    """Traits of a data set's reliefs, float32, on the CPU.

    Shape [len(samples), 7] (TRAIT_COLUMNS), or [len(samples), 11] (PATH_TRAIT_COLUMNS) of patterns that are not plain.
    """
    pattern, plate_size_m = dataset.reliefs, dataset.scene.plate_size_m
    plain, variety = plain_traits(pattern.profile), pattern.variety
    drawn = [plain] * len(samples)
    if variety is not None:
        drawn = [
            draw_traits(variety, plain, plate_size_m, sample_generator(fingerprint, "traits", sample))
            for sample in samples
        ]
    elif pattern.making is not None:
        made = [made_print(dataset, fingerprint, sample) for sample in samples]
        drawn = [each.traits for each in made if each is not None]
    columns = TRAIT_COLUMNS if pattern.is_plain else PATH_TRAIT_COLUMNS
    rows = [traits.row() if pattern.is_plain else traits.path_row() for traits in drawn]
    return torch.tensor(rows, dtype=torch.float32).reshape(-1, len(columns))


def print_strokes(
    strokes: torch.Tensor, scene: Scene, pattern: PrintedPattern, traits: torch.Tensor | None = None
) -> torch.Tensor:
    """Reliefs of printed strokes; :func:`printed_relief` is the same in float64, one relief at a time.

    Args:
        strokes: shape [B, L, 7] (STROKE_COLUMNS) [m], float32, on the CPU or a GPU; parts beyond the plate
            are cut off.
        scene: gives plate size and number of height samples n.
        pattern: gives the strokes' profile and the supersampling.
        traits: of each print, float32, shape [B, 7] (TRAIT_COLUMNS), or [B, 11] (PATH_TRAIT_COLUMNS) where the pattern
            is not plain; None prints all as the pattern says.

    Returns:
        Heights above the base [m], shape [B, n, n], float32, on the strokes' device.

    Raises:
        InputError: strokes of another shape or type.
    """
    if strokes.ndim != 3 or strokes.shape[2] != len(STROKE_COLUMNS) or strokes.dtype != torch.float32:
        raise InputError(
            f"strokes are {strokes.dtype} {list(strokes.shape)}; give float32 [B, L, {len(STROKE_COLUMNS)}]"
        )
    plain = plain_traits(pattern.profile)
    columns, row = (TRAIT_COLUMNS, plain.row()) if pattern.is_plain else (PATH_TRAIT_COLUMNS, plain.path_row())
    if traits is None:
        traits = torch.tensor(row, dtype=torch.float32).expand(len(strokes), -1)
    if traits.shape != (len(strokes), len(columns)) or traits.dtype != torch.float32:
        raise InputError(
            f"traits are {traits.dtype} {list(traits.shape)}; give float32 [{len(strokes)}, {len(columns)}]"
        )
    if not pattern.is_plain:
        return print_paths(strokes, scene, traits, pattern.supersampling, has_chains=pattern.has_chains)
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
        strokes: shape [L, 7] (STROKE_COLUMNS) [m], of any kind.
        samples: n, height samples per side.
        plate_size_m: extent along x and y [m].
        traits: of the print.
        supersampling: each sample is the mean over supersampling x supersampling points of its cell.

    Returns:
        Heights above the base [m], shape [n, n]; row grows with +y, column with +x.
    """
    fine = samples * supersampling
    x, y = (cell_centres(fine, length) for length in plate_size_m)
    section, lines = traits.cross_section, [np.zeros((fine, fine))]
    before_width, before_height = 0.0, 0.0
    for kind, x0, y0, x1, y1, width, height in strokes.tolist():
        if kind == BEGIN:
            piece = np.zeros((fine, fine))
        elif kind == RING:
            distance = np.abs(np.hypot(x[None, :] - x0, y[:, None] - y0) - x1)
            piece = height * section.relative_height(2 * distance / width)
        else:
            distance = distance_to_segment((x0, y0), (x1, y1), x[None, :], y[:, None])
            way = _way((x0, y0), (x1, y1), x[None, :], y[:, None]) if kind == JOINED else 1.0
            wide, high = before_width + way * (width - before_width), before_height + way * (height - before_height)
            piece = high * section.relative_height(2 * distance / wide)
        if kind == JOINED:
            lines[-1] = np.maximum(lines[-1], piece)
        else:
            lines.append(piece)
        before_width, before_height = width, height
    relief = merged(np.stack(lines), traits.merging)
    relief = relief.reshape(samples, supersampling, samples, supersampling).mean(axis=(1, 3))
    x, y = (cell_centres(samples, length) for length in plate_size_m)
    xx, xy, yy = traits.bow
    amplitude, k_x, k_y, phase = traits.wave
    wave = amplitude * np.sin(k_x * x[None, :] + k_y * y[:, None] + phase)
    return np.asarray(relief + xx * x[None, :] ** 2 + xy * x[None, :] * y[:, None] + yy * y[:, None] ** 2 + wave)


def _way(start_m: tuple[float, float], end_m: tuple[float, float], x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Where the nearest point of a segment is, from 0 at its start to 1; shape of x and y together."""
    along = end_m[0] - start_m[0], end_m[1] - start_m[1]
    squared = max(along[0] ** 2 + along[1] ** 2, 1e-30)
    return np.clip(((x_m - start_m[0]) * along[0] + (y_m - start_m[1]) * along[1]) / squared, 0.0, 1.0)
