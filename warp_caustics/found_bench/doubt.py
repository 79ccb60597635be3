"""Whether heights may be wrong by much more than they say: one decision, from all that a result knows of itself.

    E^2 = (max(1, r)^2 u_image^2 + u_bench^2) / u^2

is the error that is to be expected over the stated uncertainty u. What is left of the image is r times what reliefs
leave that are off by u_image; parts of the bench leave nothing of an image, for heights make up for them. How well they
are known is in u_bench, by what the user says or the image tells of the care that was taken
(:mod:`~warp_caustics.found_bench.care`).

A number of the bench that was found to be another is part of u, by as much as it is uncertain. It is told, and is no
doubt; in a result whose uncertainty has no part of it, it is.

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


@dataclass(frozen=True)
class Doubt:
    """How wrong heights may be, and why.

    Attributes:
        times: error to be expected over the stated uncertainty (root mean squares over the plate); None without one.
        ratio: of what is left of the image to what the uncertainty leaves; None without one.
        apart: causes that heights have made up for, and that no uncertainty has a part of.
    """

    times: float | None
    ratio: float | None
    apart: tuple[Cause, ...] = ()

    @property
    def is_doubtful(self) -> bool:
        """Whether a warning is due."""
        return bool(self.apart) or (self.times is not None and self.times > MOST_TIMES)

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
        return told


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
    ratio = rest["ratio"]
    if stated_um is None:
        return Doubt(None, ratio, apart)
    image, of_bench = (stated_um, 0.0) if parts is None else (parts["network_um"], parts["bench_um"])
    expected = math.hypot(max(1.0, ratio or 0.0) * image, of_bench)
    return Doubt(expected / math.hypot(image, of_bench, 1e-12), ratio, apart)
