"""What a running reconstruction has done so far: its history, whom it tells, and when it must stop."""

import dataclasses
import time
from dataclasses import dataclass, field
from typing import Any

from warp_caustics.reconstruct.base import Progress, ProgressCallback, StopReason
from warp_caustics.reconstruct.objective import Evaluation


class StopRun(KeyboardInterrupt):
    """A limit is reached. Ends a run as Ctrl-C does, so whatever keeps its best then keeps it here too.

    Never leaves a method: each catches KeyboardInterrupt, and :func:`why_stopped` tells the two apart.
    """

    def __init__(self, reason: StopReason):
        super().__init__(reason)
        self.reason: StopReason = reason


def why_stopped(stop: KeyboardInterrupt) -> StopReason:
    """The limit that was reached, or that somebody interrupted."""
    return stop.reason if isinstance(stop, StopRun) else "interrupted"


@dataclass
class RunLog:
    """History and limits of one run.

    Attributes:
        total: iterations planned, an upper bound.
        progress: called after each.
        max_time_s: limit [s] from the log's making; None for none.
        discrepancy: multiple of the noise at which nothing is left to explain; 0 for never.
        history: one entry per iteration: stage, iteration, residual, elapsed_s, and what the method adds.
    """

    total: int
    progress: ProgressCallback | None = None
    max_time_s: float | None = None
    discrepancy: float = 0.0
    started: float = field(default_factory=time.perf_counter)
    history: list[dict[str, Any]] = field(default_factory=list)

    @property
    def elapsed_s(self) -> float:
        """Time since the start [s]."""
        return time.perf_counter() - self.started

    def note(self, stage: str, residual: float | None, *, noise: float | None = None, **figures: Any) -> None:
        """Record an iteration and tell of it.

        Args:
            stage: in words.
            residual: relative, or what stands for it; None where the method knows none.
            noise: discrepancy in units of the noise, as the limit counts it; None if unknown.
            figures: further entries of the history.

        Raises:
            StopRun: the noise is reached (Morozov's discrepancy principle), or the time is up.
        """
        elapsed, number = self.elapsed_s, len(self.history) + 1
        entry = {"stage": stage, "iteration": number, "residual": residual}
        self.history.append(entry | figures | {"elapsed_s": elapsed})
        if self.progress is not None:
            shown = float("nan") if residual is None else residual
            self.progress(Progress(stage, number, max(self.total, number), shown, elapsed))
        if noise is not None and noise <= self.discrepancy:
            raise StopRun("discrepancy")
        if self.max_time_s is not None and elapsed > self.max_time_s:
            raise StopRun("max_time")


def note_evaluation(log: RunLog, stage: str, evaluation: Evaluation) -> None:
    """Record an evaluation of a descent.

    Raises:
        StopRun: the noise is reached, or the time is up.
    """
    objective, residual, noise = evaluation
    log.note(stage, residual, noise=noise, objective=objective, discrepancy=noise)


def following(
    progress: ProgressCallback | None, before: int, started: float, prefix: str = ""
) -> ProgressCallback | None:
    """A callback for a later part of a run, which counts on from the parts before.

    Args:
        progress: of the whole run.
        before: iterations done.
        started: of the whole run, by ``time.perf_counter``.
        prefix: to the stage.
    """
    if progress is None:
        return None
    report = progress

    def shifted(state: Progress) -> None:
        report(
            dataclasses.replace(
                state,
                stage=prefix + state.stage,
                iteration=before + state.iteration,
                total=before + state.total,
                elapsed_s=time.perf_counter() - started,
            )
        )

    return shifted
