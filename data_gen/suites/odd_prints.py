"""The same strokes printed otherwise: other cross sections, lines that merge, a base that is bowed.

The Gaussian and the merging are written here anew in float64, point by point, because a network may have been trained
on prints of ``data_gen.reliefs`` that look much the same.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch

from data_gen.config import PrintedPattern
from data_gen.patterns import padded
from data_gen.reliefs import print_strokes
from data_gen.variety import PrintTraits
from warp_caustics.height_field import cell_centres
from warp_caustics.prints.rows import SEGMENT
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SUPERSAMPLING = 4
"""Points per height sample and direction, as in printing."""

BOW_M = 20e-6
"""Sag of the bowl between the plate's centre and the middle of a side [m]."""

GAUSSIAN_REACH = 1.5
"""Distance from the centre line, in widths, where the Gaussian ends: it is 1e-8 of its crown there, so not cut."""


def bowl(scene: Scene) -> PrintTraits:
    """Traits of a print whose base rises towards the rim by ``BOW_M``."""
    curvature = 4 * BOW_M / max(scene.plate_size_m) ** 2
    return PrintTraits(bow=(curvature, 0.0, curvature))


TRAITS: dict[str, Callable[[Scene], PrintTraits]] = {
    "ellipse": lambda scene: PrintTraits("parabola", 0.5),
    "parabola": lambda scene: PrintTraits("parabola", 1.0),
    "quarter": lambda scene: PrintTraits("cosine", 0.5),
    "squashed": lambda scene: PrintTraits("cosine", 0.6),
    "bow-20": bowl,
}
"""What the printing kernel can do, by name."""


def printed(name: str, strokes: Sequence[FloatArray], scene: Scene, pattern: PrintedPattern, device: str) -> FloatArray:
    """Heights of prints [m], shape [B, n, n].

    Args:
        name: ``plain`` (as the pattern says), one of ``TRAITS``, ``gaussian`` or ``merge``.
        strokes: of each print, shape [L, 7] (STROKE_COLUMNS) [m].
        scene: gives plate and samples.
        pattern: gives profile and supersampling.
        device: where the kernel runs.
    """
    if name == "gaussian":
        return np.stack([relief(each, scene, gaussian, GAUSSIAN_REACH, np.add) for each in strokes])
    if name == "merge":
        return np.stack([relief(each, scene, raised_cosine, 0.5, np.maximum) for each in strokes])
    traits = None
    if name != "plain":
        traits = torch.tensor([TRAITS[name](scene).row()] * len(strokes), dtype=torch.float32)
    batch = torch.from_numpy(padded(list(strokes))).to(device)
    return print_strokes(batch, scene, pattern, traits).double().cpu().numpy()


def gaussian(t: FloatArray) -> FloatArray:
    """Section exp(-r^2 / (2 (w/4)^2)), relative to its crown; t = r / w."""
    return np.asarray(np.exp(-8 * t**2))


def raised_cosine(t: FloatArray) -> FloatArray:
    """Section (1 + cos(2 pi r / w)) / 2, 0 from t = r / w = 1/2 on."""
    return np.asarray(np.where(t < 0.5, 0.5 + 0.5 * np.cos(2 * np.pi * t), 0.0))


def relief(
    strokes: FloatArray, scene: Scene, section: Callable[[FloatArray], FloatArray], reach: float, join: np.ufunc
) -> FloatArray:
    """One print, point by point [m], shape [n, n].

    Args:
        strokes: segments, shape [L, 7] (STROKE_COLUMNS) [m].
        scene: gives plate and samples.
        section: height relative to the crown, of the distance from the centre line in widths.
        reach: distance in widths beyond which the section is nothing.
        join: heights of lines on top of each other, of two arrays.
    """
    n = scene.height_samples
    fine = n * SUPERSAMPLING
    x, y = (cell_centres(fine, length) for length in scene.plate_size_m)
    heights = np.zeros((fine, fine))
    for kind, x0, y0, x1, y1, width, height in strokes.tolist():
        assert kind == SEGMENT  # Tab. 3 has no rings
        margin = reach * width
        columns = slice(*np.searchsorted(x, (min(x0, x1) - margin, max(x0, x1) + margin)))
        rows = slice(*np.searchsorted(y, (min(y0, y1) - margin, max(y0, y1) + margin)))
        from_x, from_y = x[None, columns] - x0, y[rows, None] - y0
        along_x, along_y = x1 - x0, y1 - y0
        nearest = np.clip((from_x * along_x + from_y * along_y) / max(along_x**2 + along_y**2, 1e-20), 0.0, 1.0)
        distance = np.hypot(from_x - nearest * along_x, from_y - nearest * along_y)
        heights[rows, columns] = join(heights[rows, columns], height * section(distance / width))
    return np.asarray(heights.reshape(n, SUPERSAMPLING, n, SUPERSAMPLING).mean(axis=(1, 3)))
