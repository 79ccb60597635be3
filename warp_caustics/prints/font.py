"""A stroke font: capitals, digits and a few signs, as the single lines in which a fibre writes them.

A glyph is strokes, separated by semicolons; a stroke is points (x, y) in sixths of the height of a capital, and ~ marks
the control point of a quadratic Bezier curve between its neighbours. A stroke of one point is a drop.
"""

import math

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.prints.curves import FLATNESS_M, bezier_points, placed
from warp_caustics.types import FloatArray

CAP_HEIGHT = 6.0
GAP = 1.6
"""Between letters, in sixths of the height of a capital."""
LINE_FEED = 9.5
"""From one line of text to the next."""
MOST_CHARACTERS = 500

_BOWL = "0,6 2.4,6 ~4,6 4,4.4 ~4,2.8 2.4,2.8 0,2.8"
_ROUND = "2.1,6 ~0,6 0,3 ~0,0 2.1,0 ~4.2,0 4.2,3 ~4.2,6 2.1,6"
GLYPHS: dict[str, str] = {
    "A": "0,0 2,6 4,0; 0.67,2 3.33,2",
    "B": "0,0 0,6 2.4,6 ~3.9,6 3.9,4.6 ~3.9,3.2 2.4,3.2 0,3.2; 2.4,3.2 ~4.2,3.2 4.2,1.6 ~4.2,0 2.4,0 0,0",
    "C": "4,5 ~3.3,6 2.1,6 ~0,6 0,3 ~0,0 2.1,0 ~3.3,0 4,1",
    "D": "0,0 0,6 1.8,6 ~4.1,6 4.1,3 ~4.1,0 1.8,0 0,0",
    "E": "3.8,6 0,6 0,0 3.8,0; 0,3.1 3,3.1",
    "F": "3.8,6 0,6 0,0; 0,3.1 3,3.1",
    "G": "4,5 ~3.3,6 2.1,6 ~0,6 0,3 ~0,0 2.1,0 ~4.1,0 4.1,2.7 2.4,2.7",
    "H": "0,0 0,6; 4,0 4,6; 0,3.1 4,3.1",
    "I": "0.4,0 0.4,6",
    "J": "3,6 3,1.8 ~3,0 1.5,0 ~0,0 0,1.6",
    "K": "0,0 0,6; 3.8,6 0,2.4; 1.2,3.54 4,0",
    "L": "0,6 0,0 3.5,0",
    "M": "0,0 0,6 2.4,2 4.8,6 4.8,0",
    "N": "0,0 0,6 4,0 4,6",
    "O": _ROUND,
    "P": f"0,0 {_BOWL}",
    "Q": f"{_ROUND}; 2.6,1.4 4.2,-0.5",
    "R": f"0,0 {_BOWL}; 2,2.8 4,0",
    "S": "3.8,5 ~3.2,6 2,6 ~0.2,6 0.2,4.5 ~0.2,3.3 2,3 ~3.9,2.7 3.9,1.5 ~3.9,0 2,0 ~0.7,0 0,1.1",
    "T": "0,6 4,6; 2,6 2,0",
    "U": "0,6 0,2 ~0,0 2,0 ~4,0 4,2 4,6",
    "V": "0,6 2,0 4,6",
    "W": "0,6 1.4,0 2.7,4.4 4,0 5.4,6",
    "X": "0,0 4,6; 0,6 4,0",
    "Y": "0,6 2,3 4,6; 2,3 2,0",
    "Z": "0,6 4,6 0,0 4,0",
    "0": "1.9,6 ~0,6 0,3 ~0,0 1.9,0 ~3.8,0 3.8,3 ~3.8,6 1.9,6; 1.2,1.9 2.6,4.1",
    "1": "0,4.6 1.5,6 1.5,0",
    "2": "0.1,4.7 ~0.4,6 2,6 ~3.7,6 3.7,4.5 ~3.7,3.4 2.4,2.2 0,0 3.8,0",
    "3": "0.2,5.1 ~0.8,6 1.9,6 ~3.5,6 3.5,4.6 ~3.5,3.2 1.6,3.2 ~3.8,3.2 3.8,1.6 ~3.8,0 1.9,0 ~0.6,0 0,1",
    "4": "2.8,0 2.8,6 0,1.8 3.9,1.8",
    "5": "3.5,6 0.5,6 0.3,3.2 ~1,3.7 1.9,3.7 ~3.8,3.7 3.8,1.9 ~3.8,0 1.8,0 ~0.6,0 0,0.9",
    "6": "3.3,5.4 ~2.8,6 2,6 ~0,6 0,2.4 ~0,0 1.9,0 ~3.8,0 3.8,1.9 ~3.8,3.7 1.9,3.7 ~0.4,3.7 0,2",
    "7": "0,6 3.8,6 1.3,0",
    "8": (
        "1.9,3.2 ~0.2,3.2 0.2,4.6 ~0.2,6 1.9,6 ~3.6,6 3.6,4.6 ~3.6,3.2 1.9,3.2 "
        "~0,3.2 0,1.6 ~0,0 1.9,0 ~3.8,0 3.8,1.6 ~3.8,3.2 1.9,3.2"
    ),
    "9": "3.8,3.9 ~3.4,2.3 1.9,2.3 ~0,2.3 0,4.1 ~0,6 1.9,6 ~3.8,6 3.8,3.6 ~3.8,0 1.8,0 ~1,0 0.5,0.6",
    ".": "0.3,0.2",
    ",": "0.6,0.3 0.1,-0.9",
    ":": "0.3,0.6; 0.3,3.6",
    "!": "0.3,6 0.3,2; 0.3,0.2",
    "?": "0.1,4.8 ~0.4,6 1.9,6 ~3.6,6 3.6,4.5 ~3.6,3.3 1.9,2.7 1.9,1.9; 1.9,0.2",
    "-": "0,2.8 2.4,2.8",
    "+": "0,2.8 3.2,2.8; 1.6,1.2 1.6,4.4",
    "=": "0,2 3,2; 0,3.6 3,3.6",
    "/": "0,0 3,6",
    " ": "",
}
SPACE = 2.4
"""Width of a blank."""


def text_lines(
    text: str,
    cap_height_m: float,
    centre_m: tuple[float, float] = (0.0, 0.0),
    angle_rad: float = 0.0,
    flatness_m: float = FLATNESS_M,
) -> list[FloatArray]:
    """Strokes of a text, each as points [m], shape [k, 2].

    Args:
        text: capitals, digits, blanks and the signs of ``GLYPHS``; a newline begins another line below.
        cap_height_m: height of a capital [m].
        centre_m: centre of the text's box [m].
        angle_rad: direction of writing, from the x axis [rad].
        flatness_m: largest distance of a curve from its chain [m].

    Raises:
        InputError: a character that the font does not have, no stroke at all, or a height that is not above 0.
    """
    strange = sorted(set(text) - set(GLYPHS) - {"\n"})
    if strange:
        shown = "capitals" if strange[0].isalpha() and strange[0].upper() in GLYPHS else "".join(GLYPHS).strip()
        raise InputError(f"text holds {strange[0]!r}, which the stroke font does not have; use {shown}")
    if not text.strip() or len(text) > MOST_CHARACTERS:
        raise InputError(f"text of {len(text.strip())} characters; give 1 to {MOST_CHARACTERS}")
    if not (math.isfinite(cap_height_m) and cap_height_m > 0):
        raise InputError(f"height of capitals {cap_height_m:g} m is not above 0; give for example 6e-3")
    unit = cap_height_m / CAP_HEIGHT
    strokes = []
    rows = text.split("\n")
    for row, words in enumerate(rows):
        x = -_width(words) / 2
        y = ((len(rows) - 1) / 2 - row) * LINE_FEED - CAP_HEIGHT / 2
        for character in words:
            for stroke in _strokes(character):
                points = _flattened(stroke, flatness_m / unit) + np.array([x, y])
                strokes.append(placed(unit * points, centre_m, angle_rad))
            x += _advance(character)
    return strokes


def _width(words: str) -> float:
    return sum(map(_advance, words)) - GAP if words else 0.0


def _advance(character: str) -> float:
    strokes = _strokes(character)
    if not strokes:
        return SPACE + GAP
    return max(point[0] for stroke in strokes for point, _ in stroke) + GAP


def _strokes(character: str) -> list[list[tuple[tuple[float, float], bool]]]:
    """Strokes of a glyph: points, and whether each is a control point."""
    strokes = []
    for stroke in GLYPHS[character].split(";"):
        points = []
        for word in stroke.split():
            x, y = word.removeprefix("~").split(",")
            points.append(((float(x), float(y)), word.startswith("~")))
        if points:
            strokes.append(points)
    return strokes


def _flattened(stroke: list[tuple[tuple[float, float], bool]], flatness: float) -> FloatArray:
    points, k = [np.array([stroke[0][0]])], 1
    while k < len(stroke):
        if stroke[k][1]:
            control = np.array([stroke[k - 1][0], stroke[k][0], stroke[k + 1][0]])
            points.append(bezier_points(control, flatness)[1:])
            k += 2
        else:
            points.append(np.array([stroke[k][0]]))
            k += 1
    return np.concatenate(points)
