"""What the readers of all formats hand over, and the checks they share."""

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.io.image_file import Array


@dataclass
class Decoded:
    """What a format's reader hands over: numbers as stored, channel first where the format tells."""

    array: Array
    description: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def own_description(text: str) -> dict[str, Any]:
    """The JSON description this package writes, or an empty one for foreign text."""
    try:
        description = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return description if isinstance(description, dict) and description.get("software") == "nsfc" else {}


def check_orientation(name: str, orientation: int) -> None:
    """Refuse a file that asks viewers to turn it.

    Raises:
        InputError: the EXIF orientation is not 1.
    """
    if orientation != 1:
        raise InputError(
            f"{name} asks viewers to rotate or mirror it (EXIF orientation {orientation}); "
            "export it upright, without that tag"
        )


def without_alpha(array: Array, name: str, notes: list[str]) -> Array:
    """Drop an opaque last channel; refuse one that hides something."""
    opaque = np.iinfo(array.dtype).max if array.dtype.kind == "u" else 1
    if np.any(array[-1] != opaque):
        raise InputError(f"{name} is partly transparent; export it without an alpha channel")
    notes.append("an opaque alpha channel was dropped")
    return array[:-1]
