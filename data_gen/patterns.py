"""Strokes of a printed pattern, drawn from the distribution that a configuration describes.

A stroke is one fused fibre, a straight segment or a ring, or a piece of one with
corners and curves. Every pattern gives an array of strokes, so that perturbing
and printing them is the same for all.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from data_gen.config import PictureConfig, PrintedPattern, RasterConfig, ReliefConfig, RingsConfig
from data_gen.shapes import DRAW_SHAPES, drawn_count, drawn_sizes
from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line
from warp_caustics.prints.rows import BEGIN, JOINED, RING, ROW_COLUMNS, SEGMENT
from warp_caustics.types import FloatArray

STROKE_COLUMNS = ROW_COLUMNS
"""Columns of a stroke: its kind, ends, width and height; see :mod:`warp_caustics.prints.rows`."""


def draw_strokes(config: PrintedPattern, rng: np.random.Generator) -> FloatArray:
    """Strokes of one relief.

    Args:
        config: one of the patterns.
        rng: source of randomness; the result depends on nothing else.

    Returns:
        Strokes, shape [L, 7] (STROKE_COLUMNS) [m].
    """
    return _DRAW[type(config)](config, rng)


def perturb_strokes(
    strokes: FloatArray, config: PrintedPattern, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, int]]:
    """Strokes moved, widened and raised by the offsets of Tab. 3.

    Args:
        strokes: shape [L, 7] [m].
        config: gives the ranges of the offsets and the smallest width.
        rng: source of randomness.

    Returns:
        Perturbed strokes, shape [L, 7], and how many lines had to be raised to the smallest width or were lost to a
        height of 0, somewhere.
    """
    ranges = config.perturbation
    has_pieces = bool((strokes[:, 0] == JOINED).any())
    line = np.cumsum(strokes[:, 0] != JOINED) - 1 if has_pieces else None
    count = len(strokes) if line is None else int(line[-1]) + 1
    start, end = rng.uniform(*ranges.line_start_m, (count, 2)), rng.uniform(*ranges.line_end_m, (count, 2))
    wider, higher = rng.uniform(*ranges.line_width_m, count), rng.uniform(*ranges.line_height_m, count)
    if line is not None:
        # A line of several pieces moves as one: each point by what its way from the start asks for.
        start, end, wider, higher = start[line], end[line], wider[line], higher[line]
        at_start, at_end = (way[:, None] for way in _ways(strokes, line))
        start, end = (1 - at_start) * start + at_start * end, (1 - at_end) * start + at_end * end
    moved = strokes.copy()
    moved[:, 1:3] += start
    moved[:, 3:5] += end
    moved[:, 5] += wider
    moved[:, 6] += higher
    is_ring = strokes[:, 0] == RING
    moved[is_ring, 4] = 0.0
    moved[is_ring, 3] = np.maximum(moved[is_ring, 3], 0.0)
    is_narrow, is_missing = moved[:, 5] < config.smallest_width_m, moved[:, 6] < 0
    moved[is_narrow, 5] = config.smallest_width_m
    moved[is_missing, 6] = 0.0
    return moved, {"narrow_strokes": _lines_of(is_narrow, line), "missing_strokes": _lines_of(is_missing, line)}


def _lines_of(rows: npt.NDArray[np.bool_], line: npt.NDArray[np.intp] | None) -> int:
    """How many lines have one of these rows."""
    return int(rows.sum()) if line is None else len(set(line[rows].tolist()))


def _ways(strokes: FloatArray, line: npt.NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """How far along its line each stroke starts and ends, from 0 to 1; shape [L] each."""
    lengths = np.hypot(*(strokes[:, 3:5] - strokes[:, 1:3]).T)
    is_alone = np.bincount(line, minlength=1)[line] == 1
    lengths[(strokes[:, 0] == BEGIN) | (strokes[:, 0] == RING)] = 0.0
    total = np.bincount(line, lengths)[line]
    ends = np.cumsum(lengths)
    before = (ends - lengths)[strokes[:, 0] != JOINED][line]
    at_end = (ends - before) / np.where(total > 0, total, 1.0)
    at_start = (ends - lengths - before) / np.where(total > 0, total, 1.0)
    # A drop's ends are its start and its end, as a ring's are its centre and radius.
    return np.where(is_alone, 0.0, at_start), np.where(is_alone, 1.0, at_end)


def padded(strokes: list[FloatArray]) -> npt.NDArray[np.float32]:
    """Strokes of several reliefs in one array, shape [B, L, 7]; what is missing has height 0."""
    batch = np.zeros((len(strokes), max([1, *map(len, strokes)]), len(STROKE_COLUMNS)), dtype=np.float32)
    for row, values in zip(batch, strokes, strict=True):
        row[: len(values)] = values
    return batch


def strokes_of(lines: list[Line]) -> FloatArray:
    """Strokes, shape [L, 7], of printed lines."""
    rows = [(SEGMENT, *line.start_m, *line.end_m, line.width_m, line.height_m) for line in lines]
    return np.array(rows, dtype=np.float64).reshape(-1, len(STROKE_COLUMNS))


def picture_rows(image: npt.NDArray[Any], rows: int = 48) -> tuple[str, ...]:
    """A picture as ``PictureConfig.rows``: dark is fibre, as ink on paper.

    Args:
        image: grey values, shape [H, W], any range.
        rows: height of the result; its width follows the image's shape.

    Raises:
        InputError: no grey image, or one without contrast.
    """
    from skimage.transform import resize

    if image.ndim != 2 or min(image.shape) < 2:
        raise InputError(f"picture has shape {list(image.shape)}; give a grey image [H, W]")
    grey = image.astype(np.float64)
    if not np.isfinite(grey).all() or np.ptp(grey) == 0:
        raise InputError("picture has no contrast or is not finite; give dark shapes on a bright ground")
    columns = max(1, round(rows * image.shape[1] / image.shape[0]))
    small = resize(grey, (rows, columns), order=1, anti_aliasing=True)
    dark = small < (grey.min() + grey.max()) / 2
    return tuple("".join("#" if cell else "." for cell in row) for row in dark)


def _lines(config: ReliefConfig, rng: np.random.Generator) -> FloatArray:
    count = drawn_count(config.line_count, rng)
    strokes = np.zeros((count, len(STROKE_COLUMNS)))
    strokes[:, 1:3] = rng.uniform(*config.line_start_m, (count, 2))
    strokes[:, 3:5] = rng.uniform(*config.line_end_m, (count, 2))
    strokes[:, 5], strokes[:, 6] = drawn_sizes(config, rng, count)
    return strokes


def _raster(config: RasterConfig, rng: np.random.Generator) -> FloatArray:
    count = drawn_count(config.line_count, rng)
    angle, length = rng.uniform(*config.angle_rad), rng.uniform(*config.length_m)
    spacing, centre = rng.uniform(*config.spacing_m), rng.uniform(*config.centre_m, 2)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    middles = centre + (np.arange(count) - (count - 1) / 2)[:, None] * spacing * across
    strokes = np.zeros((count, len(STROKE_COLUMNS)))
    strokes[:, 1:3] = middles - length / 2 * along
    strokes[:, 3:5] = middles + length / 2 * along
    strokes[:, 5], strokes[:, 6] = drawn_sizes(config, rng, 1)
    return strokes


def _rings(config: RingsConfig, rng: np.random.Generator) -> FloatArray:
    count = drawn_count(config.line_count, rng)
    strokes = np.zeros((count, len(STROKE_COLUMNS)))
    strokes[:, 0] = RING
    strokes[:, 1:3] = rng.uniform(*config.centre_m, (count, 2))
    strokes[:, 3] = rng.uniform(*config.radius_m, count)
    strokes[:, 5], strokes[:, 6] = drawn_sizes(config, rng, count)
    return strokes


def _picture(config: PictureConfig, rng: np.random.Generator) -> FloatArray:
    rows, columns = len(config.rows), len(config.rows[0])
    cell = rng.uniform(*config.size_m) / max(rows, columns)
    centre = rng.uniform(*config.centre_m, 2)
    width, height = drawn_sizes(config, rng, 1)
    strokes = []
    for r, text in enumerate(config.rows):
        y = centre[1] + ((rows - 1) / 2 - r) * cell
        # Edges of runs of #: +1 where one starts, -1 behind its end.
        edges = np.diff(np.array([0, *(character == "#" for character in text), 0], dtype=int))
        for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True):
            x0, x1 = (centre[0] + (column - (columns - 1) / 2) * cell for column in (first, last))
            strokes.append((SEGMENT, x0, y, x1, y, width[0], height[0]))
    return np.array(strokes, dtype=np.float64).reshape(-1, len(STROKE_COLUMNS))


_DRAW: dict[type[PrintedPattern], Callable[[Any, np.random.Generator], FloatArray]] = {
    ReliefConfig: _lines,
    RasterConfig: _raster,
    RingsConfig: _rings,
    PictureConfig: _picture,
    **DRAW_SHAPES,
}
