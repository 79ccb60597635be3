"""Lines that leave part of an image unexplained, looked at by the network again.

Where many lines lie on top of each other a network misses some and takes some for others. The lines that were found
are right in most places; told what they show, a network with feedback sees more in the rest.
"""

from typing import Any, Protocol

import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.lines_view import LinesView
from nets.reconstruct.fibres.search import Answer
from warp_caustics.prints.model import LineModel, Shape
from warp_caustics.types import FloatArray

TAKEN_SHARE = 0.6
"""Lines are taken where they leave less than this share of what the network's relief leaves before it is refined, or
nothing but noise: those that leave more are not the plate's, and bend with the bench to what they cannot explain. Where
they leave more than noise, ``direct`` must leave more when both are refined."""
LOOKED_AT_SHARE = 0.8
"""The same for lines to be looked at again; two plates whose lines left 0.63 and 0.64 came down to 0.16 and 0.54."""
LOOK_FACTOR = 0.99
"""What is left of the image must fall by this factor for lines to be taken that were found after another look: on five
plates of six with 24 to 30 lines that explained nothing it fell by 8 to 75 %, and errors fell with it; on the other,
lines were 9 um wrong instead of 6, and left 1.1 times as much."""


class Run(Protocol):
    """Lines of one image, so far."""

    lines: torch.Tensor
    view: LinesView
    model: LineModel
    moves_section: bool
    is_in_vain: bool
    counters: dict[str, Any]
    first_shape: Shape
    most_lines: int

    def left(self) -> tuple[FloatArray, float, float]:
        """Relief of the lines, and what it and the network's leave of the image."""

    def fit_to(self, answer: Answer) -> None:
        """Lines from what a network says."""


def look_again(run: Run, network: Direct, looks: int) -> bool:
    """Search for lines anew from what a network says of those so far, while less of the image is left each time.

    Args:
        run: on the bench that the network is told of.
        network: that may be able to look again.
        looks: at most.

    Returns:
        Whether other lines were found.

    Raises:
        KeyboardInterrupt: the lines of before are kept.
    """
    for look in range(looks):
        found, was, of_network = run.left()
        if run.view.is_explained(run.lines) or was > LOOKED_AT_SHARE * of_network:
            return look > 0
        said = network.looked_again(run.view.resimulation, found)
        if said is None:
            return False
        kept = run.lines, run.model.shape, run.moves_section
        is_better = False
        try:
            run.model.shape = run.first_shape
            run.fit_to(Answer(*said, run.most_lines))
            is_better = not run.is_in_vain and run.left()[1] < LOOK_FACTOR * was
        finally:
            run.is_in_vain = False
            if not is_better:
                run.lines, run.model.shape, run.moves_section = kept
        if not is_better:
            return look > 0
        run.counters["looks"] = look + 1
    return looks > 0
