"""Places where lines explain the image worst, cleared and built anew.

Where many lines lie on top of each other a search takes one that is wide for several short ones, and another for longer
than it is, which fills the gap. Each is held by the others: none of them can move, go or come alone without making the
image worse. So all that lies at a place is taken away at once and one line fitted to what is missing then, as it was or
as the network has it. Where nothing is cleared that line is one that was missed: over the whole plate what the network
gets wrong of other lines stands higher than a line of a third of a sample. And a line of which pieces are missing far
from its end reaches the next place where the image is explained badly.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.on_others import descended
from nets.reconstruct.fibres.search.clearing import Place, clearings, reaching, within
from nets.reconstruct.fibres.search.ends import ends_near, left_out_at, without
from nets.reconstruct.fibres.search.evolution import evolved, evolved_ends
from nets.reconstruct.fibres.search.growth import proposals, pruned
from nets.reconstruct.fibres.search.joins import gaps_between, ways_to_join, with_joins
from nets.reconstruct.fibres.search.moves import stretched, stretches
from nets.reconstruct.fibres.search.places import APART_M, worst_places
from nets.reconstruct.fibres.search.sums import taken_apart
from warp_caustics.prints.model import WIDTH

RADII_M = (3.5e-3, 6e-3)
"""Of what is cleared about a place."""
BEYOND_M = 2e-3
"""How far from there a missing line is looked for."""
RIDGES = 3
"""Highest points there through which lines are proposed, in two directions each."""
MOVING_M = 4.5e-3
"""Lines as near as this to a place move when something there has changed; all others stay."""
PLACES_LOOKED_AT = 10
"""Of which the worst that has not failed is built anew."""
ATTEMPTS, FAILURES = 8, 2
"""Places that are built anew, at most, and those of them at which nothing was better."""
OVERSHOOTS_M = (-1e-3, 0.5e-3, 2e-3, 4e-3)
"""How far beyond a place a line goes that is made to reach it."""
TRIED_FEWER, TRIED_OTHERS = 3, 3
"""Of all ways to have fewer lines, and of the others, those that are given a descent."""
TRIAL_ITERATIONS = 10
"""Of L-BFGS of the lines at a place."""
EVOLVING_ENDS = 6
"""At a place, of as many lines."""
LINE_FACTOR = 1.01
"""By which a line more must lower the misfit: of lines that explain an image alike the fewest are the plate's."""
REBUILT_FACTOR = 0.985
"""What is built anew must lower the misfit by this factor, lines counted."""
CLEARLY_BETTER = 0.9
"""By this factor, and no other way is tried."""
GIVEN_UP_FACTOR = 1.5
"""What raises the misfit by this factor before anything has moved is not followed."""


class _Way(NamedTuple):
    """Lines that may be better, shape [K, 6] [m], which of them changed, and the misfit as they are."""

    lines: torch.Tensor
    changed: list[int]
    loss: float


def rebuilt(
    fit: ImageFit,
    lines: torch.Tensor,
    relief_m: torch.Tensor,
    spread_m: torch.Tensor,
    quick: ImageFit | None = None,
    is_enough: Callable[[torch.Tensor], bool] = lambda lines: False,
    *,
    evolves: bool = False,
) -> Fitted | None:
    """Lines with the worst places built anew, one after the other, where the image likes it better.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        relief_m: of the network, shape [n, n] [m].
        spread_m: of its answers, shape [n, n] [m].
        quick: says which of all ways are tried; ``fit`` if None.
        is_enough: whether lines are good enough to end.
        evolves: places where nothing is better have lines evolve.

    Returns:
        None where nothing is better.
    """
    apart, failed = taken_apart(fit, lines, quick), list[Place]()
    is_better = apart is not None
    best = apart or Fitted(lines, fit.loss(fit.model.heights(lines)))
    for _ in range(0 if is_better and is_enough(best.lines) else ATTEMPTS):
        places = worst_places(fit, fit.model.heights(best.lines), PLACES_LOOKED_AT)
        place = next((at for at in places if all(math.dist(at, other) >= APART_M for other in failed)), None)
        if place is None or len(failed) == FAILURES:
            break
        found = _rebuilt_at(fit, best, place, _ways(quick or fit, best.lines, place, relief_m, spread_m), quick or fit)
        if found is None and evolves:
            found = _rebuilt_at(fit, best, place, _evolved(fit, best.lines, place), fit.metric)
        if found is None:
            failed.append(place)
            continue
        best, is_better = found, True
        if is_enough(best.lines):
            break
    if not is_better:
        return None
    if gaps_between(best.lines):
        best = with_joins(fit, fit.descend(best.lines, TRIAL_ITERATIONS).lines, quick)
    return pruned(fit, best.lines)


def _rebuilt_at(fit: ImageFit, before: Fitted, place: Place, ways: Iterable[_Way], quick: ImageFit) -> Fitted | None:
    """Lines with a place built anew in one of some ways; None where nothing is better.

    Args:
        fit: judges.
        before: lines so far.
        place: that is built anew.
        ways: to do so.
        quick: gave their misfits.
    """
    most = GIVEN_UP_FACTOR * quick.loss(fit.model.heights(before.lines))
    ways = [way for way in ways if way.loss <= most]
    ways.sort(key=lambda way: _score(way.loss, way.lines))
    fewer = [way for way in ways if len(way.lines) < len(before.lines)][:TRIED_FEWER]
    others = [way for way in ways if len(way.lines) >= len(before.lines)][:TRIED_OTHERS]

    def moved(lines: torch.Tensor, changed: list[int]) -> Fitted:
        moving = {*changed, *reaching(fit.model, lines, place, MOVING_M)}
        return descended(fit, lines, sorted(moving), TRIAL_ITERATIONS)

    # Lines were fitted to all pixels: at fewer they are better after a descent even if nothing else has changed.
    as_it_is = moved(before.lines, [])
    least, best = REBUILT_FACTOR * _score(as_it_is.loss, before.lines), None
    for way in fewer + others:
        found = moved(way.lines, way.changed)
        score = _score(found.loss, found.lines)
        if score < least:
            least, best = score, found
            if found.loss < CLEARLY_BETTER * as_it_is.loss:
                break
    return best


def _score(loss: float, lines: torch.Tensor) -> float:
    return loss * LINE_FACTOR ** len(lines)


def _ways(
    fit: ImageFit, lines: torch.Tensor, place: Place, relief_m: torch.Tensor, spread_m: torch.Tensor
) -> Iterator[_Way]:
    """Ways to build a place anew: a line more, cleared with one line in place of all and without, joined, moved."""
    model, total = fit.model, fit.model.heights(lines)
    sure = torch.zeros_like(total)
    for radius in RADII_M:
        yield from _with_one_more(fit, lines, [], place, radius, relief_m, spread_m)
        for kept, cut, taken in clearings(lines, place, radius):
            yield from _with_one_more(fit, kept, cut, place, radius, relief_m, spread_m)
            if taken:
                yield _Way(kept, cut, fit.loss(model.heights(kept)))
            if taken and taken + len(cut) > 1:
                yield from _with_one_more(fit, kept, cut, place, radius, total, sure)
    for joined, at in ways_to_join(lines):
        if math.dist(at, place) <= RADII_M[-1]:
            yield _Way(joined, [len(joined) - 1], fit.loss(model.heights(joined)))
    yield from _moved(fit, lines, place)


def _evolved(fit: ImageFit, lines: torch.Tensor, place: Place) -> Iterator[_Way]:
    """Ends that evolve at a place, with and without the short lines that may make up for what these do not tell.

    And a line: besides all others, in place of those within it, and of each that ends there.
    """
    model, few, ends = fit.model, fit.metric, lines[:, :4].reshape(-1, 2, 2)
    few.correct_at(model.heights(lines))
    for number, some in enumerate(left_out_at(lines, place)):
        kept = without(lines, some)
        meeting = ends_near(kept, place, EVOLVING_ENDS)
        if len(meeting) > 1:
            moved = evolved_ends(few, kept, meeting, seed=number)
            yield _Way(moved, [k for k, _ in meeting], few.loss(model.heights(moved)))
    near = (ends - lines.new_tensor(place)).norm(dim=2) <= RADII_M[0]
    within_it = near.all(dim=1).nonzero()[:, 0].tolist()
    gone = [[], within_it, *([k] for k in near.any(dim=1).nonzero()[:, 0].tolist())]
    for number, some in enumerate(gone):
        if some in gone[:number]:
            continue
        kept = lines[[k for k in range(len(lines)) if k not in some]]
        for line in evolved(few, kept, place, seed=number):
            with_it = torch.cat([kept, line[None]])
            yield _Way(with_it, [len(kept)], few.loss(model.heights(with_it)))


def _with_one_more(
    fit: ImageFit,
    lines: torch.Tensor,
    changed: list[int],
    place: Place,
    radius_m: float,
    relief_m: torch.Tensor,
    spread_m: torch.Tensor,
) -> Iterator[_Way]:
    """Lines with one more of what they leave of a relief about a place, that which the image likes best."""
    model = fit.model
    rest = torch.where(within(model, place, radius_m + BEYOND_M), relief_m - model.heights(lines), 0.0)
    tried = proposals(model, rest, spread_m, RIDGES)
    if len(tried):
        loss, number = _best(fit.losses_with_each(lines, tried))
        yield _Way(torch.cat([lines, tried[number][None]]), [*changed, len(lines)], loss)


def _moved(fit: ImageFit, lines: torch.Tensor, place: Place) -> Iterator[_Way]:
    """Single lines made longer and shorter at a place, or so long that they reach it, or left out."""
    model, at = fit.model, lines.new_tensor(place)
    near = reaching(model, lines, place, RADII_M[0])
    for k, line in enumerate(lines):
        others = [j for j in range(len(lines)) if j != k]
        tried = _extended(line, at)
        if k in near and others:
            yield _Way(lines[others], [], fit.loss(model.heights(lines[others])))
            longer = ((moved, moved[end : end + 2].tolist()) for moved, end, _ in stretches(line))
            tried += [moved for moved, end in longer if math.dist(end, place) <= RADII_M[-1]]
        if not tried:
            continue
        versions = model.clamped(torch.stack(tried))
        loss, number = _best(fit.losses_with_each(lines[others], versions))
        changed = lines.clone()
        changed[k] = versions[number]
        yield _Way(changed, [k], loss)


def _extended(line: torch.Tensor, at: torch.Tensor) -> list[torch.Tensor]:
    """Versions of a line [6] [m] that reach a place ahead of it, shape [2] [m]; none where it lies aside."""
    found = []
    for end in (0, 2):
        outward = line[end : end + 2] - line[2 - end : 4 - end]
        outward = outward / outward.norm().clamp_min(1e-12)
        ahead = at - line[end : end + 2]
        along = float(ahead @ outward)
        aside = float((ahead - along * outward).norm())
        if along > 0 and aside < float(line[WIDTH]) + APART_M / 2:
            found += [stretched(line, end, along + more) for more in OVERSHOOTS_M if along + more > 0]
    return found


def _best(losses: list[float]) -> tuple[float, int]:
    return min((loss, number) for number, loss in enumerate(losses))
