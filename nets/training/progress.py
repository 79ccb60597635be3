"""What a running training tells whoever watches it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from warp_caustics.errors import InputError

StopReason = str
"""``finished``, ``early_stopping``, ``max_steps``, ``max_time``, ``interrupted`` (Ctrl-C) or
``terminated`` (SIGTERM)."""


class DivergedError(InputError):
    """Loss or weights are no numbers any more."""


@dataclass(frozen=True)
class TrainingProgress:
    """State of a run after some steps.

    Attributes:
        step: optimiser steps done.
        share: of the whole run that is done, 0 to 1; None where its end is not known.
        elapsed_s: training time over all commands of the run.
        loss: mean since the last report.
        samples_per_s: over all devices.
        simulator_share: of the time that making batches takes.
        learning_rate: of the last step.
        validation: latest measures by name; empty before the first.
        is_validation: the measures are new.
    """

    step: int
    share: float | None
    elapsed_s: float
    loss: float
    samples_per_s: float
    simulator_share: float
    learning_rate: float
    validation: dict[str, float] = field(default_factory=dict)
    is_validation: bool = False


def ahead(spent_s: float, ways: Sequence[tuple[float, float, float]]) -> tuple[float | None, float | None]:
    """Share of the work that is done, and the time left [s]; None where no end is known.

    Args:
        spent_s: time so far [s].
        ways: where the work began, is and ends, once for each limit (steps, time, ...); the nearest end counts.
    """
    shares = [(now - first) / (end - first) for first, now, end in ways if end > first]
    if not shares:
        return None, None
    share = min(1.0, max(shares))
    return share, spent_s * (1 - share) / share if share > 0 else None


class Observer(Protocol):
    """Watches a training."""

    def stage(self, what: str, done: int, total: int) -> None:
        """Work that is no step, such as making validation samples; called as it begins and goes on.

        Args:
            what: in plain words.
            done: parts of it.
            total: parts of it; 0 where they are not counted.
        """

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        """Called after every step; waits for no device.

        Args:
            step: optimiser steps done.
            share: of this command that is done, 0 to 1; None where its end is not known.
            left_s: time left of this command [s]; None where it is not known.
        """

    def show(self, progress: TrainingProgress) -> None:
        """Called now and then."""

    def note(self, text: str) -> None:
        """Something worth a line."""

    def warn(self, text: str) -> None:
        """Something the user should know."""


@dataclass(frozen=True)
class TrainingResult:
    """How a command ended.

    Attributes:
        stop_reason: why.
        step: optimiser steps of the run so far.
        elapsed_s: training time of the run so far.
        best: lowest objective of a validation; None before the first.
        objective: its name.
        validation: latest measures.
        weights: exported file; None if there is none.
    """

    stop_reason: StopReason
    step: int
    elapsed_s: float
    best: float | None
    objective: str
    validation: dict[str, float]
    weights: str | None
