"""Printed lines found again in a measured relief, each around the place where the design has it.

Each line keeps its width; fitted are its height and how far either end lies
across its direction, all lines together, so that overlaps are shared out. What
moved too far for a descent, or is missing, is found by a search over parallel
offsets first. Errors in patches (crossings, folds) hardly count: the loss grows
linearly.

Not handled: changed widths, lines moved along themselves or shortened.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from warp_caustics.prints.line import Line, Section, line_patch
from warp_caustics.types import FloatArray

SEARCH_M = 2e-3
"""Offsets up to this distance are tried [m]."""
SEARCH_STEP_M = 1e-4
GAIN = 1.25
"""An offset, or no line at all, must explain the relief so much better than the line in its place."""
STEP_M = 2e-5
"""For differences across a line [m]."""
CORRELATED_CELLS = 4.0
"""Neighbouring heights err together; so many count as one."""
PRIOR_M = 2e-3
"""How far an end may go from where the search put it, loosely: an end that nothing shows stays there."""
SUSPICIOUS = 3.0
"""Mean loss per cell from which a line is searched for."""
ITERATIONS = 8
MAX_DAMPING = 1e6
LARGEST_STEP_M = 3e-4
FLOOR_M = 5e-6
"""No height is trusted better [m]: lines are printed with some waviness."""


@dataclass(frozen=True)
class FittedLine:
    """A line as it was printed.

    Attributes:
        line: with its measured place and height.
        height_error_m: measured minus designed height [m].
        displacement_m: mean distance across the line [m], positive to its left.
        height_std_m: standard uncertainty of the height [m]; infinite where the relief does not show the line.
        displacement_std_m: of the displacement [m]; likewise.
    """

    line: Line
    height_error_m: float
    displacement_m: float
    height_std_m: float
    displacement_std_m: float


def shifted(line: Line, start_m: float, end_m: float) -> Line:
    """The line with its ends moved to its left [m]."""
    along = np.subtract(line.end_m, line.start_m)
    length = float(np.hypot(*along))
    left = np.array([-along[1], along[0]]) / length if length > 0 else np.array([0.0, 1.0])
    start, end = np.add(line.start_m, start_m * left), np.add(line.end_m, end_m * left)
    return replace(line, start_m=(float(start[0]), float(start[1])), end_m=(float(end[0]), float(end[1])))


def fit_lines(
    lines: Sequence[Line],
    heights_m: FloatArray,
    sigma_m: FloatArray,
    plate_size_m: tuple[float, float],
    *,
    profile: Section = "cosine",
    supersampling: int = 4,
) -> list[FittedLine]:
    """Find each line in a relief.

    Args:
        lines: as designed.
        heights_m: measured relief [m], shape [n, n].
        sigma_m: its standard uncertainty [m], shape [n, n]; infinite where it is not to be judged.
        plate_size_m: extent along x and y [m].
        profile: see :func:`~warp_caustics.prints.line.line_profile`.
        supersampling: see :func:`~warp_caustics.prints.line.line_relief`.

    Returns:
        One entry per line, in their order.
    """
    if not lines:
        return []
    weight = 1.0 / np.hypot(sigma_m, FLOOR_M)
    fit = _Fit(list(lines), heights_m, weight, plate_size_m, profile, supersampling)
    found = np.array([[line.height_m, 0.0, 0.0] for line in lines])
    found = fit.descended(fit.searched(fit.descended(found)))
    found = fit.descended(fit.searched(found))
    return fit.result(found)


@dataclass
class _Fit:
    """A fit's constants; its variables are height, offset of the start and of the end per line [m], shape [L, 3]."""

    lines: list[Line]
    heights_m: FloatArray
    weight: FloatArray
    plate_size_m: tuple[float, float]
    profile: Section
    supersampling: int

    def unit(self, k: int, start_m: float, end_m: float) -> FloatArray:
        """Relief of line k per height [1], shape [n, n]."""
        line = replace(shifted(self.lines[k], start_m, end_m), height_m=1.0)
        n = len(self.heights_m)
        rows, columns, patch = line_patch(
            line, n, self.plate_size_m, profile=self.profile, supersampling=self.supersampling
        )
        relief = np.zeros((n, n))
        relief[rows, columns] = patch
        return relief

    def units(self, found: FloatArray) -> FloatArray:
        """Relief of every line per height [1], shape [L, n, n]."""
        return np.stack([self.unit(k, start, end) for k, (_, start, end) in enumerate(found)])

    def searched(self, found: FloatArray) -> FloatArray:
        """With each line that does not fit moved to the parallel offset that explains best what the others leave."""
        found, units = found.copy(), self.units(found)
        left_over = self.heights_m - np.tensordot(found[:, 0], units, 1)
        misfit = [_loss((left_over * self.weight)[unit > 0]).mean() if unit.any() else 0.0 for unit in units]
        for k in np.argsort(misfit)[::-1]:
            if misfit[k] < SUSPICIOUS:
                break
            without = left_over + found[k, 0] * units[k]
            best, gained, now = self._best_offset(int(k), without, found[k, 0], units[k])
            if gained * GAIN < now:
                found[k] = best
                units[k] = self.unit(int(k), best[1], best[2])
                left_over = without - found[k, 0] * units[k]
        return found

    def _best_offset(
        self, k: int, without: FloatArray, height: float, unit: FloatArray
    ) -> tuple[FloatArray, float, float]:
        """Height and offsets of line k in what the others leave [m], their loss, and the loss of the present ones."""
        offsets = np.arange(-SEARCH_M, SEARCH_M + SEARCH_STEP_M / 2, SEARCH_STEP_M)
        tried = [self.unit(k, d, d) for d in offsets]
        window = np.any([each > 0 for each in (*tried, unit)], axis=0)
        data, weight = (without * self.weight)[window], self.weight[window]
        shapes = np.array([each[window] * weight for each in tried])
        norms = (shapes**2).sum(axis=1)
        heights = np.where(norms > 0, np.maximum(shapes @ data / np.maximum(norms, 1e-300), 0.0), 0.0)
        losses = _loss(data - heights[:, None] * shapes).sum(axis=1)
        now = float(_loss(data - height * unit[window] * weight).sum())
        best = int(losses.argmin())
        return np.array([heights[best], offsets[best], offsets[best]]), float(losses[best]), now

    def descended(self, found: FloatArray) -> FloatArray:
        """All lines together: least squares, re-weighted so that the loss of large misfits is linear."""
        values, damping = found.copy(), 1.0
        loss = self._total(values, found)
        for _ in range(ITERATIONS):
            residual = (self.heights_m - np.tensordot(values[:, 0], self.units(values), 1)) * self.weight
            robust = (1 + residual**2) ** -0.25
            weight = (self.weight * robust).astype(np.float32)
            columns = (self.derivatives(values) * weight).reshape(3 * len(values), -1)
            pull = np.tile([0.0, 1 / PRIOR_M**2, 1 / PRIOR_M**2], len(values))
            normal = (columns @ columns.T).astype(np.float64)
            normal[np.diag_indices_from(normal)] += pull
            right = columns @ (residual * robust).ravel().astype(np.float32) - pull * (values - found).ravel()
            while damping < MAX_DAMPING:
                diagonal = np.diag(np.diag(normal) * damping * 1e-3 + 1e-6)
                step = np.linalg.solve(normal + diagonal, right).reshape(-1, 3)
                step[:, 1:] = np.clip(step[:, 1:], -LARGEST_STEP_M, LARGEST_STEP_M)
                candidate = values + step
                candidate[:, 0] = np.maximum(candidate[:, 0], 0.0)
                new = self._total(candidate, found)
                if new <= loss:
                    break
                damping *= 10
            else:
                break
            gained, values, loss, damping = loss - new, candidate, new, max(damping / 10, 1e-3)
            if gained < 1e-4 * loss:
                break
        return values

    def _total(self, values: FloatArray, found: FloatArray) -> float:
        residual = (self.heights_m - np.tensordot(values[:, 0], self.units(values), 1)) * self.weight
        return float(_loss(residual).sum() + (((values - found)[:, 1:] / PRIOR_M) ** 2).sum() / 2)

    def derivatives(self, values: FloatArray) -> npt.NDArray[np.float32]:
        """Of the relief with respect to height [1], start [1] and end [1] of each line, shape [L, 3, n, n]."""
        n = len(self.heights_m)
        columns = np.zeros((len(values), 3, n, n), np.float32)
        for k, (height, start, end) in enumerate(values):
            columns[k, 0] = self.unit(k, start, end)
            columns[k, 1] = self.unit(k, start + STEP_M, end) - self.unit(k, start - STEP_M, end)
            columns[k, 2] = self.unit(k, start, end + STEP_M) - self.unit(k, start, end - STEP_M)
            columns[k, 1:] *= height / (2 * STEP_M)
        return columns

    def result(self, values: FloatArray) -> list[FittedLine]:
        """The lines with their standard uncertainties, from the curvature of the squares."""
        columns = self.derivatives(values).reshape(3 * len(values), -1) * self.weight.ravel().astype(np.float32)
        normal = (columns @ columns.T).astype(np.float64) / CORRELATED_CELLS
        visible = np.diag(normal)[::3] > 1 / PRIOR_M**2
        normal[np.diag_indices_from(normal)] += np.tile([1.0, 1 / PRIOR_M**2, 1 / PRIOR_M**2], len(values))
        covariance = np.linalg.inv(normal)
        fitted = []
        for k, (height, start, end) in enumerate(values):
            across = covariance[3 * k + 1 : 3 * k + 3, 3 * k + 1 : 3 * k + 3]
            fitted.append(
                FittedLine(
                    line=replace(shifted(self.lines[k], start, end), height_m=float(height)),
                    height_error_m=float(height - self.lines[k].height_m),
                    displacement_m=float((start + end) / 2),
                    height_std_m=float(np.sqrt(covariance[3 * k, 3 * k])) if visible[k] else float("inf"),
                    displacement_std_m=float(np.sqrt(across.mean())) if visible[k] else float("inf"),
                )
            )
        return fitted


def _loss(scaled: FloatArray) -> FloatArray:
    """Squares near zero, growing linearly from there."""
    values: FloatArray = np.sqrt(1 + scaled**2) - 1
    return values
