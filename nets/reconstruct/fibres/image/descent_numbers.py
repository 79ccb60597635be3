"""The numbers that a descent moves: lines, and the shape that they have in common.

A section of another power that is as wide at its foot is another line; one that is as wide at half its height is
nearly the same. So where the section moves with the lines, their width is told by that of a cosine which is as wide
there, and the power g by s = sqrt(g) / (1 + sqrt(g)): a box (0) and a Gaussian (1) are both a finite way off. In plain
widths and powers the misfit's valley is bent: 26 true lines of Gaussian section, begun with g = 8, were 8.3 um off
after forty iterations, with g = 8.5. Powers as g, log g or g / (1 + g) are as good between most sections; from a cosine
to an ellipse s is the quickest of these.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch

from warp_caustics.prints.line_shape import COSINE_HALF, Shape, half_height
from warp_caustics.prints.model import WIDTH, LineModel
from warp_caustics.types import FloatArray

STEPS = (0.00125, 0.02, 0.02, 0.01, 2e-5, 1e-3)
"""Of differences by the shape's numbers: at a power of 1 that is 1 % of it, which errs by 1e-4 of the difference,
float32 by as much."""
SECTION, OVERLAP, ENDS, CUT = (0, 1), (2,), (3, 4), (5,)
"""Places of numbers in a shape."""


def share_of(exponent: float) -> float:
    """s [1] of a power g."""
    root = math.sqrt(exponent)
    return root / (1 + root)


def exponent_of(share: float) -> float:
    """g [1] of an s; as large as any where that is 1 or more, and none where it is below 0."""
    return (max(share, 0.0) / max(1 - share, 1e-9)) ** 2


def moving(shape: Shape) -> tuple[int, ...]:
    """Places of the numbers that a descent moves from a shape: the section's but of caps, thicker ends and a cut."""
    own = () if shape.is_cap else SECTION
    return own + OVERLAP + (ENDS if shape.thicker > 0 else ()) + (CUT if shape.cut > 0 else ())


def numbers_of(shape: Shape) -> tuple[float, ...]:
    """Numbers that a descent moves, of a shape; whether it is a cap comes last, and stays."""
    return share_of(shape.exponent), *shape[1:]


def shape_of(numbers: Sequence[float]) -> Shape:
    """The shape of a descent's numbers, within what prints have."""
    share, parabola, overlap, thicker, end_m, cut, is_cap = numbers
    return Shape(exponent_of(share), parabola, overlap, thicker, end_m, cut, bool(is_cap)).clipped()


def reshaped_widths(shape: Shape, new: Shape) -> float:
    """Factor of the width of a line of another section that is as wide at half its height [1]."""
    return half_height(shape) / half_height(new)


def reshaped(lines: torch.Tensor, shape: Shape, new: Shape) -> torch.Tensor:
    """Lines of another section that are as wide at half their height, shape [L, 6] [m]."""
    changed = lines.clone()
    changed[:, WIDTH] *= reshaped_widths(shape, new)
    return changed


def by_shape(model: LineModel, lines: torch.Tensor, places: Sequence[int] = SECTION + OVERLAP) -> torch.Tensor:
    """Derivatives of the relief by some numbers of its shape [m], shape [K, n, n], by differences.

    Central ones where the numbers are not at an end of their range; lines stay as wide at half their height.
    """
    given, numbers, columns = model.shape, numbers_of(model.shape), []
    try:
        for number in places:
            at, found = [], []
            for sign in (-1, 1):
                moved = list(numbers)
                moved[number] += sign * STEPS[number]
                model.shape = shape_of(moved)
                at.append(numbers_of(model.shape)[number])
                found.append(model.heights(reshaped(lines, given, model.shape)))
            columns.append((found[1] - found[0]) / (at[1] - at[0]))
    finally:
        model.shape = given
    return torch.stack(columns)


class DescentNumbers:
    """Numbers of L lines, 6 each, and of their shape behind them if that is moved, and back.

    Which of them move depends on the shape when a descent begins (:func:`moving`).

    Args:
        model: of the lines; its shape is set by :meth:`put`.
        count: L.
        with_section: the shape is moved, too.
    """

    def __init__(self, model: LineModel, count: int, with_section: bool):
        self.model, self.lines, self.with_section = model, count, with_section
        self._begun = list(numbers_of(model.shape))
        self.of_shape = moving(model.shape) if with_section else ()
        """Places of the shape's numbers that move."""
        self.size = 6 * count + len(self.of_shape)

    def of(self, lines: torch.Tensor, shape: Shape) -> FloatArray:
        """Numbers of lines, shape [L, 6] [m], and their shape; shape [P]."""
        if not self.with_section:
            return lines.numpy().ravel().copy()
        rows = lines.numpy().copy()
        rows[:, WIDTH] *= half_height(shape) / COSINE_HALF
        return np.append(rows, [numbers_of(shape)[place] for place in self.of_shape])

    def put(self, numbers: FloatArray) -> torch.Tensor:
        """Lines of numbers, shape [L, 6] [m], within their limits; the model has their shape afterwards."""
        rows = numbers[: 6 * self.lines].reshape(self.lines, 6).copy()
        if self.with_section:
            moved = list(self._begun)
            for place, number in zip(self.of_shape, numbers[6 * self.lines :].tolist(), strict=True):
                moved[place] = number
            self.model.shape = shape_of(moved)
            rows[:, WIDTH] *= COSINE_HALF / half_height(self.model.shape)
        return self.model.clamped(torch.from_numpy(rows))

    def derivatives(self, lines: torch.Tensor, by_line: torch.Tensor) -> torch.Tensor:
        """Derivatives of the relief by the numbers, shape [P, n, n], at the model's shape.

        Args:
            lines: shape [L, 6] [m].
            by_line: by the lines' own numbers, shape [6 L, n, n].
        """
        if not self.with_section:
            return by_line
        by_line = by_line.clone()
        by_line[WIDTH::6] *= COSINE_HALF / half_height(self.model.shape)
        return torch.cat([by_line, by_shape(self.model, lines, self.of_shape)])

    def ends(self, numbers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest values of numbers, where they have the shape of these, shape [P] each."""
        if not self.with_section:
            return self.model.limits_of(torch.from_numpy(numbers.reshape(self.lines, 6)))
        kept = self.model.shape
        try:
            ends = self.model.limits_of(self.put(numbers), self.of_shape)
            narrower = half_height(self.model.shape) / COSINE_HALF
        finally:
            self.model.shape = kept
        for end in ends:
            end[WIDTH : 6 * self.lines : 6] *= narrower
            if SECTION[0] in self.of_shape:
                end[6 * self.lines] = share_of(end[6 * self.lines])
        return ends
