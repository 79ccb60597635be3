"""What a lens that is a little other would change of an image, beside lines and bench.

A point spread is found with lines on some bench, and makes up for what that bench gets wrong: three lines behind a lens
of 0.7 px, that were found with it on a bench whose light goes 2.4 % less far, told 1.6 % with the lens as it was, and
2.1 % where its weights may change with the lines. Rings of weights alone tell 1.8 %, and the lens before the pixels
nothing more. So where the valley of benches is followed once more, all weights are free, to first order.
"""

import numpy as np
import torch

from nets.reconstruct.fibres.image.descent import Beside
from nets.reconstruct.fibres.image.image_fit import ImageFit
from warp_caustics.reconstruct.seen_camera.point_spread import REACH
from warp_caustics.reconstruct.seen_camera.spread_estimate import WEIGHT_WIDTH

_STEPS = range(-REACH, REACH + 1)
PAIRS = tuple((i, j) for i in _STEPS for j in _STEPS if (i, j) > (0, 0))
"""Rows and columns to one side of the middle of weights that are alike to both [px]."""


def lens_modes(seen: torch.Tensor) -> torch.Tensor:
    """What each pair of weights of each channel's point spread changes of a picture, shape [P n_w, n_w, m, m].

    Args:
        seen: through the camera so far, shape [n_w, m, m].
    """
    padded = torch.nn.functional.pad(seen[None], (REACH,) * 4, mode="replicate")[0]
    side = seen.shape[-1]
    modes = seen.new_zeros(len(PAIRS), len(seen), *seen.shape)
    for mode, pair in zip(modes, PAIRS, strict=True):
        for i, j in (pair, (-pair[0], -pair[1])):
            moved = padded[:, REACH + i : REACH + i + side, REACH + j : REACH + j + side]
            for channel, (there, here) in enumerate(zip(moved, seen, strict=True)):
                mode[channel, channel] += there - here
    return modes.flatten(0, 1)


def lens_beside(fit: ImageFit, heights_m: torch.Tensor, weight: float) -> Beside:
    """The same of a relief [m], shape [n, n], believed to be nothing within what a point spread's weights may be.

    Args:
        fit: which has been corrected about the relief.
        heights_m: shape [n, n].
        weight: of :func:`~nets.reconstruct.fibres.bench.line_posterior.misfit_weight`.
    """
    with torch.no_grad():
        seen = fit.seen(heights_m)
        if fit.missing is not None:
            seen = seen + fit.missing
        modes = WEIGHT_WIDTH * lens_modes(seen)
    return Beside(modes, np.zeros(len(modes)), weight)
