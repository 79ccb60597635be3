"""Numbers as people read them."""

import math
from typing import Any


def number(value: Any, digits: int = 3) -> str:
    """A number with so many digits, without an exponent where it is easy to read; ``"n/a"`` where there is none.

    Args:
        value: a number, or None.
        digits: significant ones; those before the decimal point are never cut.
    """
    if value is None or isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "n/a"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    # Rounded first: 999.7 has four digits before the point when it is written with three.
    rounded = float(f"{value:.{digits - 1}e}")
    places = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
