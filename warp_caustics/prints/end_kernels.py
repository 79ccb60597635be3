"""Thicker ends in kernels: where along a line that what is printed at a point comes from.

Ends are those that :func:`~warp_caustics.prints.imperfections.thick_ends` prints: straight pieces between points near
an end, each a cone, of which the highest is printed. Aside of a line that is not the section of the nearest part: what
swells nearer to the end reaches as far. With the nearest part alone lines 3.5 mm wide, whose ends swell over 1.2 mm,
were up to 0.08 mm too low, and a plate of ten such lines 3.9 um off in the mean.
"""

import math
from typing import no_type_check

import warp as wp

from warp_caustics.prints.imperfections import END_PLACES
from warp_caustics.prints.kernels import across

END_POINTS = len(END_PLACES)
END_WAYS = wp.constant(wp.types.vector(length=END_POINTS, dtype=wp.float32)(*END_PLACES))
"""Where an end has points, in lengths of the thicker end."""
END_SHARES = wp.constant(wp.types.vector(length=END_POINTS, dtype=wp.float32)(*(math.exp(-p * p) for p in END_PLACES)))
"""Of what it is thicker at most, there."""


@wp.struct
class ThickPart:
    """The part of a line that is the highest at a point."""

    share: wp.float32
    """Of the line's length, where it is."""
    thickness: wp.float32
    """Factor of its width and height."""
    slope: wp.float32
    """Change of the thickness by the share."""
    is_free: wp.bool
    """Whether it lies between the points of a piece, and is another one when an end moves."""


@no_type_check
@wp.func
def thick_part(
    offset: wp.vec2,
    along: wp.vec2,
    length: wp.float32,
    width: wp.float32,
    height: wp.float32,
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    ends: wp.vec2,
    side: wp.float32,
    is_steep: wp.bool,
) -> ThickPart:
    """At an offset from a line's start [m]; a point stands for ``side`` along [m].

    ``ends`` are the share by which a line is wider and higher where it begins and ends [1], and how far that reaches
    [m]: share exp(-(s / reach)^2) at a way s from there.
    """
    found = ThickPart()
    foot = wp.dot(offset, along) / length
    gap = offset - foot / length * along
    aside = wp.length(gap)
    is_start = foot < 0.5 * length
    if not is_start:
        foot = length - foot
    way = wp.clamp(foot, 0.0, length)
    found.thickness = 1.0
    beyond = wp.float32(0.0)
    if is_steep:
        beyond = 0.5 * side
    highest, falls = wp.float32(-1.0), wp.float32(0.0)
    before, thick_before = wp.float32(0.0), 1.0 + ends[0]
    # Points of this end that are ahead, and of the far one, whose last are the nearest.
    own, others = wp.int32(0), wp.int32(wp.static(END_POINTS - 1))
    # Pieces beyond the nearest part are farther, and no thicker.
    while before < length and before <= wp.max(foot, 0.0):
        last, share = length, wp.float32(-1.0)
        if own < wp.static(END_POINTS) and END_WAYS[own] * ends[1] < length:
            last, share = END_WAYS[own] * ends[1], END_SHARES[own]
        while others > 0 and length - END_WAYS[others] * ends[1] <= before:
            others -= 1
        of_other = length - END_WAYS[others] * ends[1]
        if of_other > before and of_other < last:
            last, share = of_other, -1.0
        if share < 0.0 or last > 0.5 * length:
            from_end = wp.min(last, length - last) / ends[1]
            share = wp.exp(-from_end * from_end)
        thick_last = 1.0 + ends[0] * share
        while own < wp.static(END_POINTS) and END_WAYS[own] * ends[1] <= last:
            own += 1
        at = wp.clamp(foot, before, last)
        slope = (thick_last - thick_before) / (last - before)
        thick = thick_before + slope * (at - before)
        distance = wp.sqrt(aside * aside + (foot - at) * (foot - at))
        if distance < 0.5 * edge * thick * width + beyond:
            here = across(exponent, parabola, edge, is_cap, distance, thick * width, thick * height, side, is_steep)
            if here[0] > highest:
                highest, way, falls = here[0], at, slope
                found.thickness = thick
                found.is_free = at > before and at < last
        before, thick_before = last, thick_last
    found.share = way / length
    found.slope = falls * length
    if not is_start:
        found.share = 1.0 - found.share
        found.slope = -found.slope
    return found
