"""The least of a picture's misfit about a place, to second order, within what numbers may be."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import FloatArray

RIDGES = 1e-9, 1e-7, 1e-5
"""Of the scaled matrix, the first with which it is one: lines on top of each other are one number in single precision,
of which the matrix is made."""


@dataclass(frozen=True, eq=False)
class BoundedLeast:
    """Of P numbers of lines and their shape, then K of a bench, its light and a lens.

    Attributes:
        at: the numbers of lines and shape where they are, shape [P].
        information: A, shape [P + K, P + K]; a step s costs 2 g s + s A s, in squared deviations.
        gradient: g, shape [P + K].
        lowest: to which numbers may move from where they are, 0 or less, same shape.
        highest: the same upwards.
    """

    at: FloatArray
    information: FloatArray
    gradient: FloatArray
    lowest: FloatArray
    highest: FloatArray

    def step(self, first: int = 0) -> FloatArray:
        """To the least of all numbers, or of those from one on, shape [P + K]: least squares within bounds (BVLS).

        A number at its end is held by where all go together, not by its own slope: stray light that lines made up for
        would be less than none by itself, and comes back with the gap.
        """
        moves = (np.arange(len(self.gradient)) >= first) & (self.highest > self.lowest)
        scale = np.sqrt(np.maximum(np.diag(self.information)[moves], 1e-30))
        root = _root(self.information[np.ix_(moves, moves)] / np.outer(scale, scale))
        right = np.linalg.solve(root, -self.gradient[moves] / scale)
        ends = self.lowest[moves] * scale, self.highest[moves] * scale
        step: FloatArray = np.zeros(len(self.gradient))
        step[moves] = scipy.optimize.lsq_linear(root.T, right, ends, method="bvls").x / scale
        return step

    def gain(self, step: FloatArray) -> float:
        """Of a step, in squared deviations."""
        return -float(2 * self.gradient @ step + step @ self.information @ step)


def _root(matrix: FloatArray) -> FloatArray:
    """Of a matrix whose diagonal is 1 (Cholesky).

    Raises:
        numpy.linalg.LinAlgError: it is none of squares, by far.
    """
    for ridge in RIDGES[:-1]:
        try:
            return np.linalg.cholesky(matrix + ridge * np.eye(len(matrix)))
        except np.linalg.LinAlgError:
            continue
    return np.linalg.cholesky(matrix + RIDGES[-1] * np.eye(len(matrix)))
