"""A set of lines with corners and curves that is fitted to a relief, and changes that a fit cannot make."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.prints.line_shape import half_height
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.smooth_chains import Track
from warp_caustics.prints.vectorise.curved_ends import cuts, meetings, without_stretch
from warp_caustics.prints.vectorise.curved_fit import CurvedFit
from warp_caustics.prints.vectorise.curved_lines import LEAST_M, PENALTY, CurvedLines, line_of_ridge, penalty_of
from warp_caustics.prints.vectorise.ridges import circles_of, ridges_of
from warp_caustics.types import BoolArray, FloatArray

FITTED_ITERATIONS, AGAIN_ITERATIONS = 12, 4
"""Of L-BFGS with a line that is added, and where others were added since."""
UNSTACKED_ITERATIONS = 30
"""Of lines that were one on the other."""
FITTED_AT_ONCE = 12
"""Of those that may be added, the ones that save most as they are."""
MOST_RIDGES = 80
"""That are looked at, the clearest."""
OF_CROWN = 0.1
"""Share of a line's crown from which on it counts as there."""
DOUBTFUL = 0.25
"""Mean loss under a line from which on it may be wrong."""
ON_TOP = 0.3
"""Share of a line that lies on another one for both to be followed anew together."""
MOST_REBUILT = 8
"""Lines, or pairs, that are followed anew in a round."""
MOST_CUTS, CUTS_FITTED = 24, 3
"""Places where a line is cut that are looked at, and of these the best that are fitted."""
HIGHER = 0.1, 4.0
"""Times that a piece may be as high as the line was."""
LONG = 4.0
"""Times the larger width that a line goes along another one from which on both may be one."""
SAME_LINE = 0.3
"""Cosine of the angle between reliefs of lines that may be the same."""
MOSTLY = 0.6
"""Share of a ridge that is where lines were taken away."""


@dataclass(frozen=True, eq=False)
class State:
    """Lines of a set.

    Attributes:
        lines: all.
        parts: each alone [m], shape [L, n, n].
        loss: that they leave.
    """

    lines: CurvedLines
    parts: torch.Tensor
    loss: float

    @property
    def worth(self) -> float:
        """Loss and penalties: the less, the better."""
        return self.loss + sum(penalty_of(track) for track in self.lines.tracks)


class CurvedSet:
    """Lines under change.

    Args:
        model: of straight lines, with the section and overlap of these.
        relief_m: to be explained, shape [n, n].
        spread_m: how far it may be wrong [m], shape [n, n].
    """

    def __init__(self, model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor):
        self.fit = CurvedFit(model, relief_m, spread_m)
        self.model = self.fit.model
        self._refused = set[tuple[int, ...]]()
        """Lines that were tried, about."""
        self.begin(CurvedLines([], np.zeros((0, 2))))

    @property
    def lines(self) -> CurvedLines:
        """All of them."""
        return self.state.lines

    @property
    def worth(self) -> float:
        """Loss and penalties: the less, the better."""
        return self.state.worth

    def begin(self, lines: CurvedLines) -> None:
        """Have these lines, and no others."""
        self.state = self._state(lines, self.fit.parts(lines))

    def focus(self, floor_m: float) -> None:
        """Expect residuals of the spread and of ``floor_m``."""
        self._refused.clear()
        self.fit.focus(floor_m)
        self.state = self._state(self.lines, self.state.parts)

    def refit(self, iterations: int) -> None:
        """Let all lines move."""
        if len(self.lines):
            self.begin(self.fit.moved(self.lines, None, iterations))

    def _state(self, lines: CurvedLines, parts: torch.Tensor) -> State:
        return State(lines, parts, self.fit.loss(self.model.joined(parts)))

    def _without(self, gone: Sequence[int]) -> State:
        """All lines but some."""
        rest = [k for k in range(len(self.lines)) if k not in gone]
        return self._state(self.lines.kept(rest), self.state.parts[rest])

    def _key(self, track: Track, width: float) -> tuple[int, ...]:
        nodes, pitch = track.nodes_m, min(self.model.scene.sample_pitch_m)
        ends = sorted([nodes[0].tolist(), nodes[-1].tolist()])
        if track.is_closed:
            ends = sorted([nodes.min(axis=0).tolist(), nodes.max(axis=0).tolist()])
        middle = [0.0, 0.0] if track.is_closed else nodes[len(nodes) // 2].tolist()
        return tuple(round(value / (2 * pitch)) for value in (*ends[0], *ends[1], *middle, 2 * width))

    def grow(self, most: int) -> bool:
        """Add the ridges of what is left that explain some of it, those that explain most first; whether any do."""
        before = len(self.lines)
        self.state = self._grown(self.state, most)
        return len(self.lines) > before

    def rebuild(self, most: int) -> bool:
        """Follow ridges anew where lines leave much, without one, or two on top of each other; whether it helped.

        A way that went astray early keeps the right ones out.
        """
        helped = False
        # Lines change their numbers when others are built anew; their ways stay.
        for gone in [[self.lines.tracks[k] for k in group] for group in self._doubtful()]:
            group = [k for k, track in enumerate(self.lines.tracks) if any(track is each for each in gone)]
            if len(group) < len(gone):
                continue
            bare, parts = self._without(group), self.state.parts[group]
            where = (parts > OF_CROWN * parts.amax()).any(dim=0).cpu().numpy()
            found = self._grown(bare, min(most, len(self.lines) + 1), where)
            if found.worth < self.worth - 1:
                self.state, helped = found, True
        return helped

    def _masks(self) -> torch.Tensor:
        """Cells of each line, 1 or 0, shape [L, n n]."""
        flat = self.state.parts.flatten(1)
        return (flat > OF_CROWN * flat.amax(dim=1, keepdim=True).clamp_min(1e-12)).float()

    def _doubtful(self) -> list[tuple[int, ...]]:
        """Lines under which much is left, alone, with one that lies on top, and two that touch; the worst first."""
        if not len(self.lines):
            return []
        fit, parts = self.fit, self.state.parts
        left = ((self.model.joined(parts) - fit.relief) / fit.sigma).square().log1p() / 2
        masks = self._masks()
        under = masks @ left.flatten()
        mean = under / masks.sum(dim=1).clamp_min(1)
        bad = [float(mean[k]) > DOUBTFUL and float(under[k]) > PENALTY for k in range(len(masks))]
        both = masks @ masks.T
        shared = both / masks.sum(dim=1).clamp_min(1)
        lie_on_top = torch.maximum(shared, shared.T) > ON_TOP

        def is_pair(k: int, m: int) -> bool:
            touch = bad[k] and bad[m] and bool(both[k, m] > 0)
            return touch or ((bad[k] or bad[m]) and bool(lie_on_top[k, m]))

        groups: list[tuple[float, tuple[int, ...]]] = [(float(under[k]), (k,)) for k in range(len(masks)) if bad[k]]
        for k in range(len(masks)):
            groups += [(float(under[k] + under[m]), (k, m)) for m in range(k + 1, len(masks)) if is_pair(k, m)]
        return [group for _, group in sorted(groups, reverse=True)[:MOST_REBUILT]]

    def _grown(self, state: "State", most: int, where: BoolArray | None = None) -> "State":
        """With the lines along ridges of what is left that explain some of it, those that explain most first.

        Args:
            state: to begin with.
            most: number of lines at most.
            where: of the ridges, most of each; shape [n, n]. None for everywhere.
        """
        others = self.model.joined(state.parts)
        tried = self._candidates(others, where)
        while tried and len(state.lines) < most:
            # What they save as they are is cheap, and tells which may save most.
            saved = self._saved(tried, state.loss, others)
            order = [tried[k] for k in np.argsort(-saved, kind="stable")]
            fitted = self._fitted(order[:FITTED_AT_ONCE], others)
            saved = self._saved(fitted, state.loss, others)
            k = int(np.argmax(saved))
            if saved[k] <= 0:
                if where is None:
                    self._refused.update(each.key for each in order[:FITTED_AT_ONCE])
                tried = order[FITTED_AT_ONCE:]
                continue
            best = fitted[k]
            # Others of the same line would be added for what it leaves before all have moved.
            rest = fitted[:k] + fitted[k + 1 :] + order[FITTED_AT_ONCE:]
            tried = [each for each in rest if _alike(each.part, best.part) < SAME_LINE]
            state = self._state(state.lines.with_more(best.line), torch.cat([state.parts, best.part]))
            others = self.model.joined(state.parts)
        return state

    def _candidates(self, others: torch.Tensor, where: BoolArray | None) -> list["Candidate"]:
        """Lines along the ridges of what is left."""
        rest = np.asarray((self.fit.relief - others).double().cpu().numpy())
        about = self.model.scene.sample_pitch_m, self.model.scene.plate_size_m, 1 / half_height(self.model.shape)
        ridges, found = ridges_of(np.maximum(rest, 0.0), LEAST_M)[:MOST_RIDGES], []
        for ridge in [*ridges, *circles_of(ridges)]:
            if where is not None:
                columns, rows = np.clip(np.rint(ridge.points).astype(int), 0, len(rest) - 1).T
                if where[rows, columns].mean() < MOSTLY:
                    continue
            line = line_of_ridge(ridge, rest, *about)
            if line is None:
                continue
            key = self._key(line.tracks[0], float(line.sizes[0, 0]))
            if where is not None or key not in self._refused:
                found.append(Candidate(line, self.fit.parts(line), key))
        return found

    def _fitted(self, candidates: Sequence["Candidate"], others: torch.Tensor) -> list["Candidate"]:
        """Lines fitted beside others, each by itself."""
        found = dict[int, Candidate]()
        for is_fitted, iterations in ((True, AGAIN_ITERATIONS), (False, FITTED_ITERATIONS)):
            which = [k for k, each in enumerate(candidates) if each.is_fitted == is_fitted]
            moved = self.fit.moved_each([candidates[k].line for k in which], others, iterations)
            for k, line in zip(which, moved, strict=True):
                found[k] = Candidate(line, self.fit.parts(line), candidates[k].key, is_fitted=True)
        return [found[k] for k in range(len(candidates))]

    def _saved(self, candidates: Sequence["Candidate"], before: float, others: torch.Tensor) -> FloatArray:
        """Loss that each saves beside others, which leave a loss of ``before``, beyond its penalty; shape [B]."""
        reliefs = self.model.over(torch.cat([each.part for each in candidates]), others)
        penalties = np.array([penalty_of(each.line.tracks[0]) for each in candidates])
        saved: FloatArray = before - self.fit.losses(reliefs) - penalties
        return saved

    def split(self, most: int) -> bool:
        """Cut lines under which much is left in two of different sizes; whether any was.

        A way may go from one line to another that is about as wide and high.
        """
        done = False
        for (k,) in [group for group in self._doubtful() if len(group) == 1]:
            if len(self.lines) >= most:
                break
            bare, best = self._without([k]), self.state
            others = self.model.joined(bare.parts)
            for pieces in self._best_cuts(k, others):
                fitted = self.fit.moved(pieces, others, FITTED_ITERATIONS)
                parts = torch.cat([bare.parts, self.fit.parts(fitted)])
                tried = self._state(bare.lines.with_more(fitted), parts)
                if tried.worth < min(best.worth, self.worth - 1):
                    best = tried
            if best is not self.state:
                # The pieces take the place of the line and the one behind the last, so that others keep theirs.
                count = len(best.lines)
                order = [*range(k), count - 2, *range(k, count - 2), count - 1]
                self.state, done = State(best.lines.kept(order), best.parts[order], best.loss), True
        return done

    def _best_cuts(self, k: int, others: torch.Tensor) -> list[CurvedLines]:
        """Line k as two pieces, each as high as tells the relief best, cut where that leaves least."""
        size, found = self.lines.sizes[k], list[tuple[float, CurvedLines]]()
        pairs = cuts(self.lines.tracks[k], MOST_CUTS)
        if not pairs:
            return []
        parts = self.fit.parts(
            CurvedLines([piece for pair in pairs for piece in pair], np.tile(size, (2 * len(pairs), 1)))
        )
        residual = (self.fit.relief - self.model.over(self.state.parts[k], others)) / self.fit.sigma
        # Least squares with the weights that the loss has here, of what each piece should be higher by.
        weight = 1 / (1 + residual.square()) / self.fit.sigma.square()
        for pair, both in zip(pairs, parts.unflatten(0, (-1, 2)), strict=True):
            flat = both.flatten(1).double()
            weighted = flat * weight.flatten()
            left = weighted @ (residual * self.fit.sigma).flatten().double()
            more = torch.linalg.lstsq((weighted @ flat.T).cpu(), left[:, None].cpu()).solution[:, 0]
            higher = (1 + more).clamp(*HIGHER)
            joined = self.model.joined(both * higher[:, None, None].to(both))
            sizes = size * np.stack([np.ones(2), higher.numpy()], axis=1)
            found.append((self.fit.loss(self.model.over(joined, others)), CurvedLines(list(pair), sizes)))
        return [each for _, each in sorted(found, key=lambda pair: pair[0])[:CUTS_FITTED]]

    def unstack(self) -> bool:
        """Have one line where one lies on another for long; whether that told the relief as well anywhere.

        A way that goes on along another line is cut where it does, and the other is as high as both: neither could be
        cut, or followed anew, alone without leaving more.
        """
        done, tried = False, set[tuple[int, ...]]()
        while True:
            pairs = [pair for pair in self._stacked() if pair not in tried]
            if not pairs:
                return done
            k, m = pairs[0]
            tried.add((k, m))
            crown = float(self.state.parts[m].amax())
            pieces = without_stretch(self.lines.tracks[k], self._heights_at(m, self.lines.tracks[k]) > OF_CROWN * crown)
            if pieces is None:
                continue
            bare, sizes = self._without((k, m)), self.lines.sizes
            width = float(np.average(sizes[[k, m], 0], weights=sizes[[k, m], 1]))
            size = np.array([*sizes[[k] * len(pieces)], [width, sizes[[k, m], 1].sum()]])
            new = CurvedLines([*pieces, self.lines.tracks[m]], size)
            fitted = self.fit.moved(new, self.model.joined(bare.parts), UNSTACKED_ITERATIONS)
            found = self._state(bare.lines.with_more(fitted), torch.cat([bare.parts, self.fit.parts(fitted)]))
            if found.worth < self.worth:
                self.state, done = found, True
                tried.clear()

    def _stacked(self) -> list[tuple[int, int]]:
        """Pairs of lines of which the first goes along the second for long."""
        if not len(self.lines):
            return []
        masks = self._masks()
        both = masks @ masks.T
        wide = torch.as_tensor(self.lines.sizes[:, 0] / min(self.model.scene.sample_pitch_m)).to(both)
        found = both > LONG * torch.maximum(wide[:, None], wide).square()
        return [(k, m) for k, m in found.nonzero().tolist() if k != m]

    def _heights_at(self, k: int, track: Track) -> FloatArray:
        """Of line k at the nodes of another [m], shape [N]."""
        n, scene = self.model.n, self.model.scene
        places = (track.nodes_m / scene.plate_size_m + 0.5) * n - 0.5
        columns, rows = np.clip(np.rint(places), 0, n - 1).astype(int).T
        heights: FloatArray = self.state.parts[k].double().cpu().numpy()[rows, columns]
        return heights

    def prune(self) -> bool:
        """Remove lines that save less than their penalty; whether any was."""
        removed = False
        while len(self.lines):
            losses = self.fit.losses(self.model.without_each(self.state.parts))
            saved = losses - self.state.loss - [penalty_of(track) for track in self.lines.tracks]
            k = int(np.argmin(saved))
            if saved[k] > 0:
                break
            self.state, removed = self._without([k]), True
        return removed

    def link(self) -> bool:
        """Take lines that meet, and are alike, for one; whether any were."""
        linked = False
        tried = set[tuple[float, ...]]()
        while True:
            pairs = [pair for pair in meetings(self.lines) if pair.key not in tried]
            if not pairs:
                return linked
            pair = pairs[0]
            tried.add(pair.key)
            bare = self._without(pair.lines)
            others = self.model.joined(bare.parts)
            joined = [CurvedLines([track], pair.size[None]) for track in pair.tracks]
            for fitted in self.fit.moved_each(joined, others, FITTED_ITERATIONS):
                parts = torch.cat([bare.parts, self.fit.parts(fitted)])
                found = self._state(bare.lines.with_more(fitted), parts)
                if found.worth < self.worth:
                    self.state, linked = found, True


def _alike(one: torch.Tensor, other: torch.Tensor) -> float:
    """Cosine of the angle between two reliefs."""
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-30))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A line that may be added.

    Attributes:
        line: it alone.
        part: its relief [m], shape [1, n, n].
        key: about where it is, and how wide.
        is_fitted: it is no more as its ridge told.
    """

    line: CurvedLines
    part: torch.Tensor
    key: tuple[int, ...]
    is_fitted: bool = False
