"""Lines with corners and curves as printed paths: what a design file says."""

import numpy as np

from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.paths import PrintedPath
from warp_caustics.prints.sections import EXPONENTS, CrossSection
from warp_caustics.prints.smooth_chains import track_weights
from warp_caustics.prints.vectorise.curved_lines import CurvedLines


def paths_of(lines: CurvedLines, shape: Shape) -> tuple[PrintedPath, ...]:
    """Each line, along its printed points; of the section that is nearest to the shape's."""
    section = section_of(shape)
    found = []
    for track, (width, height) in zip(lines.tracks, lines.sizes, strict=True):
        points = track_weights(track) @ track.nodes_m
        found.append(PrintedPath(points, np.full(len(points), width), np.full(len(points), height), section))
    return tuple(found)


def section_of(shape: Shape) -> CrossSection:
    """The section of a design file: between cosines and parabolas that which is nearer."""
    low, high = EXPONENTS
    return CrossSection("parabola" if shape.parabola > 0.5 else "cosine", min(max(shape.exponent, low), high))
