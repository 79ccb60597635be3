"""Jumps that descent cannot make: a line that ends elsewhere, or is thinner and higher.

A line that is a few millimetres short leaves its fold dark over all of the
missing part, and no small step shows that a long one would help.
"""

from collections.abc import Iterator

import torch
from scipy import ndimage

from data_gen.vectorise.model import LineModel
from nets.reconstruct.fibres.image_fit import ImageFit

LENGTHS_MM = (-4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0)
FACTORS = (0.5, 0.7, 1.4, 2.0)
GAIN = 0.995
"""A jump must lower the misfit by this factor."""
SUSPECTS = 8
"""Lines tried in one round: those with the worst misfit under them."""


def jumps(line: torch.Tensor) -> Iterator[torch.Tensor]:
    """Lines that one line may be instead, each of shape [6] [mm]."""
    along = line[2:4] - line[:2]
    length = float(along.norm()) + 1e-9
    for change in LENGTHS_MM:
        if change > -length + 0.1:
            moved = line.clone()
            moved[2:4] += change * along / length
            yield moved
            moved = line.clone()
            moved[:2] -= change * along / length
            yield moved
    for factor in FACTORS:
        for width, height in ((1.0, factor), (factor, 1.0), (factor, 1 / factor)):
            yield line * torch.tensor([1.0, 1.0, 1.0, 1.0, width, height], dtype=line.dtype)


def jump(fit: ImageFit, lines: torch.Tensor) -> tuple[torch.Tensor, bool]:
    """Lines after the best jump of each suspicious one, and whether any jumped.

    Args:
        fit: judges; a coarse image will do.
        lines: shape [L, 6] [mm].
    """
    model, lines = fit.model, lines.clone()
    parts = model.parts(lines)[0]
    total = parts.sum(dim=0)
    current, jumped = fit.loss(total), False
    for k in suspects(fit, model, parts):
        best, least = None, current * GAIN
        for changed in jumps(lines[k]):
            allowed = model.clamped(changed[None])
            loss = fit.loss(total - parts[k] + model.heights(allowed))
            if loss < least:
                best, least = allowed[0], loss
        if best is not None:
            new = model.heights(best[None])
            total, jumped, current = total - parts[k] + new, True, least
            parts[k], lines[k] = new, best
    return lines, jumped


def suspects(fit: ImageFit, model: LineModel, parts: torch.Tensor) -> list[int]:
    """Indices of the lines with the worst misfit under and around them, worst first.

    Args:
        fit: gives the measured image.
        model: gives the grid.
        parts: each line alone [mm], shape [L, n, n].
    """
    with torch.no_grad():
        image = fit.simulator((1e-3 * parts.sum(dim=0)).contiguous())
    misfit = ((image - fit.measurement.irradiance).abs() * fit.measurement.weight).mean(dim=0)
    cells = torch.nn.functional.adaptive_avg_pool2d(misfit[None], model.n)[0].cpu().numpy()
    scores = []
    for k, part in enumerate(parts.cpu().numpy()):
        near = ndimage.binary_dilation(part > 0, iterations=3)
        scores.append((float(cells[near].mean()) if near.any() else 0.0, k))
    return [k for _, k in sorted(scores, reverse=True)[:SUSPECTS]]
