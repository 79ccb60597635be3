"""Lines that leave part of an image unexplained, looked at again.

Where many lines lie on top of each other a network misses some and takes some for others. The lines that were found
are right in most places. What they leave of the image tells more: a descent of heights begins to grow what no line is
there for, and a network with feedback, told what the lines show, sees more in the rest.
"""

from collections.abc import Callable
from typing import Any, Protocol

import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.refined_lines import ImageRun, refined
from nets.reconstruct.fibres.search.line_search import Answer
from warp_caustics.errors import MismatchError
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.vectorise import lines_of_relief
from warp_caustics.types import FloatArray

TAKEN_SHARE = 0.6
"""Lines are taken where they leave less than this share of what the network's relief leaves before it is refined, or
nothing but noise: those that leave more are not the plate's, and bend with the bench to what they cannot explain. Where
they leave more than noise, ``direct`` must leave more when both are refined."""
LOOKED_AT_SHARE = 0.8
"""The same for lines to be looked at again; two plates whose lines left 0.63 and 0.64 came down to 0.16 and 0.54."""
LOOK_FACTOR = 0.99
"""What is left of the image must fall by this factor for other lines to be taken: on five plates of six with 24 to 30
lines that explained nothing it fell by 8 to 75 %, and errors fell with it; on the other, lines were 9 um wrong instead
of 6, and left 1.1 times as much."""
HEIGHTS_SPREAD_M = 2e-5
"""Spread of heights that a descent from lines gives [m]: what it adds is mostly right in place, less so in height."""
JUMPS = 2
"""Rounds of growth and jumps in each search, at most; fewer where the method has fewer."""


class Run(ImageRun, Protocol):
    """Lines of one image, so far."""

    lines: torch.Tensor
    view: LinesView
    model: LineModel
    moves_section: bool
    is_in_vain: bool
    counters: dict[str, Any]
    most_lines: int

    def left(self) -> tuple[FloatArray, float, float]:
        """Relief of the lines, and what it and the network's leave of the image."""

    def search(
        self,
        start: torch.Tensor,
        jumps: int,
        answer: Answer | None = None,
        others: torch.Tensor | None = None,
        *,
        evolves: bool = False,
    ) -> None:
        """Lines searched for from others."""


def look_again(run: Run, looks: int) -> bool:
    """Search for lines anew from what heights and a network say of those so far, while less of the image is left.

    Args:
        run: of which lines were found.
        looks: at most.

    Returns:
        Whether other lines were found.

    Raises:
        KeyboardInterrupt: the lines of before are kept.
    """
    is_better = False
    for _ in range(looks):
        found, left, of_network = run.left()
        if run.reason != "converged" or run.view.is_explained(run.lines) or left > LOOKED_AT_SHARE * of_network:
            break
        has_gained = _by_heights(run, found)
        if run.reason == "converged" and not run.view.is_explained(run.lines):
            has_gained = _by_network(run) or has_gained
        if not has_gained:
            break
        is_better = True
        run.counters["looks"] = run.counters.get("looks", 0) + 1
    return is_better


def _by_heights(run: Run, found: FloatArray) -> bool:
    """Grow lines where a descent of heights goes from theirs; whether that is better."""
    heights = torch.as_tensor(refined(run, run.view, found, is_trusted=True).heights, dtype=torch.float32)
    if run.reason != "converged":
        return False
    answer = Answer(heights, torch.full_like(heights, HEIGHTS_SPREAD_M), run.most_lines)
    is_better, _ = tried(run, lambda: run.search(run.lines, _jumps(run), answer))
    return is_better


def _by_network(run: Run) -> bool:
    """Search for lines in what a network says, and take those that are better in places; whether any are."""
    network = network_here(run)
    said = None if network is None else network.looked_again(run.view.resimulation, run.left()[0])
    if said is None:
        return False
    relief_m, spread_m = said
    return searched_in(run, Answer(relief_m, spread_m, run.most_lines), run.view.is_explained)


def searched_in(run: Run, answer: Answer, is_enough: Callable[[torch.Tensor], bool]) -> bool:
    """Search for the lines that an answer tells, and take them, or those of both that are better in each place.

    Args:
        run: whose lines so far are the others.
        answer: in whose relief lines begin.
        is_enough: whether lines are good enough to leave it at the first.

    Returns:
        Whether any are better.
    """

    def anew() -> None:
        start = lines_of_relief(run.model, answer.relief_m.cpu(), answer.spread_m.cpu(), most=run.most_lines)
        if len(start):
            run.search(start, _jumps(run), answer)

    is_better, other = tried(run, anew)
    if is_enough(run.lines):
        return is_better
    is_joint, _ = tried(run, lambda: run.search(run.lines, _jumps(run), answer, other))
    return is_better or is_joint


def _jumps(run: Run) -> int:
    return min(JUMPS, run.method.options.jumps)


def network_here(run: Run) -> Direct | None:
    """The network on the bench of the view; None beyond its family."""
    try:
        return run.method.network if run.view is run.told else run.method.network.on_bench(run.view.scene)
    except MismatchError:
        return None


def tried(run: Run, search: Callable[[], None]) -> tuple[bool, torch.Tensor]:
    """Keep the lines of a search if they are better; whether they are, and the lines that were not kept."""
    kept, was = (run.lines, run.model.shape, run.moves_section), run.left()[1]
    is_better = False
    try:
        search()
        is_better = run.left()[1] < LOOK_FACTOR * was
        other = kept[0] if is_better else run.lines
    finally:
        run.is_in_vain = False
        if not is_better:
            run.lines, run.model.shape, run.moves_section = kept
    return is_better, other
