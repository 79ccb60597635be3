"""What a running training tells whoever watches it."""

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


class Observer(Protocol):
    """Watches a training."""

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
