"""From a relief to the lines it was printed with: Tab. 3's model, fitted."""

from warp_caustics.prints.vectorise.lines import lines_of_relief, unexplained
from warp_caustics.prints.vectorise.moves import LINE_PENALTY

__all__ = ["LINE_PENALTY", "lines_of_relief", "unexplained"]
