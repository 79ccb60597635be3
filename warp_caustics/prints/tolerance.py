"""The tolerance zone of printed lines on the samples of a height map.

A height sample is a mean over its cell. A fibre narrower than a cell hardly has
a slope on these samples, and yet moves much glass from one cell to the next when
it lies a little aside. So the zone follows from the lines: each may lie up to
the tolerance t aside or along, and the surface up to t above or below.
"""

from collections.abc import Sequence

import numpy as np

from warp_caustics.prints.line import Line, Section, line_relief, moved_across, moved_along
from warp_caustics.types import FloatArray


def line_limit(
    lines: Sequence[Line],
    samples: int,
    plate_size_m: tuple[float, float],
    tolerance_m: float,
    *,
    section: Section = "cosine",
) -> FloatArray:
    """Largest vertical deviation inside the zone [m], shape [n, n].

    sqrt(t^2 + sum of squares of what moving each line by t across, and along, changes): for lines much wider than a
    cell the same as t sqrt(1 + s^2) with the surface's slope s.

    Args:
        lines: as designed.
        samples: n.
        plate_size_m: extent along x and y [m].
        tolerance_m: t [m].
        section: of the lines.
    """
    squared = np.full((samples, samples), tolerance_m**2)

    def relief(line: Line) -> FloatArray:
        return line_relief([line], samples, plate_size_m, section=section)

    for line in lines:
        nominal = relief(line)
        for shifted in (
            [moved_across(line, shift, shift) for shift in (tolerance_m, -tolerance_m)],
            [moved_along(line, shift) for shift in (tolerance_m, -tolerance_m)],
        ):
            squared += np.maximum(*(np.abs(relief(each) - nominal) for each in shifted)) ** 2
    limit: FloatArray = np.sqrt(squared)
    return limit
