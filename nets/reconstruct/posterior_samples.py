"""Several reliefs that explain one image about as well: samples of what it leaves open.

Where light paths cross, more than one relief gives the image, and a network's answers to its turned and flipped copies
differ. The mean of all is one explanation; each answer, refined on the image, is another. A sample is the result with
those parts of one refined answer that differ from it and explain the image around them nearly as well. So samples are
one where the image decides, and differ where it does not:

    start_k = r + w (y_k - mean y),   w = s^2 / (s^2 + s_0^2),   r_k = refined(start_k),
    sample_k = r + sum over parts of (r_k - r), where rest(r_k) <= (1 + slack) rest(r) around the part,

with the result r, answers y and their spread s. Of all samples those are given that lie farthest apart.

Limits: camera, exposure and bench are those of the result; what the bench leaves open is part of the uncertainty alone.
What no answer of the networks is near to is in no sample either.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.types import BoolArray, FloatArray

MOST_SAMPLES = 5
STARTS = 8
"""Answers that are refined, those farthest apart: as many as a square has symmetries."""
AGREED_M = 2e-6
"""Spread at which an answer counts half [m, on the network's own plate]: where all agree, the result knows better."""
DIFFERENT_M = 5e-6
"""From which difference on a part is another one [m, on the network's own plate]."""
SMALLEST_PART = 3
"""Cells; less is left as it is in the result."""
REACH = 0.025
"""Around a part the image is looked at up to this share of the plate: light lands beside where it came in."""
SLACK = 0.15
"""A part may leave so much more of the image around it, as a share of the squares: what the simulation and the camera
leave of a right relief differs by as much from place to place."""
FEATHER = 0.7
"""Standard deviation [cells] by which the rim of a part is softened."""

Refine = Callable[[FloatArray], FloatArray]
"""Of a relief [m], shape [n, n]: one that explains the image better."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Reliefs that explain an image.

    Attributes:
        heights_m: shape [N, n, n] [m].
        residuals: relative, of the image, shape [N].
        residual: of the result.
        differ_m: how far apart they lie where they do, root mean square of their standard deviation [m].
        share: of the plate where they do.
        within_two: of that part, and of all samples, the share that is within two standard uncertainties of the result;
            None where that has none.
    """

    heights_m: FloatArray
    residuals: FloatArray
    residual: float
    differ_m: float
    share: float
    within_two: float | None

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "count": len(self.heights_m),
            "differ_um": 1e6 * self.differ_m,
            "share": self.share,
            "residuals": self.residuals.tolist(),
            "residual": self.residual,
            "within_two": self.within_two,
            "line": self.line,
        }

    @property
    def line(self) -> str:
        """For people."""
        low, high = float(self.residuals.min()), float(self.residuals.max())
        left = f"they leave {low:.3g} to {high:.3g} of the image, the result {self.residual:.3g}"
        if not self.share:
            return f"{len(self.heights_m)}: they agree everywhere; {left}"
        return (
            f"{len(self.heights_m)}: they differ by {1e6 * self.differ_m:.3g} um (root mean square) on "
            f"{100 * self.share:.2g} % of the plate; {left}"
        )


def posterior_samples(
    count: int,
    result_m: FloatArray,
    answers: torch.Tensor,
    resimulation: Resimulation,
    refine: Refine,
    *,
    uncertainty_m: FloatArray | None = None,
    scale: float = 1.0,
    found_at: int | None = None,
) -> Samples | None:
    """Samples of what an image leaves open; None where its noise cannot be told.

    Args:
        count: N.
        result_m: the relief that was found [m], shape [n, n].
        answers: of the networks, at least two, shape [B, n, n] [m].
        resimulation: of the image, through its camera.
        refine: as the result was refined.
        uncertainty_m: of the result [m], shape [n, n]; None if unknown.
        scale: of the network's plate over the user's.
        found_at: pixels per side that the result was found with; None for all.
    """
    at_result = _left(resimulation, result_m, found_at)
    if at_result is None:
        return None
    every = answers.double().cpu().numpy()
    middle, spread2 = every.mean(axis=0), every.var(axis=0, ddof=1)
    weight = spread2 / (spread2 + (AGREED_M / scale) ** 2)
    found = []
    for k in farthest(weight * (every - middle), STARTS):
        start = as_glass(result_m + weight * (every[k] - middle), resimulation.simulator.scene)
        other = _believed(result_m, refine(start), at_result, resimulation, found_at, DIFFERENT_M / scale)
        found.append(as_glass(other, resimulation.simulator.scene))
    reliefs = np.stack(found)
    residuals = np.array([resimulation(each).residual for each in found])
    chosen = farthest(reliefs, count, first=int(residuals.argmin()))
    return samples_of(reliefs[chosen], residuals[chosen], result_m, resimulation, uncertainty_m, scale)


def samples_of(
    reliefs_m: FloatArray,
    residuals: FloatArray,
    result_m: FloatArray,
    resimulation: Resimulation,
    uncertainty_m: FloatArray | None = None,
    scale: float = 1.0,
) -> Samples:
    """Reliefs with how far they lie apart.

    Args:
        reliefs_m: shape [N, n, n] [m].
        residuals: of each, shape [N].
        result_m: the relief that was found [m], shape [n, n].
        resimulation: of the image.
        uncertainty_m: of the result [m], shape [n, n]; None if unknown.
        scale: of the network's plate over the user's.
    """
    apart = reliefs_m.std(axis=0, ddof=1) if len(reliefs_m) > 1 else np.abs(reliefs_m[0] - result_m)
    where = apart > DIFFERENT_M / scale
    within = None
    if uncertainty_m is not None and where.any():
        within = float((np.abs(reliefs_m - result_m) <= 2 * uncertainty_m)[:, where].mean())
    return Samples(
        reliefs_m,
        residuals,
        resimulation(result_m).residual,
        float(np.sqrt(np.mean(apart[where] ** 2))) if where.any() else 0.0,
        float(where.mean()),
        within,
    )


def farthest(reliefs: FloatArray, count: int, first: int | None = None) -> list[int]:
    """Numbers of reliefs, shape [B, n, n], each the farthest from those before; the first is the farthest from 0.

    Args:
        reliefs: [m].
        count: at most.
        first: to begin with, in place of that.
    """
    flat = reliefs.reshape(len(reliefs), -1)
    chosen = [int(np.square(flat).sum(axis=1).argmax()) if first is None else first]
    nearest = np.square(flat - flat[chosen[0]]).sum(axis=1)
    while len(chosen) < min(count, len(flat)):
        nearest[chosen] = -1.0
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.square(flat - flat[chosen[-1]]).sum(axis=1))
    return chosen


def _believed(
    result_m: FloatArray,
    other_m: FloatArray,
    at_result: FloatArray,
    resimulation: Resimulation,
    found_at: int | None,
    level_m: float,
) -> FloatArray:
    """The result with those parts of another relief that explain the image about as well."""
    labels, count = scipy.ndimage.label(np.abs(other_m - result_m) > level_m, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    kept = sizes >= SMALLEST_PART
    kept[0] = False
    reach = max(1, math.ceil(REACH * len(result_m)))
    around = scipy.ndimage.maximum_filter(np.where(kept[labels], labels, 0), 2 * reach + 1)
    while kept.any():
        relief = _with(result_m, other_m, kept[labels])
        left = _left(resimulation, relief, found_at)
        assert left is not None
        numbers = np.flatnonzero(kept)
        was, now = (np.asarray(scipy.ndimage.sum_labels(each, around, numbers)) for each in (at_result, left))
        is_worse = now > (1 + SLACK) * was
        if not is_worse.any():
            return relief
        kept[numbers[is_worse]] = False
    return result_m


def _with(result_m: FloatArray, other_m: FloatArray, where: BoolArray) -> FloatArray:
    share = scipy.ndimage.gaussian_filter(scipy.ndimage.binary_dilation(where).astype(float), FEATHER)
    mixed: FloatArray = result_m + np.where(where, 1.0, share) * (other_m - result_m)
    return mixed


def _left(resimulation: Resimulation, heights_m: FloatArray, found_at: int | None) -> FloatArray | None:
    """Squares of what is left of the image over each cell, shape [n, n]; None where its noise cannot be told."""
    rest = resimulation.rest(heights_m, found_at)
    if rest is None:
        return None
    squares = rest.left.square().sum(0)[None, None]
    cells: FloatArray = torch.nn.functional.adaptive_avg_pool2d(squares, len(heights_m))[0, 0].cpu().numpy()
    return cells
