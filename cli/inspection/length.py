"""Lengths on the command line: 50um, 0.05mm, or plain metres."""

import math
import re

import click

UNITS_M = {
    "": 1.0,
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "\N{MICRO SIGN}m": 1e-6,
    "\N{GREEK SMALL LETTER MU}m": 1e-6,
}
MAX_LENGTH_M = 1.0
_PATTERN = re.compile(r"\s*([-+0-9.eE]+)\s*([^\s0-9]*)\s*")


def length(text: str) -> float:
    """Option type: a length [m] at least 0, with a unit (m, cm, mm, um) or in metres."""
    match = _PATTERN.fullmatch(text)
    try:
        value = float(match[1]) * UNITS_M[match[2]] if match else math.nan
    except (ValueError, KeyError):
        value = math.nan
    if not math.isfinite(value):
        raise click.BadParameter(f"{text!r} is no length; write 50um, 0.05mm or 5e-5 (metres)")
    if not 0 <= value < MAX_LENGTH_M:
        raise click.BadParameter(
            f"{text!r} is {value:g} m, not between 0 and {MAX_LENGTH_M:g} m; give a unit such as um"
        )
    return value
