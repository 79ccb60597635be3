"""Whether results say so where they are wrong: what their doubt is worth as a detector.

A result is wrong where it is off by more than three times what it states, and flagged where it says itself that its
heights may be wrong by more than that (``counters["doubt"]``, :mod:`warp_caustics.found_bench.doubt`).
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

WRONG = 3.0
"""Error over stated uncertainty, root mean squares over the plate, above which a result is wrong."""


class Detection(NamedTuple):
    """Counts of results that state an uncertainty.

    Attributes:
        wrong: off by more than :data:`WRONG` times what they state.
        wrong_flagged: of these, that say so.
        good: all others.
        good_flagged: of these, that say so all the same.
    """

    wrong: int
    wrong_flagged: int
    good: int
    good_flagged: int

    @property
    def line(self) -> str:
        """For people."""
        return (
            f"{self.wrong} of {self.wrong + self.good} results are off by more than {WRONG:g} times what they state, "
            f"{self.wrong_flagged} of them say so; of the {self.good} others {self.good_flagged} say so"
        )


def is_wrong(rmse_um: float, stated_um: float) -> bool:
    """Whether a result is worse than :data:`WRONG` times what it says, both root mean squares [um]."""
    return rmse_um > WRONG * stated_um


def detection(rows: Iterable[Mapping[str, Any]]) -> Detection:
    """Counts over rows with ``rmse_um``, ``stated_um`` and ``doubted``; those that lack one are left out."""
    found = [
        (is_wrong(row["rmse_um"], row["stated_um"]), bool(row["doubted"]))
        for row in rows
        if all(row.get(key) is not None for key in ("rmse_um", "stated_um", "doubted"))
    ]
    wrong = [flagged for wrong, flagged in found if wrong]
    good = [flagged for wrong, flagged in found if not wrong]
    return Detection(len(wrong), sum(wrong), len(good), sum(good))
