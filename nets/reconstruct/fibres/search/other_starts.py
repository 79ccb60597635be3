"""Lines that leave part of an image unexplained, searched for from other starts.

Where many lines lie on top of each other a search ends in one of many places, and which is luck: of crowded plates one
in five ended 10 to 60 um off, another one in the next run. The mean of a network's answers is one start. Each answer in
a symmetry is another, which errs elsewhere; a search from it is right in other places. Of both searches the lines that
are better in each place are taken, and searched on from. Before and after, lines evolve in places that stay wrong.
"""

from collections.abc import Iterator
from typing import Protocol

from nets.reconstruct.fibres.search.line_search import Answer
from nets.reconstruct.fibres.search.second_look import LOOKED_AT_SHARE, Run, network_here, searched_in, tried
from nets.reconstruct.posterior_samples import farthest

FEWEST_LINES = 8
"""Of fewer, what is left has other reasons than that one hides another."""
EVOLVING_SHARE, STARTING_SHARE = 1.5, 2.5
"""Of what the network's relief leaves of the image, that straight lines may leave to evolve where they are many, and to
be searched for elsewhere; others may leave ``LOOKED_AT_SHARE``. One of nine lines that were right but for two was 56 um
off and left 1.9 times as much; from the second of the network's single answers all eight were found, to 0.1 um. What
rings are told by leaves 3.0."""


class CrowdRun(Run, Protocol):
    """Which knows whether its lines are many."""

    is_crowd: bool

    def may_be_pieces(self) -> bool:
        """Whether lines may be pieces of curves."""


def evolve(run: CrowdRun) -> bool:
    """Have lines evolve where places are wrong (:mod:`~nets.reconstruct.fibres.search.evolution`).

    Args:
        run: of which lines were found.

    Returns:
        Whether other lines were found.

    Raises:
        KeyboardInterrupt: the best lines so far are kept.
    """
    if len(run.lines) < FEWEST_LINES or not _is_open(run, EVOLVING_SHARE if run.is_crowd else LOOKED_AT_SHARE):
        return False
    is_better, _ = tried(run, lambda: run.search(run.lines, 1, evolves=True))
    run.counters["evolved"] = run.counters.get("evolved", 0) + is_better
    return is_better


def start_elsewhere(run: CrowdRun, starts: int, evolves: bool = False) -> bool:
    """Search for lines from single answers of the network, while lines leave more than noise.

    Args:
        run: of which lines were found.
        starts: at most; those answers that lie farthest apart.
        evolves: lines that are better evolve.

    Returns:
        Whether other lines were found.

    Raises:
        KeyboardInterrupt: the best lines so far are kept.
    """
    is_better, is_straight = False, run.is_crowd or not run.may_be_pieces()
    most = STARTING_SHARE if is_straight else LOOKED_AT_SHARE
    if not starts or len(run.lines) < FEWEST_LINES or not _is_open(run, most):
        return False
    for answer in _answers(run, starts):
        has_gained = searched_in(run, answer, run.view.is_settled)
        if has_gained and evolves:
            evolve(run)
        is_better = is_better or has_gained
        run.counters["starts"] = run.counters.get("starts", 0) + 1
        if not _is_open(run, most):
            break
    return is_better


def _is_open(run: CrowdRun, most: float) -> bool:
    """Whether lines leave more than noise, and little enough to be the plate's."""
    _, left, of_network = run.left()
    return run.reason == "converged" and left <= most * of_network and not run.view.is_settled(run.lines)


def _answers(run: CrowdRun, starts: int) -> Iterator[Answer]:
    """Single answers on the bench so far, with the spread of all."""
    network = network_here(run)
    every = None if network is None else network.first_answers(run.view.image)
    if every is None or len(every) < 2:
        return
    spread = every.std(0)
    apart = (every - every.mean(0)).double().cpu().numpy()
    for k in farthest(apart, min(starts, len(every))):
        yield Answer(every[k], spread, run.most_lines)
