"""Lines that a network missed, seen by what they leave of the image.

Light that a line deflects is missing above it, and lands beside: where the image has a line that others do not tell,
what is left of it has a band as long as the line. A network errs where many lines lie on top of each other, and blurs
what is thinner than a sample; what 24 of 26 lines of an own plate left, each a few micrometres from its place, showed
the other two at a glance, and these left 17 um of the plate. How wide and high such a line is the image says of a few.
"""

from functools import partial

import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.growth import GIVEN_UP_FACTOR, TRIED_PROPOSALS, grown_by
from nets.reconstruct.fibres.search.places import SMOOTHED_M, cell_misfits
from warp_caustics.prints.vectorise.proposals import proposed_lines

BANDS = 12
"""Of what is left, along which lines are tried in two directions each."""
WIDTHS_M = (1.5e-4, 3e-4, 6e-4, 1.2e-3, 2.4e-3)
HEIGHTS_M = (1.5e-4, 3e-4, 6e-4, 1.2e-3)
"""That are tried: a line of Tab. 3 is within a factor of 1.7 of one of each, from where descents arrive."""
ASIDE = (-0.5, 0.0, 0.5)
"""Of their width, that lines lie aside of a band: a wide one leaves most at its flanks."""
WIDE_M = 1e-3
"""Width from which on they are tried there."""


def grown_in_shadows(fit: ImageFit, lines: torch.Tensor, most: int, quick: ImageFit | None = None) -> Fitted:
    """Lines with those added whose light is left of the image, one at a time.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        most: lines, at most.
        quick: says which are tried; ``fit`` if None.
    """
    return grown_by(fit, lines, partial(_promising, fit, quick or fit), most)


def _promising(fit: ImageFit, quick: ImageFit, best: Fitted) -> list[torch.Tensor]:
    """Lines that may be missing, those first that explain the image best as they are."""
    model, total = fit.model, fit.model.heights(best.lines)
    (pitch_x, pitch_y), size = model.scene.sample_pitch_m, model.scene.plate_size_m
    cells = cell_misfits(fit, total).double().cpu().numpy()
    bands = scipy.ndimage.gaussian_filter(cells, (SMOOTHED_M / pitch_y, SMOOTHED_M / pitch_x))
    along = torch.from_numpy(proposed_lines(bands, size, BANDS, model.shape))
    if not len(along):
        return []
    now = quick.loss(total)
    if fit.report is not None:
        fit.report(best.loss)
    found: list[tuple[float, int, torch.Tensor]] = []
    for number, line in enumerate(along):
        tried = model.clamped(_versions(line))
        losses = quick.losses_with_each(best.lines, tried)
        loss, k = min((loss, k) for k, loss in enumerate(losses))
        if loss <= GIVEN_UP_FACTOR * now:
            found.append((loss, number, tried[k]))
    return [line for _, _, line in sorted(found, key=lambda each: each[:2])[:TRIED_PROPOSALS]]


def _versions(line: torch.Tensor) -> torch.Tensor:
    """A line [6] [m] in all widths, heights and places that are tried, shape [K, 6] [m]."""
    way = line[2:4] - line[:2]
    across = torch.stack([-way[1], way[0]]) / way.norm().clamp_min(1e-12)
    found = []
    for width in WIDTHS_M:
        for aside in ASIDE if width >= WIDE_M else (0.0,):
            ends = line[:4] + aside * width * across.repeat(2)
            found += [torch.cat([ends, ends.new_tensor([width, height])]) for height in HEIGHTS_M]
    return torch.stack(found)
