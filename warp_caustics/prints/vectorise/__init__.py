"""From a relief to the lines it was printed with: Tab. 3's model, fitted."""

from warp_caustics.prints.vectorise.lines import lines_of_relief, unexplained

__all__ = ["lines_of_relief", "unexplained"]
