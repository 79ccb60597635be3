"""When a command that trains stops, whatever is left of the run."""

import math
from dataclasses import dataclass, replace
from typing import Self

FINAL_SECONDS = 4.0
"""Kept free at the end of --max-time for the last validation and the files."""


@dataclass(frozen=True)
class Limits:
    """Of one command.

    Attributes:
        max_steps: optimiser steps of the run, counted from its beginning.
        deadline: ``time.monotonic()`` at which to stop.
        max_time_s: time from the first step on; however long that takes, it is made. What comes before it (libraries,
            kernels, validation images) may take minutes on a busy machine, and would leave weights that know nothing.
    """

    max_steps: int | None = None
    deadline: float | None = None
    max_time_s: float | None = None

    def counted_from(self, now: float) -> Self:
        """With the deadline that ``max_time_s`` sets where the first step begins now."""
        ends = [] if self.deadline is None else [self.deadline]
        if self.max_time_s is not None:
            ends.append(now + self.max_time_s)
        return replace(self, deadline=min(ends, default=None))

    def left_s(self, now: float) -> float:
        """Time for steps from now on [s]; infinite without a deadline."""
        return math.inf if self.deadline is None else self.deadline - now - FINAL_SECONDS

    def is_late(self, now: float, has_step: bool) -> bool:
        """Whether it is time to stop; ``has_step`` once this command has made one."""
        if self.deadline is None or (self.max_time_s is not None and not has_step):
            return False
        return now >= self.deadline - FINAL_SECONDS / 2
