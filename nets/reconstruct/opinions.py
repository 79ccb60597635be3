"""Whose answer to take: the network made for a scene, the one that is told of its bench, or both.

The first has seen only that bench, and is the better one there, on lines; the second has seen any bench, rings, drops,
meanders and plates wider beside their lines. Neither knows which of them an image is. What each leaves of the image
does: on rings the scene's own left 0.10 to 0.14 of it at an error of 12 to 39 um, the other 0.06 to 0.12 at 5 to
17 um, on lines it is the other way round (before refinement, 26 plates of seeds of their own).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from nets.reconstruct.network_answers import NetworkAnswers
from warp_caustics.reconstruct.base import CausticImage, StopReason
from warp_caustics.reconstruct.run_log import RunLog, why_stopped

Residual = Callable[[torch.Tensor], float]
"""Of heights, shape [n, n]: the share of the image that their caustic leaves."""


@dataclass(frozen=True)
class Opinion:
    """Answers to rely on.

    Attributes:
        answers: heights, shape [B, n, n] [m]; none if there was no time.
        source: the network they are of; the first of both where they are of both.
        reason: ``interrupted`` or ``converged``.
        record: which was taken, and what each leaves; empty where there was but one.
    """

    answers: torch.Tensor
    source: NetworkAnswers
    reason: StopReason = "converged"
    record: dict[str, Any] = field(default_factory=dict)


def opinion(networks: Sequence[NetworkAnswers], image: CausticImage, residual: Residual, log: RunLog) -> Opinion:
    """The answers of the network, or of the networks together, that leave the least of an image.

    The second is asked for one batch first, and for the rest only if that leaves less than the first's.

    Args:
        networks: one or two, the one that was made for the scene first.
        image: at its exposure.
        residual: of heights.
        log: told of each batch.
    """
    first, n = networks[0], networks[0].network.seen.working.height_samples
    log.total = sum(each.batches for each in networks)
    answers = torch.empty(0, n, n, device=first.device)
    record: dict[str, Any] = {}
    try:
        for batch in first(image):
            answers = torch.cat([answers, batch])
            log.note("network", None, symmetries=len(answers))
        if len(networks) == 1:
            return Opinion(answers, first)
        second = networks[1]
        others = torch.empty_like(answers[:0])
        record = {"first": first.network.file, "second": second.network.file, "taken": "first"}
        for batch in second(image):
            others = torch.cat([others, batch])
            log.note("second network", None, symmetries=len(others))
            if len(others) == len(batch):  # the first batch
                told = {"first": residual(answers[: len(batch)].mean(0)), "second": residual(others.mean(0))}
                record["residual_at_a_glance"] = told
                if told["second"] >= told["first"]:
                    return Opinion(answers, first, record=record)
        choices = {
            "first": (answers, first),
            "second": (others, second),
            "both": (torch.cat([answers, others]), first),
        }
        left = {name: residual(of.mean(0)) for name, (of, _) in choices.items()}
        taken = min(left, key=lambda name: left[name])
        found, source = choices[taken]
        return Opinion(found, source, record=record | {"taken": taken, "residual": left})
    except KeyboardInterrupt as stop:
        return Opinion(answers, first, why_stopped(stop), record)
