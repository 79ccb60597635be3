"""The record of a result that was found after lines had been looked for in vain."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from warp_caustics.reconstruct.base import Reconstruction


def after_lines(
    found: Reconstruction,
    history: Sequence[Any],
    seconds: float,
    timings: Mapping[str, float],
    counters: Mapping[str, Any],
) -> Reconstruction:
    """The result with what went before.

    Args:
        found: without lines.
        history: of the search for lines, which comes first.
        seconds: that it took [s].
        timings: of its parts [s].
        counters: of it; they replace those of the result.
    """
    before = [entry for entry in history if isinstance(entry, dict)]
    later = [
        entry | {"iteration": len(before) + k + 1, "elapsed_s": entry["elapsed_s"] + seconds}
        for k, entry in enumerate(found.history)
    ]
    return dataclasses.replace(
        found,
        history=before + later,
        timings_s={**timings} | {_without_lines(name): value for name, value in found.timings_s.items()},
        counters=found.counters | dict(counters),
    )


def _without_lines(part: str) -> str:
    """Name of a part of the time; every result has one for its own simulation."""
    return part if part == "resimulation" else f"{part} without lines"
