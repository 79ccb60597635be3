"""Words of a printed design and their values: lengths with their unit in the name, angles, numbers, points."""

import math
import re
from collections.abc import Mapping
from typing import Any

from warp_caustics.errors import InputError, known_names
from warp_caustics.prints.font import MOST_CHARACTERS

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
ANGLE_UNITS = {"deg": math.pi / 180, "rad": 1.0}
MOST_POINTS = 4096

LENGTHS = (
    "start_x",
    "start_y",
    "end_x",
    "end_y",
    "width",
    "height",
    "fibre_diameter",
    "radius",
    "length",
    "spacing",
    "cap_height",
    "sideways",
    "wavelength",
    "end_length",
    "bow",
    "base_wave",
    "base_wavelength",
)
PLACES = ("centre",)
CHAINS = ("points", "control")
ANGLES = ("contact_angle", "angle", "base_wave_angle")
NUMBERS = ("exponent", "reach", "waviness", "end_thickness")
COUNTS = ("passes", "rows", "seed")
TEXTS = ("shape", "section", "text")

_DECIMAL = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*", re.ASCII)
"""What a cell may hold: Python's float() also takes 1_0, and digits of other scripts."""


def word_of(key: str) -> str | None:
    """The word of a key, ``width`` of ``width_mm``; None if no design knows it."""
    word, _, unit = key.rpartition("_")
    if unit in UNITS and word in (*LENGTHS, *PLACES, *CHAINS):
        return word
    if unit in ANGLE_UNITS and word in ANGLES:
        return word
    return key if key in (*NUMBERS, *COUNTS, *TEXTS, "merge") else None


def number_of(value: Any) -> float:
    """The number that a cell or a YAML scalar holds; NaN where it holds none."""
    if isinstance(value, str):
        return float(value) if _DECIMAL.fullmatch(value) else math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def design_values(row: Mapping[str, Any], where: str, allowed: tuple[str, ...]) -> dict[str, Any]:
    """Values of a design's words in SI units; empty cells are left out.

    Args:
        row: key to value, as read.
        where: file and line, for messages.
        allowed: words that may stand there.

    Raises:
        InputError: an unknown key, a word given twice, or a value of another kind.
    """
    values: dict[str, Any] = {}
    for key, value in row.items():
        word = word_of(str(key))
        if word is None or word not in allowed:
            raise InputError(f"{where}: {str(key)!r} is not known here; {known_names(str(key), _spelled(allowed))}")
        if value is None or (isinstance(value, str) and not value.strip()):
            continue
        if word in values:
            raise InputError(f"{where}: {word} is given twice; keep one unit")
        values[word] = _value(word, str(key), value, where)
    return values


def _spelled(words: tuple[str, ...]) -> list[str]:
    lengths = (*LENGTHS, *PLACES, *CHAINS)
    return [f"{word}_mm" if word in lengths else f"{word}_deg" if word in ANGLES else word for word in words]


def _value(word: str, key: str, value: Any, where: str) -> Any:
    if word in TEXTS:
        if not isinstance(value, str | int) or len(str(value)) > MOST_CHARACTERS:
            raise InputError(f"{where}: {key} is {str(value)[:40]!r}; give a word")
        return str(value)
    if word == "merge":
        return value.strip() if isinstance(value, str) else value
    if word in CHAINS:
        if not isinstance(value, list) or not 1 <= len(value) <= MOST_POINTS:
            raise InputError(f"{where}: {key} is no list of points; write [[0, 0], [10, 5]]")
        return [_place(key, point, where) for point in value]
    if word in PLACES:
        return _place(key, value, where)
    return _scaled(word, key, value, where)


def _place(key: str, value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{where}: {key} holds {str(value)[:40]!r}, which is no point; write [x, y]")
    x, y = (_scaled("centre", key, part, where) for part in value)
    return x, y


def _scaled(word: str, key: str, value: Any, where: str) -> float:
    number = number_of(value)
    if not math.isfinite(number):
        raise InputError(f"{where}: {key} is {str(value)[:40]!r}, not a finite number; write for example 1.5")
    if word in COUNTS:
        if number != int(number) or not 0 <= number < 2**63:
            raise InputError(f"{where}: {key} is {number:g}; give a whole number")
        return int(number)
    if word in NUMBERS:
        return number
    unit = key.rpartition("_")[2]
    if word in ANGLES:
        return number * ANGLE_UNITS[unit]
    if abs(number * UNITS[unit]) > 1:
        raise InputError(f"{where}: {key} is {number:g}, above 1 m; check the units in the names (_m, _mm, _um)")
    return number * UNITS[unit]
