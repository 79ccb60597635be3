"""Which of the answers to an image are believed: those of one network or two, at a first look or looking again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from nets.reconstruct.network_answers import NetworkAnswers
from warp_caustics.reconstruct.base import CausticImage, StopReason
from warp_caustics.reconstruct.run_log import RunLog, why_stopped

Caustic = Callable[[torch.Tensor], tuple[torch.Tensor, float]]
"""Of heights, shape [n, n]: their caustic [W/m^2], shape [n_w, m, m], and the share of the image that it leaves."""


@dataclass(frozen=True)
class Opinion:
    """Answers to rely on.

    Attributes:
        answers: heights, shape [B, n, n] [m]; none if there was no time.
        looked: answers of a first look, whose spread says how far to trust their mean; shape [B', n, n] [m]. Those that
            look again have all been given the same, and err together: their spread is two thirds of that for the same
            error.
        source: the network that they are of; the first of both where they are of both.
        looked_by: the network whose first looks ``looked`` are, to which their spread is calibrated; the second where
            they are of both.
        reason: ``interrupted`` or ``converged``.
        record: which was taken, and what each leaves; empty where there was but one.
    """

    answers: torch.Tensor
    looked: torch.Tensor
    source: NetworkAnswers
    looked_by: NetworkAnswers
    reason: StopReason = "converged"
    record: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    name: str
    answers: torch.Tensor
    looked: torch.Tensor
    source: NetworkAnswers
    looked_by: NetworkAnswers
    caustic: torch.Tensor
    residual: float


class _Hearing:
    """One image; what was answered so far."""

    def __init__(self, image: CausticImage, caustic: Caustic, log: RunLog):
        self.image, self.caustic, self.log = image, caustic, log
        self.heard: list[_Candidate] = []

    def answers(
        self, network: NetworkAnswers, note: str, again: _Candidate | None = None
    ) -> Iterator[tuple[torch.Tensor, bool]]:
        """All answers of a network so far, and whether they are the first batch.

        Args:
            network: that is asked.
            note: for the log.
            again: what it looks at again; None for a first look.
        """
        look = None if again is None else network.look(again.answers.mean(0), again.caustic)
        found = None
        for batch in network(self.image) if look is None else network(self.image, look):
            is_first, found = found is None, batch if found is None else torch.cat([found, batch])
            self.log.note(note, None, symmetries=len(found))
            yield found, is_first

    def all_answers(self, network: NetworkAnswers, note: str, again: _Candidate) -> torch.Tensor:
        """All answers of a network that looks again, shape [B, n, n] [m]."""
        *_, (answers, _) = self.answers(network, note, again)
        return answers

    def judged(
        self,
        name: str,
        answers: torch.Tensor,
        looked: torch.Tensor,
        source: NetworkAnswers,
        looked_by: NetworkAnswers,
        *,
        is_heard: bool = True,
    ) -> _Candidate:
        """Answers with what they leave of the image."""
        found = _Candidate(name, answers, looked, source, looked_by, *self.caustic(answers.mean(0)))
        if is_heard:
            self.heard.append(found)
        return found

    def best(self) -> Opinion:
        """The answers that leave the least, with a record."""
        taken = min(self.heard, key=lambda each: each.residual)
        record = {"taken": taken.name, "residual": {each.name: each.residual for each in self.heard}}
        return Opinion(taken.answers, taken.looked, taken.source, taken.looked_by, record=record)


def opinion(networks: Sequence[NetworkAnswers], image: CausticImage, caustic: Caustic, log: RunLog) -> Opinion:
    """The answers that leave the least of an image.

    One network answers, and where it has feedback looks again at its own answer. A second one that has feedback looks
    at the first's answer, for one batch: what it adds, or the mean of both, is taken where that leaves less. Where
    already this batch alone leaves less than the first network, which then does not know such a plate, it looks once
    more for itself. Without feedback the second is asked for one batch, and for the rest if that leaves less.

    Args:
        networks: one or two, the one that was made for the scene first.
        image: at its exposure.
        caustic: of heights.
        log: told of each batch.
    """
    first, n = networks[0], networks[0].network.seen.working.height_samples
    second = networks[1] if len(networks) > 1 else None
    looks_again = first.has_feedback if second is None else second.has_feedback
    log.total = sum(each.batches for each in networks) + (networks[-1].batches if looks_again else 0)
    none = torch.empty(0, n, n, device=first.device)
    best = Opinion(none, none, first, first)
    names = {"first": first.network.file} | ({} if second is None else {"second": second.network.file})
    hearing = _Hearing(image, caustic, log)
    try:
        for answers, _ in hearing.answers(first, "network"):
            best = Opinion(answers, answers, first, first)
        if second is None and not first.has_feedback:
            return best
        own = hearing.judged("first", best.answers, best.answers, first, first)
        if second is None:
            hearing.judged("first again", hearing.all_answers(first, "second look", own), own.looked, first, first)
        elif second.has_feedback:
            _looked_by(second, own, hearing)
        else:
            _asked(second, own, hearing)
        best = hearing.best()
    except KeyboardInterrupt as stop:
        return replace(best, reason=why_stopped(stop))
    return replace(best, record=names | best.record)


def _looked_by(second: NetworkAnswers, own: _Candidate, hearing: _Hearing) -> None:
    """Candidates of a network with feedback that looks at another's answer."""
    answers, _ = next(hearing.answers(second, "second network", own))
    looked = hearing.judged("second", answers, own.looked, second, own.source)
    both = torch.cat([own.answers, answers])
    hearing.judged("both", both, own.looked, own.source, own.source)
    if looked.residual < own.residual:
        answers = hearing.all_answers(second, "second look", looked)
        hearing.judged("second again", answers, torch.cat([own.looked, looked.answers]), second, second)


def _asked(second: NetworkAnswers, own: _Candidate, hearing: _Hearing) -> None:
    """Candidates of a network without feedback."""
    for answers, is_first in hearing.answers(second, "second network"):
        if is_first:
            start = own.answers[: len(answers)]
            glances = [hearing.judged("", each, each, second, second, is_heard=False) for each in (start, answers)]
            if glances[1].residual >= glances[0].residual:
                return
    hearing.judged("second", answers, answers, second, second)
    both = torch.cat([own.answers, answers])
    hearing.judged("both", both, both, own.source, second)
