"""A set of lines with corners and curves that is fitted to a relief, and changes that a fit cannot make."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.model import LineModel, half_height
from warp_caustics.prints.overlap import share
from warp_caustics.prints.smooth_chains import Track, TrackPoints
from warp_caustics.prints.vectorise.curved_ends import halves, meetings
from warp_caustics.prints.vectorise.curved_lines import LEAST_M, PENALTY, CurvedLines, line_of_ridge, penalty_of
from warp_caustics.prints.vectorise.ridges import circles_of, ridges_of
from warp_caustics.types import BoolArray, FloatArray

NODE_SCALE_M, WIDTH_SCALE_M, HEIGHT_SCALE_M = 4e-5, 4e-5, 2e-5
"""Changes that change a relief about as much."""
HELD_M = 4e-4
"""Standard deviation of what a node moves [m], which keeps nodes from sliding along their line."""
SKETCHED = 2
"""Points of a cell, each way, that are looked at."""
FITTED_ITERATIONS, AGAIN_ITERATIONS = 12, 4
"""Of L-BFGS with a line that is added, and where others were added since."""
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
SAME_LINE = 0.3
"""Cosine of the angle between reliefs of lines that may be the same."""
MOSTLY = 0.6
"""Share of a ridge that is where lines were taken away."""
CONVERGED = 1e-6


class CurvedSet:
    """Lines under change.

    Args:
        model: of straight lines, with the section and overlap of these.
        relief_m: to be explained, shape [n, n].
        spread_m: how far it may be wrong [m], shape [n, n].
    """

    def __init__(self, model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor):
        self.model, self.chains = model, ChainModel(model.sketched(SKETCHED))
        self.relief = relief_m.to(model.device, torch.float32)
        self.spread = spread_m.to(model.device, torch.float32)
        self.sigma = self.spread
        self.lines = CurvedLines([], np.zeros((0, 2)))
        self.loss = np.inf
        self._refused = set[tuple[int, ...]]()
        """Lines that were tried, about."""
        self.parts = torch.zeros(0, model.n, model.n, device=model.device)

    def focus(self, floor_m: float) -> None:
        """Expect residuals of the spread and of ``floor_m``."""
        self._refused.clear()
        self.sigma = (self.spread.square() + floor_m**2).sqrt()
        self.loss = self._loss(self.chains.model.joined(self.parts))

    def _key(self, track: Track, width: float) -> tuple[int, ...]:
        nodes, pitch = track.nodes_m, min(self.model.scene.sample_pitch_m)
        ends = sorted([nodes[0].tolist(), nodes[-1].tolist()])
        if track.is_closed:
            ends = sorted([nodes.min(axis=0).tolist(), nodes.max(axis=0).tolist()])
        middle = [0.0, 0.0] if track.is_closed else nodes[len(nodes) // 2].tolist()
        return tuple(round(value / (2 * pitch)) for value in (*ends[0], *ends[1], *middle, 2 * width))

    def _loss(self, heights: torch.Tensor) -> float:
        return float(((heights - self.relief) / self.sigma).square().log1p().sum(dtype=torch.float64)) / 2

    def refit(self, iterations: int) -> None:
        """Let all lines move."""
        if len(self.lines):
            self.begin(self._moved(self.lines, None, iterations))

    def _moved(self, lines: CurvedLines, others_m: torch.Tensor | None, iterations: int) -> CurvedLines:
        """Lines fitted to the relief with others [m], shape [n, n], that stay."""
        points = TrackPoints(lines.tracks)
        begun, count = points.nodes_m, 2 * len(points.nodes_m)
        scales = np.tile([WIDTH_SCALE_M, HEIGHT_SCALE_M], (len(lines), 1))
        limits = self.model.limits
        low, high = np.array([limits.width_m, limits.height_m]).T
        model = self.chains.model

        def numbers(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            nodes = begun + NODE_SCALE_M * u[:count].reshape(-1, 2)
            return nodes, lines.sizes + scales * u[count:].reshape(-1, 2)

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            nodes, sizes = numbers(u)
            at, told = points.of(nodes), torch.from_numpy(sizes)
            parts = self.chains.parts(at, told)
            heights = model.joined(parts)
            if others_m is not None:
                heights = model.over(heights, others_m)
            residual = (heights - self.relief) / self.sigma
            loss = float(residual.square().log1p().sum(dtype=torch.float64)) / 2
            by_height = residual / (1 + residual.square()) / self.sigma
            if others_m is not None and model.shape.overlap != 1:
                by_height = by_height * share(model.joined(parts), heights, model.shape.overlap)
            by_point, by_size = self.chains.gradient(at, told, parts, by_height)
            held = NODE_SCALE_M / HELD_M * u[:count]
            by_node = NODE_SCALE_M * points.back(by_point).ravel() + NODE_SCALE_M / HELD_M * held
            gradient = np.concatenate([by_node, (by_size.numpy() * scales).ravel()])
            return loss + float(held @ held) / 2, gradient

        ends = [(None, None)] * count
        for size, scale in zip(lines.sizes, scales, strict=True):
            ends += [((low[c] - size[c]) / scale[c], (high[c] - size[c]) / scale[c]) for c in range(2)]
        settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 20, "ftol": CONVERGED}
        start = np.zeros(count + 2 * len(lines))
        found = scipy.optimize.minimize(objective, start, jac=True, method="L-BFGS-B", bounds=ends, options=settings)
        nodes, sizes = numbers(found.x)
        return CurvedLines(points.tracks_at(nodes), sizes)

    def begin(self, lines: CurvedLines) -> None:
        """Have these lines, and no others."""
        self.lines, self.parts = lines, self._parts(lines)
        self.loss = self._loss(self.chains.model.joined(self.parts))

    def _parts(self, lines: CurvedLines) -> torch.Tensor:
        if not len(lines):
            return torch.zeros(0, self.model.n, self.model.n, device=self.model.device)
        points = TrackPoints(lines.tracks)
        return self.chains.parts(points.of(points.nodes_m), torch.from_numpy(lines.sizes))

    def grow(self, most: int) -> bool:
        """Add the ridges of what is left that explain some of it, those that explain most first; whether any do."""
        before = len(self.lines)
        self._keep(self._grown(self.state, most))
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
            rest = [k for k in range(len(self.lines)) if k not in group]
            parts = self.parts[rest]
            bare = State(self.lines.kept(rest), parts, self._loss(self.chains.model.joined(parts)))
            where = (self.parts[group] > OF_CROWN * self.parts[group].amax()).any(dim=0).cpu().numpy()
            found = self._grown(bare, min(most, len(rest) + len(group) + 1), where)
            if _worth(found) < _worth(self.state) - 1:
                self._keep(found)
                helped = True
        return helped

    @property
    def state(self) -> "State":
        """All of it."""
        return State(self.lines, self.parts, self.loss)

    @property
    def worth(self) -> float:
        """Loss and penalties: the less, the better."""
        return _worth(self.state)

    def _keep(self, state: "State") -> None:
        self.lines, self.parts, self.loss = state.lines, state.parts, state.loss

    def _doubtful(self) -> list[tuple[int, ...]]:
        """Lines under which much is left, alone and with one that lies on top, the worst first."""
        if not len(self.lines):
            return []
        left = ((self.chains.model.joined(self.parts) - self.relief) / self.sigma).square().log1p() / 2
        crowns = self.parts.flatten(1).amax(dim=1)[:, None, None].clamp_min(1e-12)
        masks = (self.parts > OF_CROWN * crowns).flatten(1).float()
        under = masks @ left.flatten()
        mean = under / masks.sum(dim=1).clamp_min(1)
        bad = [k for k in range(len(self.lines)) if float(mean[k]) > DOUBTFUL and float(under[k]) > PENALTY]
        shared = (masks @ masks.T) / masks.sum(dim=1).clamp_min(1)
        groups: list[tuple[float, tuple[int, ...]]] = [(float(under[k]), (k,)) for k in bad]
        for k in bad:
            groups += [
                (float(under[k] + under[m]), (k, m))
                for m in range(len(self.lines))
                if m != k and (m > k or m not in bad) and float(torch.maximum(shared[k, m], shared[m, k])) > ON_TOP
            ]
        return [group for _, group in sorted(groups, reverse=True)[:MOST_REBUILT]]

    def _grown(self, state: "State", most: int, where: BoolArray | None = None) -> "State":
        """With the lines along ridges of what is left that explain some of it, those that explain most first.

        Args:
            state: to begin with.
            most: number of lines at most.
            where: of the ridges, most of each; shape [n, n]. None for everywhere.
        """
        joined = self.chains.model.joined
        others = joined(state.parts)
        tried = self._candidates(others, where)
        while tried and len(state.lines) < most:
            # What they save as they are is cheap, and tells which may save most.
            order = sorted(tried, key=lambda each: self._saved(each, state.loss, others), reverse=True)
            fitted = [self._fitted(each, others) for each in order[:FITTED_AT_ONCE]]
            saved = [self._saved(each, state.loss, others) for each in fitted]
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
            parts = torch.cat([state.parts, best.part])
            others = joined(parts)
            state = State(state.lines.with_more(best.line), parts, self._loss(others))
        return state

    def _candidates(self, others: torch.Tensor, where: BoolArray | None) -> list["Candidate"]:
        """Lines along the ridges of what is left."""
        rest = np.asarray((self.relief - others).double().cpu().numpy())
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
                found.append(Candidate(line, self._parts(line), key))
        return found

    def _fitted(self, candidate: "Candidate", others: torch.Tensor) -> "Candidate":
        """A line fitted beside others."""
        iterations = AGAIN_ITERATIONS if candidate.is_fitted else FITTED_ITERATIONS
        line = self._moved(candidate.line, others, iterations)
        return Candidate(line, self._parts(line), candidate.key, is_fitted=True)

    def _saved(self, candidate: "Candidate", before: float, others: torch.Tensor) -> float:
        """Loss that a line saves beside others, which leave a loss of ``before``, beyond its penalty."""
        loss = self._loss(self.chains.model.over(candidate.part[0], others))
        return before - loss - penalty_of(candidate.line.tracks[0])

    def split(self, most: int) -> bool:
        """Cut lines under which much is left in two of different sizes; whether any was.

        A way may go from one line to another that is about as wide and high.
        """
        done = False
        for (k,) in [group for group in self._doubtful() if len(group) == 1]:
            if len(self.lines) >= most:
                break
            rest = [number for number in range(len(self.lines)) if number != k]
            others, size = self.chains.model.joined(self.parts[rest]), self.lines.sizes[[k, k]]
            before, best = self.loss + penalty_of(self.lines.tracks[k]) - 1, None
            for pieces in halves(self.lines.tracks[k]):
                fitted = self._moved(CurvedLines(pieces, size), others, FITTED_ITERATIONS)
                parts = self._parts(fitted)
                loss = self._loss(self.chains.model.joined(torch.cat([self.parts[rest], parts])))
                worth = loss + sum(penalty_of(piece) for piece in pieces)
                if worth < before:
                    before, best = worth, (fitted, parts, loss)
            if best is not None:
                # The pieces take the place of the line and the one behind the last, so that others keep theirs.
                fitted, parts, loss = best
                tracks = list(self.lines.tracks)
                tracks[k] = fitted.tracks[0]
                sizes = self.lines.sizes.copy()
                sizes[k] = fitted.sizes[0]
                all_parts = self.parts.clone()
                all_parts[k] = parts[0]
                self.lines = CurvedLines([*tracks, fitted.tracks[1]], np.concatenate([sizes, fitted.sizes[1:]]))
                self.parts, self.loss, done = torch.cat([all_parts, parts[1:]]), loss, True
        return done

    def prune(self) -> bool:
        """Remove lines that save less than their penalty; whether any was."""
        removed = False
        while len(self.lines):
            reliefs = self.chains.model.without_each(self.parts)
            losses = [
                self._loss(relief) - self.loss - penalty_of(track)
                for relief, track in zip(reliefs, self.lines.tracks, strict=True)
            ]
            k = int(np.argmin(losses))
            if losses[k] > 0:
                break
            rest = [number for number in range(len(self.lines)) if number != k]
            self.lines, self.parts, removed = self.lines.kept(rest), self.parts[rest], True
            self.loss = self._loss(self.chains.model.joined(self.parts))
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
            rest = [k for k in range(len(self.lines)) if k not in pair.lines]
            others = self.chains.model.joined(self.parts[rest])
            penalty = sum(penalty_of(self.lines.tracks[k]) for k in set(pair.lines))
            best, least = None, self.loss + penalty
            for track in pair.tracks:
                joined = CurvedLines([track], pair.size[None])
                fitted = self._moved(joined, others, FITTED_ITERATIONS)
                part = self._parts(fitted)
                loss = self._loss(self.chains.model.over(part[0], others))
                if loss + penalty_of(track) < least:
                    least, best = loss + penalty_of(track), (fitted, part, loss)
            if best is not None:
                self.lines = self.lines.kept(rest).with_more(best[0])
                self.parts, self.loss = torch.cat([self.parts[rest], best[1]]), best[2]
                linked = True


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


def _worth(state: State) -> float:
    """Loss and penalties: the less, the better."""
    return state.loss + sum(penalty_of(track) for track in state.lines.tracks)


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
