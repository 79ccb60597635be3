"""Where a search begins whose picture is of quite another size: far away the first step says nothing.

Displaced by two pixels at the rim, the network finds heights that have made up for all of it, and a step from those
stays where it is, or goes astray: heights that made up for the size seem to be off in place and stray light. But what
its answers leave of the image falls steadily towards the right size: 0.38, 0.35, 0.32 and 0.22 of it with a picture 1 %
too large that is taken for 0, 0.25, 0.5 and 1 % larger. So two more sizes are asked.
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
import torch

from warp_caustics.found_bench.bench_numbers import VERGENCE, BenchNumbers
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray
from warp_caustics.way_of_light import way_of_light_m

FAR = 0.005
"""Of a picture's size, to either side: from as far as that steps arrive."""
LEAST_LEFT = 0.2
"""Of the image, relative, by an answer that is not refined, below which no other size is asked, which takes as long as
the answer did: nine plates of a development seed on benches as told, or nearly, leave 0.11 to 0.31, four with a picture
1 % too large 0.31 to 0.34."""
MUCH_LESS = 0.95
"""Of what is left at the told size, at most, to begin elsewhere: of two plates on the wrong side 0.99 and 1.02 of it,
on the right one 0.84 and 0.90."""


class Pictures(Protocol):
    """One image on benches of :meth:`~warp_caustics.found_bench.bench_numbers.BenchNumbers.of_picture`."""

    def seen(self, values: Mapping[str, float]) -> CausticImage:
        """The image as the bench of some values shows it."""

    def answer(self, values: Mapping[str, float]) -> FloatArray:
        """Heights of the network there, not refined [m], shape [n, n]."""


def far_start(
    pictures: Pictures, numbers: BenchNumbers, simulator: CausticSimulator, exposure: FloatArray, answer: FloatArray
) -> dict[str, float] | None:
    """Values of a bench on which the network's answer explains the image much better; None if there is none.

    Args:
        pictures: the image.
        numbers: that are looked for.
        simulator: of the bench that is told, and of all whose pictures differ by their size alone.
        exposure: of the image, shape [n_w].
        answer: heights of the network on the bench that is told, not refined [m], shape [n, n].
    """
    before = {name: numbers.before[name] for name in numbers.names}
    if before[VERGENCE] != 0:
        return None
    least, best = left_by(answer, simulator, pictures.seen(before), exposure), None
    if least < LEAST_LEFT:
        return None
    least *= MUCH_LESS
    for size in (-FAR, FAR):
        values = {**before, VERGENCE: size / way_of_light_m(numbers.scene)}
        left = left_by(pictures.answer(values), simulator, pictures.seen(values), exposure)
        if left < least:
            least, best = left, values
    return best


def left_by(heights: FloatArray, simulator: CausticSimulator, seen: CausticImage, exposure: FloatArray) -> float:
    """What heights [m], shape [n, n], leave of an image, relative to it; its exposure has shape [n_w]."""
    with torch.no_grad():
        shown = simulator(torch.as_tensor(heights, dtype=torch.float32, device=simulator.device)).cpu().numpy()
    measured = np.asarray(seen.irradiance, dtype=np.float64)
    off = shown * exposure[:, None, None] - measured
    if seen.mask is not None:
        off, measured = off[seen.mask], measured[seen.mask]
    return float(np.linalg.norm(off)) / max(float(np.linalg.norm(measured)), 1e-30)
