"""Strokes of patterns whose lines have corners and curves, and of drops."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from data_gen.config import (
    CurvesConfig,
    DropsConfig,
    MeandersConfig,
    PolylinesConfig,
    PrintedPattern,
    TextConfig,
)
from warp_caustics.prints.chains import chains_of, rows_of
from warp_caustics.prints.curves import bezier_points, meander_points
from warp_caustics.prints.font import text_lines
from warp_caustics.prints.rows import ROW_COLUMNS
from warp_caustics.types import FloatArray

DRAWN_CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"


def drawn_count(interval: tuple[int, int], rng: np.random.Generator) -> int:
    """A whole number of an interval, both ends included."""
    return int(rng.integers(*interval, endpoint=True))


def drawn_sizes(config: PrintedPattern, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Widths and heights of lines [m], shape [count] each."""
    return rng.uniform(*config.line_width_m, count), rng.uniform(*config.line_height_m, count)


def _polylines(config: PolylinesConfig, rng: np.random.Generator) -> FloatArray:
    lines = []
    for _ in range(drawn_count(config.line_count, rng)):
        pieces = drawn_count(config.pieces, rng)
        start, first = rng.uniform(*config.start_m, 2), rng.uniform(-np.pi, np.pi)
        lengths, turns = rng.uniform(*config.piece_m, pieces), rng.uniform(*config.turn_rad, pieces)
        heading = first + np.cumsum(turns)
        steps = lengths[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        lines.append(np.concatenate([start[None], start + np.cumsum(steps, axis=0)]))
    return _strokes(lines, *drawn_sizes(config, rng, len(lines)))


def _curves(config: CurvesConfig, rng: np.random.Generator) -> FloatArray:
    counts = [drawn_count(config.control_count, rng) for _ in range(drawn_count(config.line_count, rng))]
    lines = [bezier_points(rng.uniform(*config.control_m, (count, 2))) for count in counts]
    return _strokes(lines, *drawn_sizes(config, rng, len(lines)))


def _meanders(config: MeandersConfig, rng: np.random.Generator) -> FloatArray:
    lines = []
    for _ in range(drawn_count(config.line_count, rng)):
        centre, rows = rng.uniform(*config.centre_m, 2), drawn_count(config.rows, rng)
        length, spacing, angle = (
            float(rng.uniform(*interval)) for interval in (config.length_m, config.spacing_m, config.angle_rad)
        )
        lines.append(meander_points(centre.tolist(), length, spacing, rows, angle))
    return _strokes(lines, *drawn_sizes(config, rng, len(lines)))


def _drops(config: DropsConfig, rng: np.random.Generator) -> FloatArray:
    count = drawn_count(config.line_count, rng)
    lines = list(rng.uniform(*config.centre_m, (count, 1, 2)))
    return _strokes(lines, *drawn_sizes(config, rng, count))


def _text(config: TextConfig, rng: np.random.Generator) -> FloatArray:
    characters = rng.integers(len(DRAWN_CHARACTERS), size=drawn_count(config.characters, rng))
    drawn = "".join(DRAWN_CHARACTERS[character] for character in characters)
    height, angle, centre = (
        rng.uniform(*config.cap_height_m), rng.uniform(*config.angle_rad), rng.uniform(*config.centre_m, 2)
    )  # fmt: skip
    lines = text_lines(config.text or drawn, float(height), (float(centre[0]), float(centre[1])), float(angle))
    width, crown = drawn_sizes(config, rng, 1)
    return _strokes(lines, np.repeat(width, len(lines)), np.repeat(crown, len(lines)))


def _strokes(lines: Sequence[FloatArray], widths_m: FloatArray, heights_m: FloatArray) -> FloatArray:
    if not lines:
        return np.zeros((0, len(ROW_COLUMNS)))
    return rows_of(chains_of(lines, widths_m, heights_m))


DRAW_SHAPES: dict[type[PrintedPattern], Callable[[Any, np.random.Generator], FloatArray]] = {
    PolylinesConfig: _polylines,
    CurvesConfig: _curves,
    MeandersConfig: _meanders,
    DropsConfig: _drops,
    TextConfig: _text,
}
