"""Pieces of printed lines as rows of numbers: what data sets draw and kernels print."""

ROW_COLUMNS = ("kind", "x0_m", "y0_m", "x1_m", "y1_m", "width_m", "height_m")
"""A segment goes from (x0, y0) to (x1, y1); a ring lies around (x0, y0) with radius x1."""

SEGMENT, RING, JOINED, BEGIN = 0.0, 1.0, 2.0, 3.0
"""Kinds of a row: a segment that begins a line; a ring; a segment that goes on where the row before ended, its width
and height going linearly from those of the row before to its own; and a line's first width and height, which print
nothing themselves."""
