"""The lines of a design found again in a relief, each around the place where the design has it.

Fitted are height and how far either end lies across its direction, all lines together, so that overlaps are shared
out, by the descent of ``fit.py``. What moved too far for a descent, or is missing, is found by a search over parallel
offsets first. Lines keep their widths, but for those that the relief shows to be another: of a narrow line it tells the
area across, not width and height. The loss grows linearly, so that no misfit is given up.

Limit: not handled are lines moved along themselves or shortened.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from warp_caustics.prints.fit import CHARBONNIER, minimised, normal_equations
from warp_caustics.prints.line import Line, direction, moved_across
from warp_caustics.prints.model import HEIGHT, WIDTH, LineModel, rows_of
from warp_caustics.types import FloatArray

LARGEST_OFFSET_M = 2e-3
"""Offsets of a design's line up to this distance are tried [m]."""
OFFSET_STEP_M = 1e-4
MISPLACED_FACTOR = 1.25
"""An offset, or no line at all, must explain the relief so much better than the line in its place."""
MISPLACED_LOSS = 3.0
"""Mean loss per cell from which a line is searched for."""
CORRELATED_CELLS = 4.0
"""Neighbouring heights err together; so many count as one."""
PRIOR_M = 2e-3
"""How far an end may go from where the search put it, loosely: an end that nothing shows stays there."""
LARGEST_END_STEP_M = 3e-4
"""In one step of the fit."""
DESIGN_ITERATIONS = 8
BLOCK_LINES = 200
"""Fitted together at most: the normal equations grow with the square of their number, their solution with the cube."""
BLOCK_VALUES = 1 << 25
"""Lines times cells fitted together at most: a block takes 2 GB of derivatives at this."""
BLOCK_SWEEPS = 2
"""Over blocks that overlap: each sees the others where the sweep before left them."""
WIDTH_SHARE = 0.5
"""Of a line's width, how far it may be from the designed one, loosely."""
HELD_FAST = 1e24
"""Holds what is not fitted [m^-2]."""
MISSING_SHARE = 0.3
"""Of its height: a line that is lower is not there, and has no width."""
OTHER_WIDTH, LEAST_OTHER_WIDTH = 3.0, 0.05
"""A width is another where it differs by so many standard uncertainties, and by this share of itself."""
WAVINESS_M = 5e-6
"""No height is trusted better [m]: lines are printed with some waviness."""


@dataclass(frozen=True)
class FittedLine:
    """A line of a design as it was printed.

    Attributes:
        line: with its measured place and height.
        height_error_m: measured minus designed height [m].
        displacement_m: mean distance across the line [m], positive to its left.
        height_std_m: standard uncertainty of the height [m]; infinite where the relief does not show the line.
        displacement_std_m: of the displacement [m]; likewise.
        width_error_m: measured minus designed width [m]; 0 where the relief does not show another.
        width_std_m: its standard uncertainty [m]; infinite where the width was not measured.
    """

    line: Line
    height_error_m: float
    displacement_m: float
    height_std_m: float
    displacement_std_m: float
    width_error_m: float = 0.0
    width_std_m: float = math.inf


def fit_design(
    model: LineModel, lines: Sequence[Line], heights_m: FloatArray, sigma_m: FloatArray
) -> tuple[FittedLine, ...]:
    """Find each line of a design in a relief.

    Args:
        model: renders lines; its limits do not count.
        lines: as designed.
        heights_m: measured relief [m], shape [n, n].
        sigma_m: its standard uncertainty [m], shape [n, n]; infinite where it is not to be judged.

    Returns:
        One entry per line, in their order.
    """
    if not lines:
        return ()
    relief, sigma = (torch.as_tensor(values).to(model.device, torch.float32) for values in (heights_m, sigma_m))
    sigma = (sigma.square() + WAVINESS_M**2).sqrt()
    blocks = _blocks(lines, model.n)
    if len(blocks) == 1:
        fit = _DesignFit(model, lines, relief, sigma)
        return fit.result(fit.with_widths(fit.found(_as_designed(lines))))
    return _fitted_in_blocks(model, lines, blocks, relief, sigma)


def _as_designed(lines: Sequence[Line]) -> torch.Tensor:
    return torch.tensor([[line.height_m, 0.0, 0.0] for line in lines], dtype=torch.float64)


def _blocks(lines: Sequence[Line], n: int) -> list[list[int]]:
    """Numbers of lines that are fitted together: neighbours, in strips of the plate; one block where all fit in."""
    most = max(1, min(BLOCK_LINES, BLOCK_VALUES // n**2))
    if len(lines) <= most:
        return [list(range(len(lines)))]
    count = -(-len(lines) // most)
    across = max(1, round(count**0.5))
    by_y = sorted(range(len(lines)), key=lambda k: lines[k].start_m[1] + lines[k].end_m[1])
    size = -(-len(lines) // across)
    strips = [by_y[i : i + size] for i in range(0, len(by_y), size)]
    blocks = []
    for strip in strips:
        by_x = sorted(strip, key=lambda k: lines[k].start_m[0] + lines[k].end_m[0])
        blocks += [by_x[i : i + most] for i in range(0, len(by_x), most)]
    return blocks


def _fitted_in_blocks(
    model: LineModel, lines: Sequence[Line], blocks: list[list[int]], relief: torch.Tensor, sigma: torch.Tensor
) -> tuple[FittedLine, ...]:
    """A design too large for one matrix: block after block, each in what the others leave of the relief.

    Block coordinate descent. Uncertainties know of overlaps within a block only.
    """
    fits = [_DesignFit(model, [lines[k] for k in block], relief, sigma) for block in blocks]
    found = [_as_designed(fit.lines) for fit in fits]
    parts = [model.heights(fit.rows(there)) for fit, there in zip(fits, found, strict=True)]
    total = torch.stack(parts).sum(dim=0)
    for _ in range(BLOCK_SWEEPS):
        for i, fit in enumerate(fits):
            fit.relief = relief - (total - parts[i])
            found[i] = fit.found(found[i])
            new = model.heights(fit.rows(found[i]))
            total, parts[i] = total - parts[i] + new, new
    fitted: dict[int, FittedLine] = {}
    for block, fit, there in zip(blocks, fits, found, strict=True):
        fitted |= dict(zip(block, fit.result(fit.with_widths(there)), strict=True))
    return tuple(fitted[k] for k in range(len(lines)))


class _DesignFit:
    """A fit whose parameters are height, offset of the start and of the end per line [m], shape [L, 3].

    In the end of some also what they are wider by, shape [L, 4].
    """

    def __init__(self, model: LineModel, lines: Sequence[Line], relief_m: torch.Tensor, sigma_m: torch.Tensor):
        self.model, self.lines, self.relief, self.sigma = model, lines, relief_m, sigma_m
        self.designed = rows_of(lines)
        left = torch.tensor([(-s, c) for c, s in map(direction, lines)], dtype=torch.float64)
        self.across = torch.zeros(len(lines), 3, 6, dtype=torch.float64)
        """What one metre of each offset, and of the width, does to a line's row, shape [L, 3, 6]."""
        self.across[:, 0, :2], self.across[:, 1, 2:4], self.across[:, 2, WIDTH] = left, left, 1.0
        self.held = torch.tensor([0.0, PRIOR_M**-2, PRIOR_M**-2], dtype=torch.float64).repeat(len(lines), 1)
        self.narrowest = model.limits.width_m[0]

    def found(self, start: torch.Tensor) -> torch.Tensor:
        """Heights and offsets [m], shape [L, 3], descended and searched twice from a start."""
        found = self.descended(self.searched(self.descended(start)))
        return self.descended(self.searched(found))

    def with_widths(self, found: torch.Tensor) -> torch.Tensor:
        """The same, shape [L, 3], where no width is another; else shape [L, 4], 0 for widths that are as designed."""
        designed = self.designed[:, WIDTH]
        loose = (WIDTH_SHARE * designed).square().reciprocal()
        self._hold_widths(loose)
        free = self.descended(torch.cat([found, torch.zeros_like(designed)[:, None]], dim=1))
        deviation = self.covariance(free).diagonal().reshape(free.shape)[:, 3].sqrt()
        change = free[:, 3].abs()
        # A line that is not there has no width.
        is_there = free[:, 0] > MISSING_SHARE * self.designed[:, HEIGHT]
        is_other = is_there & (change > OTHER_WIDTH * deviation) & (change > LEAST_OTHER_WIDTH * designed)
        if not is_other.any():
            self.held = self.held[:, :3]
            return found
        self._hold_widths(torch.where(is_other, loose, HELD_FAST))
        return self.descended(torch.where(is_other[:, None], free, torch.cat([found, 0 * found[:, :1]], dim=1)))

    def _hold_widths(self, pull: torch.Tensor) -> None:
        self.held = torch.cat([self.held[:, :3], pull[:, None]], dim=1)

    def rows(self, found: torch.Tensor) -> torch.Tensor:
        """Lines with their heights and offsets, shape [L, 6] [m]."""
        rows = self.designed + (found[:, 1:, None] * self.across[:, : found.shape[1] - 1]).sum(dim=1)
        rows[:, HEIGHT] = found[:, 0]
        rows[:, WIDTH].clamp_min_(min(self.narrowest, float(self.designed[:, WIDTH].min())))
        return rows

    def with_jacobian(self, found: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Relief [m], shape [n, n], and its derivatives by all parameters [1], shape [P L, n, n]."""
        parts, derivatives = self.model.parts(self.rows(found))
        by_height = torch.zeros_like(self.designed)
        by_height[:, HEIGHT] = 1.0
        across = self.across[:, : found.shape[1] - 1]
        chain = torch.cat([by_height[:, None], across], dim=1).to(derivatives)
        return parts.sum(dim=0), torch.einsum("lpc,lcij->lpij", chain, derivatives).flatten(0, 1)

    @staticmethod
    def moved(found: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Parameters after a step: ends go as far as one step may, heights are not negative."""
        change = step.reshape(found.shape)
        height = (found[:, :1] + change[:, :1]).clamp_min(0.0)
        return torch.cat([height, found[:, 1:] + change[:, 1:].clamp(-LARGEST_END_STEP_M, LARGEST_END_STEP_M)], dim=1)

    def descended(self, found: torch.Tensor) -> torch.Tensor:
        """All lines together."""
        held = self.held[:, : found.shape[1]].reshape(-1)
        system = normal_equations(self.with_jacobian, self.relief, self.sigma, CHARBONNIER)
        return minimised(system, self.moved, found, iterations=DESIGN_ITERATIONS, held=held)[0]

    def searched(self, found: torch.Tensor) -> torch.Tensor:
        """With each line that does not fit moved to the parallel offset that explains best what the others leave."""
        found = found.clone()
        units = self._units(found, range(len(found)))
        heights = found[:, 0].to(units)
        rest = self.relief - torch.tensordot(heights, units, dims=1)
        misfits = torch.stack([self._losses(rest)[unit > 0].mean() for unit in units]).nan_to_num().cpu()
        for k in misfits.argsort(descending=True).tolist():
            if misfits[k] < MISPLACED_LOSS:
                break
            without = rest + float(found[k, 0]) * units[k]
            best, gained, now = self._best_offset(k, without, float(found[k, 0]), units[k])
            if gained * MISPLACED_FACTOR < now:
                found[k] = best
                units[k] = self._units(best[None], [k])[0]
                rest = without - float(best[0]) * units[k]
        return found

    def _best_offset(
        self, k: int, without: torch.Tensor, height: float, unit: torch.Tensor
    ) -> tuple[torch.Tensor, float, float]:
        """Height and offsets of line k in what the others leave [m], their loss, and the loss of the present ones."""
        steps = round(LARGEST_OFFSET_M / OFFSET_STEP_M)
        offsets = OFFSET_STEP_M * torch.arange(-steps, steps + 1, dtype=torch.float64)
        tried = self._units(torch.stack([offsets, offsets, offsets], dim=1), [k] * len(offsets))
        window = (tried > 0).any(dim=0) | (unit > 0)
        data, shapes = (without / self.sigma)[window], (tried / self.sigma)[:, window]
        norms = shapes.square().sum(dim=1)
        heights = torch.where(norms > 0, (shapes @ data / norms.clamp_min(1e-30)).clamp_min(0.0), 0.0)
        losses = CHARBONNIER.value((data - heights[:, None] * shapes).square()).sum(dim=1)
        now = float(CHARBONNIER.value((data - height * (unit / self.sigma)[window]).square()).sum())
        best = int(losses.argmin())
        offset = float(offsets[best])
        return torch.tensor([float(heights[best]), offset, offset], dtype=torch.float64), float(losses[best]), now

    def _units(self, found: torch.Tensor, numbers: Sequence[int]) -> torch.Tensor:
        """Relief per height [1] of lines of these numbers with the offsets of ``found``, shape [K, n, n]."""
        chosen = list(numbers)
        rows = self.designed[chosen] + (found[:, 1:, None] * self.across[chosen, :2]).sum(dim=1)
        rows[:, HEIGHT] = 1.0
        return self.model.each(rows)

    def _losses(self, residual: torch.Tensor) -> torch.Tensor:
        return CHARBONNIER.value((residual / self.sigma).square())

    def covariance(self, found: torch.Tensor) -> torch.Tensor:
        """Of all parameters [m^2], shape [P L, P L], from the curvature of the squares."""
        jacobian = (self.with_jacobian(found)[1] / self.sigma).flatten(1)
        normal = (jacobian @ jacobian.T).double().cpu() / CORRELATED_CELLS
        held = self.held[:, : found.shape[1]].reshape(-1)
        # A height that nothing shows leaves the matrix regular.
        covariance: torch.Tensor = torch.linalg.inv(normal + torch.diag(held + (held == 0)))
        return covariance

    def result(self, found: torch.Tensor) -> tuple[FittedLine, ...]:
        """The lines with their standard uncertainties."""
        columns = found.shape[1]
        covariance = self.covariance(found)
        shown = (self.with_jacobian(found)[1][::columns] / self.sigma).flatten(1).square().sum(dim=1)
        is_shown = (shown.double().cpu() / CORRELATED_CELLS > PRIOR_M**-2).tolist()
        fitted = []
        for k, (line, (height, start, end, *wider)) in enumerate(zip(self.lines, found.tolist(), strict=True)):
            first = columns * k
            ends = covariance[first + 1 : first + 3, first + 1 : first + 3]
            is_other = bool(wider) and abs(wider[0]) > LEAST_OTHER_WIDTH / 2 * line.width_m
            width = max(line.width_m + wider[0], self.narrowest) if is_other else line.width_m
            fitted.append(
                FittedLine(
                    line=replace(moved_across(line, start, end), height_m=height, width_m=width),
                    height_error_m=height - line.height_m,
                    displacement_m=(start + end) / 2,
                    height_std_m=float(covariance[first, first].sqrt()) if is_shown[k] else math.inf,
                    displacement_std_m=float(ends.mean().sqrt()) if is_shown[k] else math.inf,
                    width_error_m=width - line.width_m,
                    width_std_m=float(covariance[first + 3, first + 3].sqrt()) if is_other else math.inf,
                )
            )
        return tuple(fitted)
