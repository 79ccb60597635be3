"""Bookkeeping of a descent: what was tried, and when to stop."""

import time
from dataclasses import dataclass, field
from typing import Any

from warp_caustics.reconstruct.base import Progress, ProgressCallback, StopReason
from warp_caustics.reconstruct.refine.relief_objective import Evaluation


class StopDescent(Exception):
    """Ends the present descent; carries the reason."""

    def __init__(self, reason: StopReason):
        self.reason: StopReason = reason


@dataclass
class DescentRecord:
    """History and limits of one reconstruction.

    Attributes:
        total: evaluations planned.
        progress: called after each.
        discrepancy: multiple of the noise at which nothing is left to explain; 0 for never.
        max_time_s: limit [s] from the record's making; None for none.
        history: one entry per evaluation.
    """

    total: int
    progress: ProgressCallback | None
    discrepancy: float = 0.0
    max_time_s: float | None = None
    started: float = field(default_factory=time.perf_counter)
    history: list[dict[str, Any]] = field(default_factory=list)

    @property
    def elapsed_s(self) -> float:
        """Time since the start [s]."""
        return time.perf_counter() - self.started

    def note(self, stage: str, evaluation: Evaluation) -> None:
        """Record an evaluation.

        Raises:
            StopDescent: the noise is reached, or the time is up.
        """
        objective, residual, noise = evaluation
        elapsed = self.elapsed_s
        entry = {"stage": stage, "iteration": len(self.history) + 1, "objective": objective, "residual": residual}
        self.history.append(entry | {"discrepancy": noise, "elapsed_s": elapsed})
        if self.progress is not None:
            self.progress(Progress(stage, len(self.history), self.total, residual, elapsed))
        if noise is not None and noise <= self.discrepancy:
            raise StopDescent("discrepancy")
        if self.max_time_s is not None and elapsed > self.max_time_s:
            raise StopDescent("max_time")
