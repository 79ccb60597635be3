"""Whether heights may be wrong by much more than they say: one decision, from all that a result knows of itself.

    E^2 = (max(1, r)^2 u_image^2 + u_bench^2) / u^2

is the error that is to be expected over the stated uncertainty u. What is left of the image is r times what reliefs
leave that are off by u_image; parts of the bench leave nothing of an image, for heights make up for them. How well they
are known is in u_bench, by what the user says or the image tells of the care that was taken
(:mod:`~warp_caustics.found_bench.care`).

A number of the bench that was found to be another is part of u, by as much as it is uncertain. It is told, and is no
doubt; in a result whose uncertainty has no part of it, it is.

Lines are few numbers, which free heights would outdo wherever they are wrong: what lines leave of the image is no part
of r. Where they leave several times its noise, lines are missing, or the bench is other in ways that were not found;
no uncertainty of theirs means anything then.

Ratios of parts of the image, and the area of dirt, were tried and tell nothing (docs/trust.md).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from warp_caustics.found_bench.rest_causes import Cause

MOST_TIMES = 1.5
"""Error to be expected, over the stated uncertainty, up to which nothing is said. At 1.5, one that is three times the
stated uncertainty is two deviations away: one result in twenty would be wrong."""

UNEXPLAINED = 4.0
"""Times the noise, that straight lines leave, from which on they are in doubt. Wrong in places they leave up to 3 as a
rule: 60 of 61 results by lines on benches as told, or nearly, were within 2.5, one at 3.1. Of plates behind 1 mm of
air, told as lying on the screen, they left 8.4 times the noise, 260 um off, 24 stated. Lines with corners and curves
have been asked how far light goes, and missing strokes tell nothing of it: a text with some left 6, 1.0 um off."""


@dataclass(frozen=True)
class Doubt:
    """How wrong heights may be, and why.

    Attributes:
        times: error to be expected over the stated uncertainty (root mean squares over the plate); None without one.
        ratio: of what is left of the image to what the uncertainty leaves; None without one.
        apart: causes that heights have made up for, and that no uncertainty has a part of.
        left: of the image by lines, in units of its noise; 0 of heights that are no lines.
    """

    times: float | None
    ratio: float | None
    apart: tuple[Cause, ...] = ()
    left: float = 0.0

    @property
    def is_doubtful(self) -> bool:
        """Whether a warning is due."""
        is_unexplained = self.left > UNEXPLAINED
        return bool(self.apart) or is_unexplained or (self.times is not None and self.times > MOST_TIMES)

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {"times": self.times, "is_doubtful": self.is_doubtful}

    def warnings(self) -> list[str]:
        """What the user should know."""
        told = []
        if self.apart:
            told.append(
                "the image looks as of a bench other than told, and heights have made up for some of it: "
                f"{'; '.join(cause.words for cause in self.apart)}; measure it, or take --set-up estimate"
            )
        if self.times is not None and self.times > MOST_TIMES:
            told.append(
                f"{self.ratio:.2g} times as much is left of the image as heights would leave that are as uncertain as "
                f"is said (limit {MOST_TIMES:g}): they may be wrong by more; check lamp, place and camera"
            )
        if self.left > UNEXPLAINED:
            told.append(
                f"lines leave {self.left:.2g} times the noise of the image (limit {UNEXPLAINED:g}): they are wrong, or "
                "the bench is not as told, and heights may be wrong by more than is said; check gap, base and lamp"
            )
        return told


def left_by_lines(counters: Mapping[str, Any]) -> float:
    """What straight lines leave of the image, in units of its noise; 0 of other results, or where that is not known.

    Args:
        counters: of a result.
    """
    are_straight = counters.get("explained_by") == "fibres" and "curves" not in counters
    return (counters.get("discrepancy") or 0.0) if are_straight else 0.0


def doubt_of(counters: Mapping[str, Any], stated_um: float | None) -> Doubt:
    """Whether heights may be wrong by much more than they say.

    Args:
        counters: of a result, with what is left of its image and the parts of its uncertainty.
        stated_um: root mean square of the stated uncertainty over the plate [um]; None without one.
    """
    rest, parts = counters["rest"], counters.get("uncertainty")
    known = {} if parts is None else parts["numbers"]
    bench = tuple(Cause(**cause) for cause in rest["causes"] if cause["is_bench"])
    apart = tuple(cause for cause in bench if cause.name not in known)
    ratio, left = rest["ratio"], left_by_lines(counters)
    if stated_um is None:
        return Doubt(None, ratio, apart, left)
    image, of_bench = (stated_um, 0.0) if parts is None else (parts["network_um"], parts["bench_um"])
    expected = math.hypot(max(1.0, ratio or 0.0) * image, of_bench)
    return Doubt(expected / math.hypot(image, of_bench, 1e-12), ratio, apart, left)
