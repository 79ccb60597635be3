"""Lengths as people write them: 3mm, 50um, 530nm."""

import re
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

UNITS = {
    "m": 0,
    "cm": -2,
    "mm": -3,
    "um": -6,
    "\N{MICRO SIGN}m": -6,
    "\N{GREEK SMALL LETTER MU}m": -6,
    "nm": -9,
}
"""Name of a unit to its power of ten in metres."""
_LENGTH = re.compile(r"\s*([-+]?(?:\d{1,30}\.?\d{0,30}|\.\d{1,30})(?:[eE][-+]?\d{1,3})?)\s*([a-z\u00b5\u03bc]{1,2})\s*")


def length_m(text: str) -> float | None:
    """Length [m] of a number with a unit, the float nearest to what is written; None where it is none."""
    found = _LENGTH.fullmatch(text)
    if found is None or found[2] not in UNITS:
        return None
    return float(Decimal(found[1]).scaleb(UNITS[found[2]]))


def with_lengths(value: Any) -> Any:
    """The value with every text that is a length, in lists too, as metres."""
    if isinstance(value, str):
        length = length_m(value)
        return value if length is None else length
    if isinstance(value, list | tuple):
        return type(value)(with_lengths(item) for item in value) if type(value) in (list, tuple) else value
    return value


def record_with_lengths(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record in which the keys that end in ``_m``, lengths in metres, may be written with units."""
    return {key: with_lengths(value) if str(key).endswith("_m") else value for key, value in record.items()}
