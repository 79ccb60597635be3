"""From a relief to the lines it was printed with: Tab. 3's model, fitted.

A line is a row (x0, y0, x1, y1, width, height) in millimetres, which keeps all
six numbers and their derivatives of similar size.
"""

from warp_caustics.prints.vectorise.lines import lines_of_relief

__all__ = ["lines_of_relief"]
