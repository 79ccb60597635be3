"""Changes of a set of lines that descent cannot make: one more, one less, two that are one."""

from functools import cached_property

import numpy as np
import torch

from warp_caustics.prints.fit import fit_lines
from warp_caustics.prints.fit_each import fit_each
from warp_caustics.prints.model import HEIGHT, WIDTH, LineModel
from warp_caustics.prints.vectorise.proposals import proposed_lines

LINE_PENALTY = 20.0
"""Loss that a line must save. Six numbers for 16,384 heights would be worth 6/2 ln 16384 = 29 if their errors were
independent, and half of it on the loss's scale; chosen on own fields."""
PROPOSED_RIDGES = 10
"""Highest points through which lines are proposed."""
FITTED_PROPOSALS = 8
"""Proposals that are fitted."""
LOW_M = 1e-4
"""Height given to proposals from residuals relative to their expected size, whose height is no height."""
RIVAL_OVERLAP = 0.2
"""Overlap (cosine of the angle between heights) from which one line may take another's place."""
MERGED_AT_ONCE = 32
"""Pairs of lines that are tried as one at the same time, at most: each takes 7 n^2 numbers of memory."""
APART_OVERLAP = 0.02
"""Overlap below which lines have nothing to do with each other: they are added at once, and stay where they are when
the other one changes."""
GIVEN_UP_LOSS = 150.0
"""A change that raises the loss by so much before the other lines have moved is not followed."""

UNSURE_M = 5e-5
"""Spread at which residuals count half in the search for ridges [m]."""
LARGEST_ASIDE_M, LARGEST_GAP_M = 2e-4, 1e-3
"""How far lines that continue each other may lie beside one straight line, besides half their width, and apart, besides
a quarter of their length [m]."""
DROP_LENGTH_M = 3e-4
"""Length that a drop counts for when two lines are joined [m]."""


class LineSet:
    """Lines under change.

    Args:
        model: renders lines.
        relief_m: to be explained, shape [n, n].
        spread_m: of the answers it is the mean of, shape [n, n].
    """

    def __init__(self, model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor):
        self.model, self.relief, self.spread = model, relief_m, spread_m
        self.sigma = spread_m
        self.lines = torch.zeros(0, 6, dtype=torch.float64)
        self.loss = np.inf
        self._shown = _Shown(model, self.lines)

    def focus(self, floor_m: float) -> None:
        """Expect residuals of the spread and of ``floor_m``, and fit again."""
        self.sigma = (self.spread.square() + floor_m**2).sqrt()
        self.refit(20)

    def refit(self, iterations: int) -> None:
        """Let all lines move."""
        self.lines, self.loss = fit_lines(self.model, self.lines, self.relief, self.sigma, iterations=iterations)

    @property
    def shown(self) -> "_Shown":
        """The lines, each alone."""
        if self._shown.lines is not self.lines:
            self._shown = _Shown(self.model, self.lines)
        return self._shown

    def grow(self, most: int) -> bool:
        """Add lines while each saves more than its penalty; True if any did."""
        grown = False
        while len(self.lines) < most:
            enough = self.loss - 0.5 * LINE_PENALTY
            lines, loss = self._additions(most - len(self.lines), enough)
            if not len(lines) or loss > enough:
                break
            for added in dict.fromkeys((len(lines), 1)):  # together or, where they are too many, the best alone
                new, loss = fit_lines(
                    self.model, torch.cat([self.lines, lines[:added]]), self.relief, self.sigma, iterations=6
                )
                if loss <= self.loss - added * LINE_PENALTY:
                    break
            else:
                break
            self.lines, self.loss, grown = new, loss, True
        return grown

    def _additions(self, most: int, enough: float) -> tuple[torch.Tensor, float]:
        """Lines that may be added at once, as they have nothing to do with each other; and the loss with the first.

        Of those that do not bring the loss down to ``enough`` none is a good one.
        """
        rest = self.relief - self.model.joined(self.shown.parts)
        # Large residuals, and residuals that are large for their place.
        shown = (rest / (1 + (self.spread / UNSURE_M).square()).sqrt(), rest / self.sigma)
        size = self.model.scene.plate_size_m
        shape = self.model.shape
        ridges = [proposed_lines(view.double().cpu().numpy(), size, PROPOSED_RIDGES, shape) for view in shown]
        ridges[1][:, HEIGHT] = LOW_M
        starts = self._promising(rest, torch.from_numpy(np.concatenate(ridges)))
        if not len(starts):
            return starts, np.inf
        fitted, losses = fit_each(self.model, starts, rest, self.sigma, iterations=8, below=enough)
        parts = self.model.each(fitted).flatten(1)
        parts = parts / parts.norm(dim=1, keepdim=True).clamp_min(1e-12)
        alike = (parts @ parts.T).cpu()
        order = losses.argsort().tolist()
        taken = order[:1]
        for k in order[1:]:
            saves = float(losses[k]) < self.loss - LINE_PENALTY
            if saves and len(taken) < most and float(alike[k, taken].max()) < APART_OVERLAP:
                taken.append(k)
        return fitted[taken], float(losses[taken[0]])

    def _promising(self, rest: torch.Tensor, ridges: torch.Tensor) -> torch.Tensor:
        """Those of the lines that lower the loss most as they are."""
        heights = self.model.each(ridges)
        squared = ((rest - heights) / self.sigma).square()
        loss = (squared / (1 + squared)).flatten(1).sum(dim=1)
        return ridges[loss.cpu().argsort()[:FITTED_PROPOSALS]]

    def merge(self) -> None:
        """Make one line of two that continue each other, where that costs less than a line saves."""
        failed: set[bytes] = set()
        while self._merge_once(failed):
            pass

    def _merge_once(self, failed: set[bytes]) -> bool:
        """Join one pair; pairs that ``failed``, neither of which has moved since, are not tried again."""
        numbers = self.lines.numpy()
        tried = []
        for i in range(len(numbers)):
            for j in range(i):
                key = numbers[[i, j]].tobytes()
                if key in failed:
                    continue
                row = joined_line(numbers[i], numbers[j])
                if row is None:
                    failed.add(key)
                else:
                    tried.append(((i, j), row, key))
        if not tried:
            return False
        parts = self.shown.parts
        for some in (tried[first : first + MERGED_AT_ONCE] for first in range(0, len(tried), MERGED_AT_ONCE)):
            starts = self.model.clamped(torch.from_numpy(np.stack([row for _, row, _ in some])))
            enough = self.loss + LINE_PENALTY
            joined, losses = fit_each(
                self.model,
                starts,
                self.relief,
                self.sigma,
                iterations=8,
                printed_m=self.model.without(parts, [pair for pair, _, _ in some]),
                below=enough + GIVEN_UP_LOSS,
            )
            for (pair, _, key), line, alone in zip(some, joined, losses.tolist(), strict=True):
                failed.add(key)
                if alone > enough + GIVEN_UP_LOSS:
                    continue
                others = [k for k in range(len(parts)) if k not in pair]
                near = self._near(self.model.each(line[None])[0], parts[others])
                still = [k for at, k in enumerate(others) if at not in set(near)]
                lines = torch.cat([self.lines[others], line[None]])
                lines, loss = self._fitted(lines, [*near, len(others)], still, 8, enough)
                if loss < enough:
                    self.lines, self.loss = lines, loss
                    return True
        return False

    def prune(self) -> None:
        """Remove lines that the others replace."""
        k = 0
        while k < len(self.lines):
            kept, loss = self._without(k)
            if loss < self.loss + LINE_PENALTY:
                self.lines, self.loss = kept, loss
            else:
                k += 1

    def _without(self, k: int) -> tuple[torch.Tensor, float]:
        """The other lines in place of all, those that cover the same plate moved first, and their loss."""
        others = [j for j in range(len(self.lines)) if j != k]
        kept, enough, alike = self.lines[others], self.loss + LINE_PENALTY, self.shown.alike[k]
        for overlap, iterations, asked in ((RIVAL_OVERLAP, 8, enough + GIVEN_UP_LOSS), (APART_OVERLAP, 6, enough)):
            near = [at for at, j in enumerate(others) if alike[j] > overlap]
            still = [j for j in others if alike[j] <= overlap]
            kept, loss = self._fitted(kept, near, still, iterations, asked)
            if loss > asked:
                break
        return kept, loss

    def _near(self, part: torch.Tensor, others: torch.Tensor) -> list[int]:
        """Which of the others [L, n, n] have something to do with a line [n, n], by the angle between heights."""
        norms = others.flatten(1).norm(dim=1).clamp_min(1e-12) * part.norm().clamp_min(1e-12)
        alike = (others.flatten(1) @ part.flatten()) / norms
        near: list[int] = (alike > APART_OVERLAP).nonzero()[:, 0].tolist()
        return near

    def _fitted(
        self, lines: torch.Tensor, only: list[int], still: list[int], iterations: int, below: float
    ) -> tuple[torch.Tensor, float]:
        """Some of the lines moved; those beside them stay where these lines here are."""
        printed = self.model.joined(self.shown.parts[still])
        about = self.model, lines, self.relief, self.sigma
        return fit_lines(*about, iterations=iterations, only=only, below=below, others_m=printed)


class _Shown:
    """Lines, each alone, and how much any two have to do with each other; made when they are asked for."""

    def __init__(self, model: LineModel, lines: torch.Tensor):
        self.lines, self._model = lines, model

    @cached_property
    def parts(self) -> torch.Tensor:
        """Heights [m], shape [L, n, n]."""
        return self._model.each(self.lines)

    @cached_property
    def alike(self) -> list[list[float]]:
        """Cosines of the angles between heights [1], of line by line."""
        flat = self.parts.flatten(1)
        flat = flat / flat.norm(dim=1, keepdim=True).clamp_min(1e-12)
        found: list[list[float]] = (flat @ flat.T).tolist()
        return found


def joined_line(a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """One line from end to end of two that lie on one straight line with little gap; None for others.

    Args:
        a: a line, shape [6] [m].
        b: another one.
    """
    ends = np.array([a[:2], a[2:4], b[:2], b[2:4]])
    distances = np.hypot(*(ends[:, None] - ends[None]).transpose(2, 0, 1))
    i, j = np.unravel_index(int(distances.argmax()), distances.shape)
    total = distances[i, j]
    if total < 1e-9:
        return None
    direction = (ends[j] - ends[i]) / total
    normal = np.array([-direction[1], direction[0]])
    if np.abs((ends - ends[i]) @ normal).max() > 0.5 * max(a[WIDTH], b[WIDTH]) + LARGEST_ASIDE_M:
        return None
    lengths = np.array([distances[0, 1], distances[2, 3]])
    if total - lengths.sum() > 0.25 * total + LARGEST_GAP_M:
        return None
    share = (lengths + DROP_LENGTH_M) / (lengths + DROP_LENGTH_M).sum()
    joined: np.ndarray = np.concatenate([ends[i], ends[j], share[0] * a[WIDTH:] + share[1] * b[WIDTH:]])
    return joined
